"""Linear plants as blocks: an exact zero-order hold computed on board from physical parameters, with any input delay.

A subclass gives A, B, C and D in terms of its parameters. `prepare` turns them into the discrete model each time a
parameter changes, so that one compiled program serves a whole estimation; a step is then a few multiplications.
"""

from collections.abc import Sequence
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.expressions.arrays import fold
from twodof.blocks.expressions.expr import maximum, real, to_int32, to_real, where
from twodof.models.around_plant import past_input, past_states, remember
from twodof.signals import GRAVITY

# Taylor terms of the matrix exponential: |A| h <= 2 leaves 2^21 / 21! < 5e-14. A step with more is taken in pieces.
_TERMS = 20
_LARGEST = 2.0
_DOUBLINGS = 6

Matrix = Sequence[Sequence[Any]]


class ZohPlant(Block):
    """x' = A x + B u(t - dead time), y = C x + D u(t - dead time) for a scalar input held between steps.

    Inputs before step 0 equal that of step 0. The dead time, the parameter named `plant_delay`, is a real number of
    seconds, from 0 to `ring - 2` steps; a longer one gives NaN. Each state is named in `plant_states` (name, unit)
    and starts from the parameter "<name>_0". A state named in `follows` starts at the value of the first input. The
    outputs are the states, unless `plant_outputs` names others.
    """

    plant_states: Sequence[tuple[str, str]] = ()
    plant_delay = "tau"
    follows: Sequence[str] = ()
    plant_input = Port("M")
    plant_outputs: Sequence[tuple[str, str]] = ()
    plant_params: Sequence[Param] = ()

    def __init__(self, ring: int = 64) -> None:
        self.ring = ring
        self.names = names = [name for name, _ in self.plant_states]
        self.inputs = (self.plant_input,)
        self.outputs = tuple(Port(name, unit=unit) for name, unit in self.plant_outputs or self.plant_states)
        self.params = (
            *self.plant_params,
            Param(self.plant_delay, 0.0, unit="s", low=0.0, text="delay of the input"),
            *(
                Param(f"{name}_0", unit=unit, text=f"{name} at the start")
                for name, unit in self.plant_states
                if name not in self.follows
            ),
        )
        self.states = (
            *(State(name, 0.0 if name in self.follows else f"{name}_0", unit=unit) for name, unit in self.plant_states),
            *past_states(ring),
        )
        self.derived = (
            *(Port(f"phi_{i}_{j}") for i in names for j in names),
            *(Port(f"old_{i}") for i in names),
            *(Port(f"new_{i}") for i in names),
            Port("whole", "int32"),
            Port("split", "bool"),
            Port("fits", "bool"),
        )

    def matrices(self, p: Any) -> tuple[Matrix, Sequence[Any]]:
        """Return A (n rows) and B (n), from the parameters."""
        raise AttributeError(f"{type(self).__name__} does not define matrices")

    def readout(self, p: Any) -> tuple[Matrix, Sequence[Any]]:
        """Return C (a row an output) and D (a number an output): by default each output is the state of its name."""
        rows = [[float(port.name == name) for name in self.names] for port in self.outputs]
        return rows, [0.0] * len(rows)

    def prepare(self, p: Any, t: Clock) -> dict[str, Any]:
        """Return Phi(dt), and the input's effect before and after its edge inside the step, if the delay ends there."""
        a, b = self.matrices(p)
        steps = p[self.plant_delay] / t.dt
        # A delay that is a multiple of dt up to rounding is that multiple.
        whole = to_int32(steps + 1e-9)
        part = steps - to_real(whole)
        split = part > 1e-9
        drive = [[value] for value in b]
        phi, full = held(a, drive, t.dt)
        _, late = held(a, drive, t.dt * (1.0 - where(split, part, 0.0)))
        result: dict[str, Any] = {"whole": whole, "split": split, "fits": steps <= self.ring - 2.0}
        for i, row in enumerate(self.names):
            result[f"old_{row}"] = full[i] - late[i]
            result[f"new_{row}"] = late[i]
            for j, column in enumerate(self.names):
                result[f"phi_{row}_{column}"] = phi[i * len(a) + j]
        return result

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """Return C x + D u, with the delayed input."""
        c, d = self.readout(p)
        state = [x[name] for name in self.names]
        through = d
        if any(not _is_zero(value) for value in d):
            old, new = self._delayed(u, x, p)
            now = where(p.split, old, new)
            through = [0.0 if _is_zero(value) else value * now for value in d]
        return {
            port.name: total([*(times(k, s) for k, s in zip(row, state, strict=True)), direct])
            for port, row, direct in zip(self.outputs, c, through, strict=True)
        }

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        old, new = self._delayed(u, x, p)
        first = u[self.inputs[0].name]
        now = {name: where(x.age == 0, first, x[name]) if name in self.follows else x[name] for name in self.names}
        result: dict[str, Any] = {
            row: total([p[f"phi_{row}_{column}"] * now[column] for column in self.names])
            + (p[f"old_{row}"] * old + p[f"new_{row}"] * new)
            for row in self.names
        }
        return result | remember(u[self.inputs[0].name], x, self.ring)

    def _delayed(self, u: Any, x: Any, p: Any) -> tuple[Any, Any]:
        """Return the input `whole + 1` and `whole` steps ago; before step 0 that of step 0."""
        ago = past_input(u[self.inputs[0].name], x, p.fits, self.ring)
        return ago(p.whole + 1), ago(p.whole)


def held(a: Matrix, b: Matrix, dt: Any) -> tuple[list[Any], list[Any]]:
    """Return exp(A dt) and the integral of exp(A s) B over s = 0..dt, each row by row in one list.

    By Horner over a piece h of dt, I + A h/1 (I + A h/2 (I + ...)) and h (B + A h/2 (B + A h/3 (...))), then doubled:
    Phi(2 h) = Phi(h) Phi(h), W(2 h) = W(h) + Phi(h) W(h).
    """
    n, m = len(a), len(b[0])
    one = [1.0 if i == j else 0.0 for i in range(n) for j in range(n)]
    norm = real(0.0)
    for row in a:
        norm = maximum(norm, dt * total([abs(value) for value in row]))
    stiff = norm > _LARGEST
    h = where(stiff, dt * 2.0**-_DOUBLINGS, dt)

    def step(k: Any, *carried: Any) -> list[Any]:
        now, after = h / (_TERMS - to_real(k)), h / (_TERMS + 1.0 - to_real(k))
        phi, w = carried[: n * n], carried[n * n :]
        return [
            *(
                one[i * n + j] + now * total([times(a[i][l], phi[l * n + j]) for l in range(n)])
                for i in range(n)
                for j in range(n)
            ),
            *(
                b[i][j] + after * total([times(a[i][l], w[l * m + j]) for l in range(n)])
                for i in range(n)
                for j in range(m)
            ),
        ]

    def double(k: Any, *carried: Any) -> list[Any]:
        phi, w = carried[: n * n], carried[n * n :]
        twice = [total([phi[i * n + l] * phi[l * n + j] for l in range(n)]) for i in range(n) for j in range(n)]
        twice += [
            w[i * m + j] + total([phi[i * n + l] * w[l * m + j] for l in range(n)]) for i in range(n) for j in range(m)
        ]
        return [where(stiff, new, old) for new, old in zip(twice, carried, strict=True)]

    piece = fold(_TERMS, [real(v) for v in one] + [real(0.0)] * (n * m), step)
    whole = fold(_DOUBLINGS, [*piece[: n * n], *(h * w for w in piece[n * n :])], double)
    return list(whole[: n * n]), list(whole[n * n :])


def _is_zero(value: Any) -> bool:
    return isinstance(value, float) and value == 0.0


def times(a: Any, b: Any) -> Any:
    """Return a * b, without an operation if `a` is a literal 0 or 1."""
    if _is_zero(a):
        return 0.0
    return b if isinstance(a, float) and a == 1.0 else a * b


def total(terms: Sequence[Any]) -> Any:
    """Return the sum of `terms`, without an operation for a literal 0."""
    result: Any = 0.0
    for term in terms:
        if not _is_zero(term):
            result = term if _is_zero(result) else result + term
    return result


@library_block("models.HeldPitchRate")
class ZohPitchRate(ZohPlant):
    """G_q, paper equation (5): q' = -w_n^2 theta - 2 xi w_n q + mu M."""

    plant_states = (("theta", "rad"), ("q", "rad/s"))
    plant_params = (
        Param("w_n", 3.437, unit="rad/s", low=0.0, text="natural frequency"),
        Param("xi", 0.0836, text="damping ratio"),
        Param("mu", 358.5, unit="rad/s2", text="gain from normalised moment to angular acceleration"),
    )

    def matrices(self, p: Any) -> tuple[Matrix, Sequence[Any]]:
        """Return the matrices of paper equations (3) to (6)."""
        return ((0.0, 1.0), (-(p.w_n * p.w_n), -2.0 * p.xi * p.w_n)), (0.0, p.mu)


@library_block("models.HeldPushedPitchRate")
class ZohPushedPitchRate(ZohPlant):
    """The pitch under a push, an angular acceleration: q' = -w_n^2 theta - 2 xi w_n q + push."""

    plant_states = ZohPitchRate.plant_states
    plant_input = Port("push", unit="rad/s2")
    plant_params = ZohPitchRate.plant_params[:2]

    def matrices(self, p: Any) -> tuple[Matrix, Sequence[Any]]:
        """Return the matrices of paper equations (3) to (6), driven by the push itself."""
        return ((0.0, 1.0), (-(p.w_n * p.w_n), -2.0 * p.xi * p.w_n)), (0.0, 1.0)


@library_block("models.HeldPitchRateLag")
class ZohPitchRateLag(ZohPlant):
    """G_q behind a pure delay `dead_time` and the rotors' first-order `lag`.

    For slow inputs the total delay is their sum, the paper's tau. The rotors start in the steady state of the first
    input.
    """

    plant_states = (*ZohPitchRate.plant_states, ("m", ""))
    plant_outputs = ZohPitchRate.plant_states
    plant_delay = "dead_time"
    follows = ("m",)
    plant_params = (
        *ZohPitchRate.plant_params,
        Param("lag", 0.011, unit="s", low=0.0005, text="time constant of the rotors"),
    )

    def matrices(self, p: Any) -> tuple[Matrix, Sequence[Any]]:
        """Return the matrices of paper equations (3) to (6), with the rotors' moment."""
        return (
            ((0.0, 1.0, 0.0), (-(p.w_n * p.w_n), -2.0 * p.xi * p.w_n, p.mu), (0.0, 0.0, -(1.0 / p.lag))),
            (0.0, 0.0, 1.0 / p.lag),
        )


@library_block("models.HeldVelocity")
class ZohVelocity(ZohPlant):
    """G_v and G_x, paper equation (9): v' = -p_v v - k_v theta, x' = v."""

    plant_states = (("x", "m"), ("v", "m/s"))
    plant_input = Port("theta", unit="rad")
    plant_params = (
        Param("k_v", 4.748, unit="m/s2", text="gain from pitch to deceleration"),
        Param("p_v", 1.168, unit="1/s", text="pole of the linear friction"),
    )

    def matrices(self, p: Any) -> tuple[Matrix, Sequence[Any]]:
        return ((0.0, 1.0), (0.0, -p.p_v)), (0.0, -p.k_v)


@library_block("models.HeldPitchAndVelocity")
class ZohPitchAndVelocity(ZohPlant):
    """G_q, then G_v, then G_x as one plant from M: paper Figure 6 with the loop open."""

    plant_states = (*ZohPitchRate.plant_states, *ZohVelocity.plant_states)
    plant_params = (*ZohPitchRate.plant_params, *ZohVelocity.plant_params)

    def matrices(self, p: Any) -> tuple[Matrix, Sequence[Any]]:
        """Return the matrices of paper equations (3) to (6) and (9)."""
        return (
            (
                (0.0, 1.0, 0.0, 0.0),
                (-(p.w_n * p.w_n), -2.0 * p.xi * p.w_n, 0.0, 0.0),
                (0.0, 0.0, 0.0, 1.0),
                (-p.k_v, 0.0, 0.0, -p.p_v),
            ),
            (0.0, p.mu, 0.0, 0.0),
        )


@library_block("models.HeldLongitudinal")
class ZohLongitudinal(ZohPlant):
    """The course's three-state longitudinal model (see `twodof.models.plant.Longitudinal`)."""

    plant_states = (("u", "m/s"), ("q", "rad/s"), ("theta", "rad"))
    plant_outputs = (*plant_states, ("a_x", "m/s2"))
    plant_params = (
        Param("X_u", -0.1068, unit="1/s", text="velocity damping"),
        Param("X_q", 0.1192, unit="m/s", text="acceleration by pitch rate"),
        Param("M_u", -5.9755, unit="rad/(m s)", text="pitch acceleration by velocity"),
        Param("M_q", -2.6478, unit="1/s", text="pitch damping"),
        Param("X_d", -10.1647, unit="m/s2", text="acceleration by moment"),
        Param("M_d", 450.71, unit="rad/s2", text="pitch acceleration by moment"),
    )

    def matrices(self, p: Any) -> tuple[Matrix, Sequence[Any]]:
        return ((p.X_u, p.X_q, -GRAVITY), (p.M_u, p.M_q, 0.0), (0.0, 1.0, 0.0)), (p.X_d, p.M_d, 0.0)

    def readout(self, p: Any) -> tuple[Matrix, Sequence[Any]]:
        """Return the states and the accelerometer."""
        states, _ = super().readout(p)
        return [*states[:3], (p.X_u, p.X_q, 0.0)], (0.0, 0.0, 0.0, p.X_d)
