"""Linear plants as blocks: an exact zero-order hold computed on board from physical parameters, with any input delay.

A subclass gives A, B, C and D in terms of its parameters. `prepare` turns them into the discrete model each time a
parameter changes, so that one compiled program serves a whole estimation; a step is then a few multiplications.
"""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.expressions.arrays import fold
from twodof.blocks.expressions.expr import maximum, real, to_real, where
from twodof.models.around_plant import past_input, past_states, remember, whole_and_part
from twodof.signals import GRAVITY

# Taylor terms of the matrix exponential: |A| h <= 2 leaves 2^21 / 21! < 5e-14. A step with more is taken in pieces.
_TERMS = 20
_LARGEST = 2.0
_DOUBLINGS = 6

Matrix = Sequence[Sequence[Any]]

_OF_DELAYS = (("whole", "int32"), ("split", "bool"), ("fits", "bool"))


class ZohPlant(Block):
    """x' = A x + B u(t - dead time), y = C x + D u(t - dead time) for inputs held between steps.

    `plant_delays` names the parameter of an input's dead time, or is a number of seconds: from 0 to `ring - 2` steps; a
    longer one gives NaN. A delayed input was before step 0 what it is at step 0. Each state is named in `plant_states`
    (name, unit) and starts from the parameter "<name>_0". A state named in `follows` starts at the value of the first
    input. The outputs are the states, unless `plant_outputs` names others.
    """

    plant_states: Sequence[tuple[str, str]] = ()
    plant_inputs: Sequence[Port] = (Port("M"),)
    plant_delays: Mapping[str, float | str] = MappingProxyType({"M": "tau"})
    follows: Sequence[str] = ()
    plant_outputs: Sequence[tuple[str, str]] = ()
    plant_params: Sequence[Param] = ()

    def __init__(self, ring: int = 64) -> None:
        self.ring = ring
        self.names = names = [name for name, _ in self.plant_states]
        self.driven = driven = [port.name for port in self.plant_inputs]
        known = [param.name for param in self.plant_params]
        delays = [one for one in dict.fromkeys(self.plant_delays.values()) if isinstance(one, str) and one not in known]
        self.inputs = tuple(self.plant_inputs)
        self.outputs = tuple(Port(name, unit=unit) for name, unit in self.plant_outputs or self.plant_states)
        self.params = (
            *self.plant_params,
            *(Param(one, 0.0, unit="s", low=0.0, text="delay of the input") for one in delays),
            *(
                Param(f"{name}_0", unit=unit, text=f"{name} at the start")
                for name, unit in self.plant_states
                if name not in self.follows
            ),
        )
        self.states = (
            *(State(name, 0.0 if name in self.follows else f"{name}_0", unit=unit) for name, unit in self.plant_states),
            *(past_states(ring, *self.plant_delays) if self.plant_delays else ()),
        )
        self.derived = (
            *(Port(f"phi_{i}_{j}") for i in names for j in names),
            *(Port(f"new_{i}_{j}") for i in names for j in driven),
            *(Port(f"old_{i}_{j}") for i in names for j in self.plant_delays),
            *(Port(f"{what}_{j}", kind) for j in self.plant_delays for what, kind in _OF_DELAYS),
        )

    def matrices(self, p: Any) -> tuple[Matrix, Matrix]:
        """Return A (n rows) and B (n rows, a number an input), from the parameters."""
        raise AttributeError(f"{type(self).__name__} does not define matrices")

    def readout(self, p: Any) -> tuple[Matrix, Matrix]:
        """Return the rows of C and D, one an output: by default each output is the state of its name."""
        rows = [[float(port.name == name) for name in self.names] for port in self.outputs]
        return rows, [[0.0] * len(self.driven) for _ in rows]

    def sampled(self, a: Matrix, b: Matrix, t: Clock) -> tuple[list[Any], list[Any]]:
        """Return Phi and the inputs' effect over a step, each row by row in one list."""
        return held(a, b, t.dt)

    def prepare(self, p: Any, t: Clock) -> dict[str, Any]:
        """Return Phi(dt), and each input's effect before and after its edge inside the step, if there is one."""
        a, b = self.matrices(p)
        phi, effect = self.sampled(a, b, t)
        result: dict[str, Any] = {}
        for j, name in enumerate(self.driven):
            new = effect[j :: len(self.driven)]
            if name in self.plant_delays:
                named = self.plant_delays[name]
                delay = p[named] if isinstance(named, str) else real(named)
                whole, part = whole_and_part(delay, t)
                _, late = held(a, [[row[j]] for row in b], t.dt * (1.0 - part))
                result |= {f"old_{row}_{name}": new[i] - late[i] for i, row in enumerate(self.names)}
                fits = delay / t.dt <= self.ring - 2.0
                result |= {f"whole_{name}": whole, f"split_{name}": part > 0.0, f"fits_{name}": fits}
                new = late
            result |= {f"new_{row}_{name}": new[i] for i, row in enumerate(self.names)}
        n = len(a)
        return result | {f"phi_{self.names[k // n]}_{self.names[k % n]}": value for k, value in enumerate(phi)}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """Return C x + D u, with the delayed inputs."""
        c, d = self.readout(p)
        values = [x[name] for name in self.names]
        for name, *column in zip(self.driven, *d, strict=True):
            direct = any(not _is_zero(value) for value in column)
            older, newer = self._applied(u, x, p, name) if direct else (None, 0.0)
            values.append(newer if older is None else where(p[f"split_{name}"], older, newer))
        return {
            port.name: total([times(k, value) for k, value in zip((*row, *through), values, strict=True)])
            for port, row, through in zip(self.outputs, c, d, strict=True)
        }

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """Return Phi x + Gamma u, each delayed input in two parts of the step."""
        first, now = u[self.driven[0]], {name: x[name] for name in self.names}
        now |= {name: where(x.age == 0, first, x[name]) for name in self.follows}
        applied = {name: self._applied(u, x, p, name) for name in self.driven}
        result = {}
        for row in self.names:
            drive = []
            for name, (older, newer) in applied.items():
                drive += [] if older is None else [p[f"old_{row}_{name}"] * older]
                drive.append(p[f"new_{row}_{name}"] * newer)
            result[row] = total([p[f"phi_{row}_{column}"] * now[column] for column in self.names]) + total(drive)
        return result | (remember(u, x, self.ring, *self.plant_delays) if self.plant_delays else {})

    def _applied(self, u: Any, x: Any, p: Any, name: str) -> tuple[Any, Any]:
        """Return what an input applies before its edge inside the step, None without a delay, and behind it."""
        if name not in self.plant_delays:
            return None, u[name]
        ago, whole = past_input(u, x, name, p[f"fits_{name}"], self.ring), p[f"whole_{name}"]
        return ago(whole + 1), ago(whole)


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
    h = where(norm > _LARGEST * 2.0**_DOUBLINGS, math.nan, where(stiff, dt * 2.0**-_DOUBLINGS, dt))

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

    def matrices(self, p: Any) -> tuple[Matrix, Matrix]:
        """Return the matrices of paper equations (3) to (6)."""
        return ((0.0, 1.0), (-(p.w_n * p.w_n), -2.0 * p.xi * p.w_n)), ((0.0,), (p.mu,))


@library_block("models.HeldPushedPitchRate")
class ZohPushedPitchRate(ZohPlant):
    """The pitch under a push, an angular acceleration: q' = -w_n^2 theta - 2 xi w_n q + push."""

    plant_states = ZohPitchRate.plant_states
    plant_inputs = (Port("push", unit="rad/s2"),)
    plant_delays = MappingProxyType({})
    plant_params = ZohPitchRate.plant_params[:2]

    def matrices(self, p: Any) -> tuple[Matrix, Matrix]:
        """Return the matrices of paper equations (3) to (6), driven by the push itself."""
        return ((0.0, 1.0), (-(p.w_n * p.w_n), -2.0 * p.xi * p.w_n)), ((0.0,), (1.0,))


@library_block("models.HeldPitchRateLag")
class ZohPitchRateLag(ZohPlant):
    """G_q behind a pure delay `dead_time` and the rotors' first-order `lag`.

    For slow inputs the total delay is their sum, the paper's tau. The rotors start in the steady state of the first
    input.
    """

    plant_states = (*ZohPitchRate.plant_states, ("m", ""))
    plant_outputs = ZohPitchRate.plant_states
    plant_delays = MappingProxyType({"M": "dead_time"})
    follows = ("m",)
    plant_params = (
        *ZohPitchRate.plant_params,
        Param("lag", 0.011, unit="s", low=0.0005, text="time constant of the rotors"),
    )

    def matrices(self, p: Any) -> tuple[Matrix, Matrix]:
        """Return the matrices of paper equations (3) to (6), with the rotors' moment."""
        return (
            ((0.0, 1.0, 0.0), (-(p.w_n * p.w_n), -2.0 * p.xi * p.w_n, p.mu), (0.0, 0.0, -(1.0 / p.lag))),
            ((0.0,), (0.0,), (1.0 / p.lag,)),
        )


@library_block("models.HeldVelocity")
class ZohVelocity(ZohPlant):
    """G_v and G_x, paper equation (9): v' = -p_v v - k_v theta, x' = v."""

    plant_states = (("x", "m"), ("v", "m/s"))
    plant_inputs = (Port("theta", unit="rad"),)
    plant_delays = MappingProxyType({"theta": "tau"})
    plant_params = (
        Param("k_v", 4.748, unit="m/s2", text="gain from pitch to deceleration"),
        Param("p_v", 1.168, unit="1/s", text="pole of the linear friction"),
    )

    def matrices(self, p: Any) -> tuple[Matrix, Matrix]:
        return ((0.0, 1.0), (0.0, -p.p_v)), ((0.0,), (-p.k_v,))


@library_block("models.HeldPitchAndVelocity")
class ZohPitchAndVelocity(ZohPlant):
    """G_q, then G_v, then G_x as one plant from M: paper Figure 6 with the loop open."""

    plant_states = (*ZohPitchRate.plant_states, *ZohVelocity.plant_states)
    plant_params = (*ZohPitchRate.plant_params, *ZohVelocity.plant_params)

    def matrices(self, p: Any) -> tuple[Matrix, Matrix]:
        """Return the matrices of paper equations (3) to (6) and (9)."""
        return (
            (
                (0.0, 1.0, 0.0, 0.0),
                (-(p.w_n * p.w_n), -2.0 * p.xi * p.w_n, 0.0, 0.0),
                (0.0, 0.0, 0.0, 1.0),
                (-p.k_v, 0.0, 0.0, -p.p_v),
            ),
            ((0.0,), (p.mu,), (0.0,), (0.0,)),
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

    def matrices(self, p: Any) -> tuple[Matrix, Matrix]:
        return ((p.X_u, p.X_q, -GRAVITY), (p.M_u, p.M_q, 0.0), (0.0, 1.0, 0.0)), ((p.X_d,), (p.M_d,), (0.0,))

    def readout(self, p: Any) -> tuple[Matrix, Matrix]:
        """Return the states and the accelerometer."""
        states, _ = super().readout(p)
        return [*states[:3], (p.X_u, p.X_q, 0.0)], ((0.0,), (0.0,), (0.0,), (p.X_d,))
