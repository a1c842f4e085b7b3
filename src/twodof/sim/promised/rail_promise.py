"""Promise for a step of velocity or position, from flights of an identified family on the virtual rig."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Diagram
from twodof.compile.builder import build
from twodof.compile.machine import CompiledProgram, Instances
from twodof.design.pitch_family import PitchFamily, check_covariance, draw_within, sigma_in
from twodof.design.promise import LEVEL, STEPS, Promise, check_numbers
from twodof.design.specification import Requirement, Specification, requirements
from twodof.errors import CompileError, ParameterError, shown
from twodof.flight.gains import DEFAULT, Gains
from twodof.rig.parameters import NAMES, load_rig
from twodof.rig.rig import BASE_DT
from twodof.signals import HOVER, MODES, PERIOD
from twodof.sim.closed_loop import ARMING, SETPOINTS, TICKS, closed_loop
from twodof.sim.linear import cascade_margins
from twodof.sim.resimulation import identified_rig

Array = NDArray[np.float64]

RAIL = ("k_v", "p_v")
_BOUNDS: Mapping[str, tuple[float, float]] = {"k_v": (0.1, 100.0), "p_v": (0.0, 50.0)}


@dataclass(frozen=True, eq=False)
class RailFamily:
    """Family of rigs: `pitch`, and the cart v = -k_v / (s + p_v) theta, `covariance` (2, 2) of (k_v [m/s2], p_v [1/s]).

    Everything else, such as sensors and battery, is that of the rig `base`. Raises ParameterError for values out of
    bounds and for a matrix that is not a covariance.
    """

    pitch: PitchFamily
    k_v: float
    p_v: float
    covariance: Array = field(default_factory=lambda: np.zeros((2, 2)))
    base: str = "paper"

    def __post_init__(self) -> None:
        for name, (low, high) in _BOUNDS.items():
            if not low <= getattr(self, name) <= high:
                raise ParameterError(
                    f"{name} = {getattr(self, name)!r} is out of bounds", "RailFamily", f"give {low:g} to {high:g}"
                )
        p = check_covariance(self.covariance, len(RAIL), "RailFamily")
        if (np.diag(p) < 0.0).any() or float(np.linalg.det(p)) < -1e-12 * float(np.prod(np.diag(p)) + 1e-300):
            raise ParameterError("the covariance is not positive semidefinite", "RailFamily", "identify again")

    @classmethod
    def from_identified(cls, pitch: object, rail: object, base: str | None = None, where: str = "model") -> Self:
        """Return the family of two documents of `twodof identify --out`: of the pitch, and of the cart (`rail`).

        Without `base` it is the rig that a document names, else `paper`. `where` names the documents in an error.
        Raises ParameterError for other documents, and without k_v or p_v.
        """
        family = PitchFamily.from_identified(pitch, where)
        flown = [one["rig"] for one in (pitch, rail) if isinstance(one, Mapping) and one.get("rig") in NAMES]
        base = base or next(iter(flown), NAMES[0])
        try:
            if not isinstance(rail, Mapping):
                raise TypeError(shown(rail))
            rows: Mapping[str, Any] = rail["estimates"]
            at = [list(rows).index(name) for name in RAIL]
            sigma = np.array([max(sigma_in(rows[n], key) for key in ("sigma", "sigma_robust")) for n in RAIL])
            correlation = np.array(rail["correlation"], dtype=float)[np.ix_(at, at)]
            correlation = np.where(np.isfinite(correlation), correlation, np.eye(2))
            k_v, p_v = (float(rows[name]["value"]) for name in RAIL)
        except (KeyError, TypeError, ValueError, IndexError) as reason:
            what = f"it is not a model of the cart ({type(reason).__name__}: {reason!s:.80})"
            remedy = "give a file that `twodof identify LOG --out` wrote for a velocity-doublet"
            raise ParameterError(what, where, remedy) from reason
        return cls(family, k_v, p_v, 0.5 * (correlation + correlation.T) * np.outer(sigma, sigma), base)

    def rigs(self, count: int, seed: int = 1) -> list[dict[str, float]]:
        """Return the parameters of `count` rigs, drawn members of the family with its gust and noise.

        Raises ParameterError as `PitchFamily.draw`, and for a member that is not a possible rig.
        """
        drawn, cart = self.pitch.draw(count, seed), self._cart(count, np.random.default_rng(seed + 1))
        base = dict(load_rig(self.base).snapshot())
        gusts = np.transpose(self.pitch.gusts(count, seed)).tolist()
        return [self._rig(drawn.one(k), cart[k], base, gusts[k]) for k in range(count)]

    def nominal(self) -> dict[str, float]:
        """Return the parameters of the rig with the estimated values."""
        base = dict(load_rig(self.base).snapshot())
        return self._rig(
            self.pitch.nominal().one(0), np.array([self.k_v, self.p_v]), base, (self.pitch.gust, self.pitch.gust_time)
        )

    def _rig(
        self, member: Mapping[str, float], cart: Array, base: Mapping[str, float], gust: Sequence[float]
    ) -> dict[str, float]:
        tau = member["dead_time"] + member["lag"]
        model = {**member, "tau": tau, "k_v": float(cart[0]), "p_v": float(cart[1])}
        # The pitch's stiffness is that in flight, where running rotors take no more of it away.
        rig = identified_rig(model, {**base, "softening": 0.0})
        if self.pitch.gust > 0.0:
            rig["gust"], rig["gust_time"] = gust[0] * rig["inertia"], gust[1]
        if self.pitch.q_noise > 0.0:
            rig["gyro_hover"], rig["gyro_line"] = self.pitch.q_noise, 0.0
        if self.pitch.q_band[1] > 0.0:
            rig["vibration_hz"], rig["vibration_r2"] = self.pitch.q_band
        return rig

    def _cart(self, count: int, rng: np.random.Generator) -> Array:
        """(count, 2), drawn again where it is beyond the bounds."""
        bounds = np.array([_BOUNDS[name] for name in RAIL])
        values, vectors = np.linalg.eigh(np.asarray(self.covariance, dtype=float))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        return draw_within(np.array([self.k_v, self.p_v]), root, bounds, count, rng)

    def to_json(self) -> dict[str, Any]:
        """Return plain data."""
        cart = {"k_v": self.k_v, "p_v": self.p_v, "covariance": np.asarray(self.covariance).tolist()}
        return {"pitch": self.pitch.to_json(), **cart, "base": self.base}


HOLD = 8.0
"""Time from the start of the motors to the step [s], as in the experiments."""

BEFORE = 125
"""Number of samples kept before the step: .5 s."""

_CHUNK = 250  # steps between two calls of `progress`


@dataclass(frozen=True, eq=False)
class RigFlights:
    """Flights of several rigs: `time` (steps,) [s], 0 at the step, from `BEFORE` samples earlier; `channels` by name.

    Each channel is (steps, rigs).
    """

    time: Array
    channels: Mapping[str, Array]


def fly_rigs(
    rigs: Sequence[Mapping[str, float]],
    setpoint: str,
    goal: float,
    duration: float,
    *,
    gains: Gains = DEFAULT,
    tuned: Mapping[str, Sequence[Any]] = MappingProxyType({}),
    controllers: Iterable[Diagram] = (),
    read: Sequence[str] = ("theta", "q", "M"),
    seed: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> RigFlights:
    """Fly all `rigs` with `setpoint` ("theta0", "v0" or "x0") at 0, then at `goal` for `duration` [s].

    Each of `rigs` is a rig's parameters by name; the k-th has the noise of `seed` + k. `read` names the outputs of the
    closed loop to return. `gains` are those of the stock loops, and `controllers` fly in place of some. `tuned` are
    parameters of the closed loop by path, a value for each rig. `progress` is called with the share done; an exception
    that it raises ends the flights. Raises ParameterError for another set-point, and as `closed_loop` and `build`.
    """
    modes = {"theta0": "attitude", "v0": "velocity", "x0": "position"}
    if setpoint not in modes:
        raise ParameterError(f"no step is defined for {setpoint!r:.40}", "fly_rigs", f"give one of {', '.join(modes)}")
    program = build(closed_loop(gains, controllers=controllers), BASE_DT)
    if not isinstance(program, CompiledProgram):
        raise CompileError("flights of many rigs need a C compiler", "fly_rigs", "install gcc, or the wheel ziglang")
    machine = Instances(program, len(rigs))
    values = {f"rig.{name}": [rig[name] for rig in rigs] for name in rigs[0]}
    # As the experiments have it, rings lock the cart while the pitch is stepped.
    values["rig.rings"] = [setpoint == "theta0"] * len(rigs)
    values |= {"rig.noise": [rig.get("noise", 1.0) for rig in rigs], "rig.seed": [seed + k for k in range(len(rigs))]}
    machine.set_many(values | dict(tuned))
    machine.reset()
    still = ARMING + 100
    begin = still + round(HOLD / PERIOD)
    steps = begin + round(duration / PERIOD) + 1
    kept: dict[str, list[Array]] = {name: [] for name in read}
    for first in range(0, steps, _CHUNK):
        progress(first / steps)
        k = np.arange(first, min(first + _CHUNK, steps))
        given = {name: np.zeros(len(k)) for name in SETPOINTS}
        given |= {name: np.zeros(len(k), dtype=bool) for name in ("in_reset", "use_trim")}
        given["mode"] = np.where(k < still, 0, MODES.index(modes[setpoint])).astype(np.int32)
        given["thrust"] = np.where(k < still, 0.0, HOVER)
        given[setpoint] = np.where(k < begin, 0.0, goal)
        out = machine.run(len(k) * TICKS, {name: np.repeat(column, TICKS) for name, column in given.items()})
        for name in read:
            kept[name].append(np.asarray(out[name][::TICKS], dtype=float)[k >= begin - BEFORE])
    time = np.asarray((np.arange(begin - BEFORE, steps) - begin) * PERIOD, dtype=np.float64)
    return RigFlights(time, {name: np.concatenate(parts) for name, parts in kept.items()})


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
    """Return the promise for a step of `loop`: figures that a share `level` of the family's `members` keeps.

    The members fly on the virtual rig with all noise and limits. `goal` [m/s or m] and `duration` [s] are by default
    those of `STEPS`. `progress` is called with the share done. Raises ParameterError for numbers out of range, and as
    `RailFamily.rigs` and `fly_rigs`.
    """
    if loop not in LOOPS:
        raise ParameterError(f"no promise is defined for {shown(loop)}", "rail_promise", f"give {' or '.join(LOOPS)}")
    step = STEPS[loop]
    goal, duration = step.goal if goal is None else goal, step.duration if duration is None else duration
    if not 0.01 <= goal <= 1.0:
        raise ParameterError(f"a step of {goal!r} is out of bounds", "rail_promise", "give .01 to 1 m/s or m")
    check_numbers(duration, level, members, (_LEAST_MEMBERS, _MOST_MEMBERS))
    rigs, diagrams = family.rigs(members, seed), tuple(controllers)
    flown = fly_rigs(
        rigs,
        step.setpoint,
        goal,
        duration,
        gains=gains,
        controllers=diagrams,
        read=(*step.channels, "true_x"),
        seed=1000 * seed,
        progress=progress,
    ).channels
    name = ", ".join(one.name for one in diagrams) or "the stock cascade"
    lost = _lost(flown, rigs, step.follows, goal)
    return Promise.of_flights(name, family.to_json(), loop, goal, level, seed, lost, from_step(flown, loop))


def from_step(flown: Mapping[str, Array], loop: str) -> dict[str, Array]:
    """Return the channels of a promise from the step on, from flights that begin `BEFORE` samples earlier.

    Channels in the step's `zeroed` are taken relative to their mean before the step.
    """
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
    """Return each requirement of `specification` for the rail's loops with the figure of `gains` and `controllers`.

    Bandwidths and margins are those of the family's estimated rig, sampled and with the estimator (`cascade_margins`);
    the worse of both loops counts. A figure of the step is judged by the worse end of the `promised` interval. Raises
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
