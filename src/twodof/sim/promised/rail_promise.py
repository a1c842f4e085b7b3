"""Promise of a step of the velocity or the position, by flights of an identified family on the virtual rig."""

from collections.abc import Callable, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Diagram
from twodof.design.promise import LEVEL, STEPS, Promise, check_numbers
from twodof.design.specification import Requirement, Specification, requirements
from twodof.errors import ParameterError, shown
from twodof.flight.gains import DEFAULT, Gains
from twodof.sim.linear import cascade_margins
from twodof.sim.promised.lanes_flight import BEFORE, fly_lanes
from twodof.sim.promised.rail_family import RailFamily

Array = NDArray[np.float64]

MEMBERS = 400
LOOPS = ("velocity", "position")

_LEAST_MEMBERS, _MOST_MEMBERS = 40, 2000


def rail_promise(
    family: RailFamily,
    loop: str = "velocity",
    *,
    gains: Gains = DEFAULT,
    controllers: Iterable[Diagram] = (),
    goal: float | None = None,
    duration: float | None = None,
    level: float = LEVEL,
    members: int = MEMBERS,
    seed: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> Promise:
    """Fly `members` of the family on the virtual rig, with all noise and limits, and promise what a share `level` does.

    `goal` [m/s or m] and `duration` [s] are those of `STEPS` if None. `progress` is called with the share done. Raise
    ParameterError for numbers out of range, and as `RailFamily.rigs` and `fly_lanes`.
    """
    if loop not in LOOPS:
        raise _error(f"a loop {shown(loop)}", f"give {' or '.join(LOOPS)}")
    step = STEPS[loop]
    goal, duration = step.goal if goal is None else goal, step.duration if duration is None else duration
    if not 0.01 <= goal <= 1.0:
        raise _error(f"a step of {goal!r}", "give .01 to 1 m/s or m")
    check_numbers(duration, level, members, (_LEAST_MEMBERS, _MOST_MEMBERS))
    rigs, diagrams = family.rigs(members, seed), tuple(controllers)
    flown = fly_lanes(
        rigs,
        step.setpoint,
        goal,
        duration,
        gains=gains,
        controllers=diagrams,
        read=(*step.channels, "true_x"),
        seed=1000 * seed,
        said=progress,
    ).channels
    name = ", ".join(one.name for one in diagrams) or "the stock cascade"
    lost = _lost(flown, rigs, step.follows, goal)
    return Promise.of_flights(name, family.to_json(), loop, goal, level, seed, lost, from_step(flown, loop))


def from_step(flown: Mapping[str, Array], loop: str) -> dict[str, Array]:
    """Return the channels of a promise from the step on, of flights that begin `BEFORE` samples earlier."""
    step = STEPS[loop]
    rest = {name: flown[name][:BEFORE].mean(axis=0) for name in step.zeroed}
    return {name: flown[name][BEFORE:] - rest.get(name, 0.0) for name in step.channels}


def check_rail(
    specification: Specification,
    family: RailFamily,
    gains: Gains = DEFAULT,
    controllers: Iterable[Diagram] = (),
    promised: Promise | None = None,
) -> tuple[Requirement, ...]:
    """Return what `specification` asks of the rail's loops, in its order, beside what `gains` and `controllers` have.

    Bandwidths and margins are those of the estimate as it flies, sampled, with the estimator (`cascade_margins`); the
    worse of both loops counts. A figure of the step is checked by the far end of the `promised` interval. Raise
    ParameterError if a step is asked for and `promised` is missing or of another step.
    """
    found = {}
    if specification.of_loops is not None:
        found = cascade_margins(gains, controllers, family.nominal(), LOOPS)
    bandwidths = {f"{name}_bandwidth": one.bandwidth for name, one in found.items()}
    return requirements(specification, found, bandwidths, promised)


def _lost(flown: Mapping[str, Array], rigs: list[dict[str, float]], follows: str, goal: float) -> float:
    """Return the share that met a stop of the rail, or is not within half of the step at the end."""
    stops = np.array([rig["rail_stop"] for rig in rigs])
    met = np.abs(flown["true_x"]).max(axis=0) > stops - 1e-3
    end = flown[follows][-BEFORE:].mean(axis=0)
    return float(np.mean(met | ~(np.abs(end - goal) < 0.5 * goal)))


def _error(what: str, remedy: str) -> ParameterError:
    return ParameterError(what, "rail_promise", remedy)
