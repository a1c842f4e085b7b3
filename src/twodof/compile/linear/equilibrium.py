"""Equilibrium: where the states, and inputs that are free, stay as they are."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twodof.compile.linear.slopes import Slopes
from twodof.errors import DiagramError

Array = NDArray[np.float64]


def move_to_equilibrium(name: str, slopes: Slopes, free: Sequence[str], continuous: bool) -> None:
    """Move the point's states, and the inputs in `free`, to an equilibrium near it: of dx/dt, or of the step map.

    With inputs that are free, the states that `at` gave stay. Raises DiagramError if no equilibrium is found.
    """
    point, coordinates, inputs = slopes.point, slopes.coordinates, slopes.inputs
    for own in free:
        if own not in inputs or inputs[own].node is not None:
            raise DiagramError(f"{own!r} is not an input to free", name, "name a real input")
    size = coordinates.size
    moving = [j for j, given in enumerate(coordinates.given()) if not (free and given)]
    columns = list(moving)
    at = size
    for own, s in inputs.items():
        columns += range(at, at + (s.width or 1)) if own in free else []
        at += s.width or 1
    freed = [s for own, s in inputs.items() if own in free]
    states = coordinates.values()
    now, after = coordinates.order(), coordinates.order(1)

    last: dict[bytes, tuple[Array, Array]] = {}

    def evaluated(z: Array) -> tuple[Array, Array]:
        if z.tobytes() not in last:
            last.clear()
            last[z.tobytes()] = residual(z)
        return last[z.tobytes()]

    def residual(z: Array) -> tuple[Array, Array]:
        states[moving] = z[: len(moving)]
        coordinates.put(states)
        point.put_inputs(freed, z[len(moving) :])
        try:
            found = slopes.matrices("slope" if continuous else "next", strict=False)
        except DiagramError as error:
            raise DiagramError(
                f"the search for an equilibrium came where {error.what}",
                error.where,
                "start nearer to one with `at`, or cut a signal of this block as an input",
            ) from error
        if continuous:
            return found.value, found.change[:, columns]
        stay = np.eye(size, slopes.seeds)
        return found.value[after] - states[now], (found.change[after] - stay[now])[:, columns]

    start = np.concatenate([states[moving], point.input_values(freed)])
    if not (start.size and size):
        return
    from scipy.optimize import least_squares  # imported late: most commands start without it

    best = least_squares(
        lambda z: evaluated(z)[0], start, lambda z: evaluated(z)[1], xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    left = np.abs(evaluated(best.x)[0])
    # A residual is a difference of numbers of this size, each rounded some tens of times.
    if not left.max() <= 1e-9 * (1.0 + float(np.abs(best.x).max())):
        worst = int(np.argmax(left))
        which = worst if continuous else now[worst]
        raise DiagramError(
            f"no equilibrium was found: {_name(slopes, which)} still changes by {left[worst]:.3g}",
            name,
            "start nearer to one with `at`, or free an input that can hold it",
        )


def _name(slopes: Slopes, place: int) -> str:
    coordinates = slopes.coordinates
    return coordinates.names()[coordinates.order().index(place)]
