"""Linear models of the cascade's loops, controllers and rig together, and the margins of each."""

import functools
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Diagram
from twodof.blocks.declarations import unknown_name
from twodof.blocks.reference.interpreter import Reference
from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.linearize import linearize
from twodof.design import LoopMargins, LoopTransfer, margins
from twodof.flight.core import PreviousPitch, core
from twodof.flight.declarations import IMU, RANGE
from twodof.flight.estimator import PAIRS, LongitudinalFilter, Publisher, estimator
from twodof.flight.gains import DEFAULT, Gains
from twodof.rig.parameters import load_rig
from twodof.rig.rig import BASE_DT, SAMPLE, TRUTH, rig
from twodof.rig.rotors import RING
from twodof.signals import GRAVITY, HOVER, MODES, PERIOD

MOTORS = "motors"

LOOPS: Mapping[str, str] = MappingProxyType(
    {
        MOTORS: "at the moment M, rate and attitude loop closed: what the motors may do",
        "rate": "at q, in rate mode",
        "attitude": "at theta, the rate loop closed",
        "velocity": "at v, the loops inside closed",
        "position": "at x, the loops inside closed",
    }
)
"""The loops by name, and the signal at which each is opened."""

_BROKEN_AT = MappingProxyType({"rate": "q", "attitude": "theta", "velocity": "v", "position": "x"})


def cascade_loop(
    loop: str, gains: Gains = DEFAULT, controllers: Iterable[Diagram] = (), rig: str | Mapping[str, float] = "lab"
) -> LoopTransfer:
    """Return the loop transfer L of one of `LOOPS`, sampled at 250 Hz: the loops inside closed, those outside open.

    `rig` is "lab", "paper", a file, or the values of a rig's parameters by name. `controllers` fly in place of the
    stock ones; `gains` are those of the remaining stock loops. The rig is linear about hover (`linear_rig`). Raises
    DiagramError for an unknown loop, for a controller that fits no template, and for one without a slope in hover;
    ParameterError for another rig.
    """
    if loop not in LOOPS:
        raise unknown_name("loop", loop, LOOPS, "cascade_loop")
    values = load_rig(rig).snapshot() if isinstance(rig, str) else rig
    plant = linear_rig(values)
    law = linear_controller("attitude" if loop == MOTORS else loop, gains, controllers)
    m = len(law.a)
    if loop == MOTORS:
        # fore = T + M, aft = T - M; the thrust's way stays closed.
        moment, thrust = np.array([[0.5, -0.5]]), np.full((2, 2), 0.5)
        kept = plant.b @ thrust
        a = np.block([[plant.a + kept @ law.d @ plant.c, kept @ law.c], [law.b @ plant.c, law.a]])
        b = np.vstack([plant.b @ [[1.0], [-1.0]], np.zeros((m, 1))])
        c = -(moment @ np.hstack([law.d @ plant.c, law.c]))
        return LoopTransfer(a, b, c, 0.0, PERIOD, name=loop, input="M", output="M")
    broken = SIGNALS.index(_BROKEN_AT[loop])
    closed = np.ones((len(SIGNALS), 1))
    closed[broken] = 0.0
    read = closed * plant.c
    a = np.block([[plant.a + plant.b @ law.d @ read, plant.b @ law.c], [law.b @ read, law.a]])
    b = np.vstack([plant.b @ law.d[:, [broken]], law.b[:, [broken]]])
    c, signal = -np.hstack([plant.c[[broken]], np.zeros((1, m))]), _BROKEN_AT[loop]
    return LoopTransfer(a, b, c, 0.0, PERIOD, name=loop, input=signal, output=signal)


def cascade_margins(
    gains: Gains = DEFAULT,
    controllers: Iterable[Diagram] = (),
    rig: str | Mapping[str, float] = "lab",
    loops: Sequence[str] = tuple(LOOPS),
) -> dict[str, LoopMargins]:
    """Return the margins of each of `loops` (see `cascade_loop`): `cascade_margins(rig="paper")["rate"].disk`."""
    flown = tuple(controllers)
    return {loop: margins(cascade_loop(loop, gains, flown, rig)) for loop in loops}


Array = NDArray[np.float64]

READ = ("q", "theta", "v", "x")
"""Estimates that the cascade reads, from the inner loop outwards; theta is that of the previous sample."""

SIGNALS = (*READ, *IMU)
"""The outputs of the linear rig."""

_STILL = ("noise", "coulomb_idle", "coulomb_run", "rail_coulomb", "trim", "trim_start")
_AIR = ("battery.supply", "turbulence.moment")
_NEW_SAMPLE = 2**32 - 1  # of the range sensor's clock: it turns at the next tick


def linear_rig(values: Mapping[str, float]) -> LinearModel:
    """Return the linear model about hover of the rig and its estimator, from fore and aft to the outputs `SIGNALS`.

    `values` are the rig's parameters by name. Raises DiagramError if the rig has no slope there, such as on a stop.
    """
    return _linear_rig(tuple(sorted((name, float(value)) for name, value in values.items())))


@functools.lru_cache(8)
def _linear_rig(values: tuple[tuple[str, float], ...]) -> LinearModel:
    at: dict[str, Any] = dict(values) | dict.fromkeys(_STILL, 0.0)
    at |= {f"rotors.{pair}_ring": [HOVER] * RING for pair in ("fore", "aft")} | {"rotors.wake": 1.0}
    at |= {"battery.load": 1.0, "battery.polarised": 1.0}  # a pack at rest would give more thrust
    at |= {f"rotors.{pair}": HOVER for pair in ("fore", "aft")} | {"fore": HOVER, "aft": HOVER}
    moved = linearize(rig(), BASE_DT, at, ["fore", "aft", *_AIR], TRUTH)
    at = {f"rig.{name}": value for name, value in at.items() if name not in ("fore", "aft")}
    at |= {"rig.range.phase": _NEW_SAMPLE, "estimator.filter.started": True}
    at |= _filter_at_rest(float(dict(values)["tof_rate"]))
    outputs = ["estimator.filter.q", "previous.theta", "estimator.filter.v", "estimator.filter.x"]
    truth = [f"rig.dynamics.{name}" for name in TRUTH]
    # The loads matter to the noise only.
    loads = [f"rig.rotors.{name}" for name in ("load", "load_fore", "load_aft")]
    seen = linearize(_rig_and_estimator(), BASE_DT, at, [*truth, *loads], [*outputs, *IMU])
    return _published(_joined(moved, seen))


def _rig_and_estimator() -> Diagram:
    d = Diagram("linear_rig", "the rig and the estimator, up to what the controllers read")
    d.input("fore")
    d.input("aft")
    d.add("rig", rig(), fore="fore", aft="aft")
    d.add("estimator", estimator(), rate=SAMPLE)
    for name in (*IMU, *RANGE):
        d.connect(f"rig.{name}", f"estimator.{name}")
    d.add("previous", PreviousPitch(), rate=SAMPLE, theta="estimator.theta")
    for name in IMU:
        d.output(name, f"rig.{name}")
    return d


def _joined(moved: LinearModel, seen: LinearModel) -> LinearModel:
    """Hold the commands over the ticks of a step, and sample the outputs at its start."""
    a, b = moved.a, moved.b[:, :2]
    step, drive = np.eye(len(a)), np.zeros_like(b)
    for _ in range(SAMPLE[0]):
        step, drive = a @ step, a @ drive + b
    n, m, truth = len(a), len(seen.a), slice(len(TRUTH))
    whole = np.block([[step, np.zeros((n, m))], [seen.b[:, truth] @ moved.c, seen.a]])
    return LinearModel(
        whole,
        np.vstack([drive, np.zeros((m, 2))]),
        np.hstack([seen.d[:, truth] @ moved.c, seen.c]),
        np.zeros((len(SIGNALS), 2)),
        PERIOD,
        (*(f"rig.{name}" for name in moved.states), *seen.states),
        ("fore", "aft"),
        SIGNALS,
        name="linear_rig",
    )


def _filter_at_rest(samples_per_second: float) -> dict[str, float]:
    """States and parameters of the joint filter with a range sample of like weight at every step.

    A sample every n steps corrects by its gain; at every step a sample with n times the variance corrects by an n-th.
    The covariance is what the filter's comes to in level hover: F, H, Q and R are those of `LongitudinalFilter`.
    """
    from scipy.linalg import solve_discrete_are  # imported late: most commands start without it

    p = {param.name: float(param.value) for param in LongitudinalFilter().params}
    steps = max(1.0, 1.0 / (PERIOD * samples_per_second))
    sigma_range = p["sigma_range"] * float(np.sqrt(steps))
    f = np.eye(4)
    f[0, 1], f[2, 3] = -PERIOD, PERIOD
    f[2, 0], f[3, 0] = -0.5 * GRAVITY * PERIOD**2, -GRAVITY * PERIOD
    density = p["sigma_a"] ** 2
    q = np.diag(
        [p["sigma_gyro"] ** 2 * PERIOD, p["sigma_walk"] ** 2 * PERIOD, density * PERIOD**3 / 3, density * PERIOD]
    )
    q[2, 3] = q[3, 2] = 0.5 * density * PERIOD**2
    h = np.array([[-GRAVITY, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    r = np.diag([p["sigma_gravity"] ** 2, sigma_range**2])
    before = solve_discrete_are(f.T, h.T, q, r)
    after = before - before @ h.T @ np.linalg.solve(h @ before @ h.T + r, h @ before)
    names = ("theta", "bias", "x", "v")
    covariance = {f"estimator.filter.P_{a}_{b}": float(after[names.index(a), names.index(b)]) for a, b in PAIRS}
    return covariance | {"estimator.filter.sigma_range": sigma_range}


@functools.cache
def publishing_ages() -> tuple[float, ...]:
    """Return the shares of the steps at which a published estimate is 0, 1, 2, ... steps old.

    The estimator's publisher itself is run to find them.
    """
    d = Diagram("publishing")
    d.input("x", unit="m")
    d.input("v", unit="m/s")
    d.add("publisher", Publisher(), x="x", v="v")
    d.output("x", "publisher.x")
    steps = np.arange(100.0)
    read = Reference(d, PERIOD).machine().run(100, {"x": steps, "v": steps})["x"]
    ages = np.rint(steps - read).astype(int)[50:]  # 50 of 100: whole rounds of five steps
    return tuple((np.bincount(ages) / len(ages)).tolist())


def _published(model: LinearModel) -> LinearModel:
    """Return the model with v and x as they are published, on average."""
    shares = publishing_ages()
    n, oldest = len(model.a), len(shares) - 1
    late = [READ.index("v"), READ.index("x")]
    size = n + 2 * oldest
    a, b, c = np.zeros((size, size)), np.zeros((size, 2)), np.zeros((len(SIGNALS), size))
    a[:n, :n], b[:n], c[:, :n] = model.a, model.b, model.c
    for i, row in enumerate(late):
        first = n + i * oldest
        a[first, :n] = model.c[row]
        a[first + 1 : first + oldest, first : first + oldest - 1] = np.eye(oldest - 1)
        c[row] = 0.0
        c[row, :n] = shares[0] * model.c[row]
        c[row, first : first + oldest] = shares[1:]
    kept = [f"published.{READ[row]}[k-{k + 1}]" for row in late for k in range(oldest)]
    return LinearModel(a, b, c, model.d, PERIOD, (*model.states, *kept), model.inputs, SIGNALS, name=model.name)


_CONTROLLER_INPUTS = ("estimator.filter.q", "previous.theta", "estimator.publisher.v", "estimator.publisher.x", *IMU)
_ARMED, _HELD = 1000, 10**6  # steps since arming, and of the level hold: more than the flight code waits for


def linear_controller(mode: str, gains: Gains = DEFAULT, controllers: Iterable[Diagram] = ()) -> LinearModel:
    """Return the linear model of the controllers in `mode` ("rate", ...), level and at their set-points, at 250 Hz.

    The inputs are `SIGNALS`, the outputs fore and aft. `controllers` fly in place of the stock ones, as in
    `flight.core`. Raises DiagramError for a diagram that fits no template, and for a controller without a slope: a
    switch, a limit or a dead zone exactly at this point.
    """
    at = {
        "mode": MODES.index(mode),
        "thrust": HOVER,
        "acc_z": 0.0,
        "arming.count": _ARMED,
        "hold.samples": _HELD,
        "estimator.filter.started": True,
    }
    return linearize(
        core(gains, controllers=controllers), PERIOD, at, list(_CONTROLLER_INPUTS), ["fore", "aft"], time="discrete"
    )
