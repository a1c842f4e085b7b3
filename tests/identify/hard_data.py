"""Small sets of data that a fit may get wrong: unstable, drifting, jittered, short, offset and mis-scaled ones."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

from twodof.identify import Estimate, Record, fit
from twodof.identify.ready_made import AUTO, by_output_error, structure_for
from twodof.models.structure import Structure, linear_model
from twodof.models.structures import pitch_rate

Array = NDArray[np.float64]


def held(a: Array, b: Array, dt: float) -> tuple[Array, Array]:
    """Return Phi and Gamma of a step over which the input is held."""
    n = a.shape[0]
    both = expm(dt * np.block([[a, b], [np.zeros((1, n + 1))]]))
    return both[:n, :n], both[:n, n:]


def simulated(
    a: ArrayLike,
    b: ArrayLike,
    applied: Array,
    dt: float,
    *,
    feedback: float | ArrayLike = 0.0,
    noise: float = 0.0,
    push: float = 0.0,
    start: float = 0.0,
    seed: int = 1,
) -> tuple[Array, Array]:
    """Return input and measured first state of x' = A x + B (u + push), with u = `applied` - `feedback` x measured."""
    a, b = np.atleast_2d(np.asarray(a, dtype=float)), np.asarray(b, dtype=float).reshape(-1, 1)
    phi, gamma = held(a, b, dt)
    rng = np.random.default_rng(seed)
    x, u, y = np.zeros(a.shape[0]), np.zeros(applied.size), np.zeros(applied.size)
    x[0] = start
    gains, before = np.atleast_1d(np.asarray(feedback, dtype=float)), 0.0
    for k in range(applied.size):
        y[k] = x[0] + noise * rng.standard_normal()
        rates = np.array([y[k], (y[k] - before) / dt])[: gains.size]
        u[k], before = applied[k] - float(gains @ rates), y[k]
        x = phi @ x + gamma[:, 0] * (u[k] + push * rng.standard_normal())
    return u, y


def switching(steps: int, hold: int = 10, size: float = 1.0, seed: int = 2) -> Array:
    """Return a random binary signal that stays for `hold` steps."""
    signs = np.random.default_rng(seed).choice([-size, size], -(-steps // hold))
    return np.repeat(signs, hold)[:steps]


def motor(a: float = -1.0, b: float = 1.0) -> Structure:
    """Return y' = a y + b u with a first guess."""
    return linear_model([["a"]], [["b"]], [[1]], inputs=["u"], outputs=["y"], guess={"a": a, "b": b})


def spring(**guess: float) -> Structure:
    """Return y'' = -k y - d y' + g u with a first guess."""
    guess = {"k": 30.0, "d": 1.0, "g": 40.0} | guess
    return linear_model([[0, 1], ["-k", "-d"]], [[0], ["g"]], [[1, 0]], inputs=["u"], outputs=["y"], guess=guess)


MOTOR = {"a": -2.0, "b": 3.0}
PROCESS = {"K": 3.0, "Tw": 0.25, "zeta": 0.2}
SPRING = {"k": 40.0, "d": 1.5, "g": 60.0}
DT = 0.02


def motor_data(steps: int = 400, noise: float = 0.02, seed: int = 1) -> tuple[Array, Array, Array]:
    """Return time, input and output of the motor."""
    u, y = simulated(MOTOR["a"], [MOTOR["b"]], switching(steps), DT, noise=noise, seed=seed)
    return DT * np.arange(steps), u, y


def spring_data(steps: int = 400, noise: float = 0.02, seed: int = 1) -> tuple[Array, Array, Array]:
    """Return time, input and output of the spring."""
    u, y = simulated([[0, 1], [-40, -1.5]], [0, 60], switching(steps), DT, noise=noise, seed=seed)
    return DT * np.arange(steps), u, y


def record(time: ArrayLike, u: ArrayLike, y: ArrayLike, **options: Any) -> Record:
    """Return a record of the columns."""
    return Record.from_columns(time, {"u": u, "y": y}, ["u"], ["y"], **options)


def unstable(a: float, gain: float, steps: int = 400, dt: float = 0.01, **options: Any) -> Record:
    """Return a record of y' = a y + u, held by u = -gain y."""
    u, y = simulated(a, [1.0], switching(steps), dt, feedback=gain, noise=0.01, **options)
    return record(dt * np.arange(steps), u, y)


def inverted(push: float = 0.0, steps: int = 600) -> Record:
    """Return a record of y'' = 30 y - y' + 50 u, held by proportional and differential feedback."""
    a = [[0.0, 1.0], [30.0, -1.0]]
    u, y = simulated(a, [0, 50], 0.3 * switching(steps, 15), 0.01, feedback=[3.0, 0.3], noise=2e-3, push=push)
    return record(0.01 * np.arange(steps), u, y)


def drift(steps: int, deviation: float, seed: int = 5) -> Array:
    """Return a random walk."""
    return deviation * np.cumsum(np.random.default_rng(seed).standard_normal(steps))


def jittered(jitter: float, steps: int = 400, seed: int = 0) -> Record:
    """Return a motor's record at 10 ms whose stamps jitter by this deviation [s]; the input moves at the stamps."""
    rng = np.random.default_rng(seed)
    when = np.unique(np.round(10 * np.arange(steps) + 1e3 * jitter * rng.standard_normal(steps))).astype(int)
    when -= when[0]
    u = switching(when.size, 40)
    _, y = simulated(MOTOR["a"], [MOTOR["b"]], np.repeat(u[:-1], np.diff(when)), 1e-3)
    return record(1e-3 * when[:-1], u[:-1], y[when[:-1]] + 0.02 * rng.standard_normal(when.size - 1))


def pendulum(dry: float, steps: int = 2500, damping: float = 0.03) -> Record:
    """Return a free response to an impulse of M of a pendulum with dry friction [rad/s2]."""
    dt, inner = 0.004, 10
    rng = np.random.default_rng(3)
    moment = np.zeros(steps)
    moment[50:100] = 0.05
    theta, q, seen = 0.0, 0.0, np.zeros(steps)
    for k in range(steps):
        seen[k] = q
        for _ in range(inner):
            drive = 250.0 * moment[k] - 2.81**2 * theta - 2.0 * damping * 2.81 * q
            if q == 0.0 and abs(drive) <= dry:
                continue
            more = q + dt / inner * (drive - dry * np.sign(q or drive))
            q = 0.0 if q * more < 0.0 else more
            theta += dt / inner * q
    seen += 0.02 * rng.standard_normal(steps)
    return Record.from_columns(dt * np.arange(steps), {"M": moment, "q": seen}, ["M"], ["q"], name="impulse")


def smooth_input(hold: str = "zoh") -> Record:
    """Return a record of a fast spring behind an anti-alias filter: the input moves on between its samples."""
    inner, steps = 20, 600
    rng = np.random.default_rng(4)
    lines = rng.uniform(1.0, 18.0, 30)
    fine = DT / inner * np.arange(inner * steps)
    u = np.sin(2 * np.pi * np.outer(fine, lines) + rng.uniform(0, 6, 30)).sum(axis=1) / 5.0
    _, y = simulated([[0, 1], [-2000, -8]], [0, 3000], u, DT / inner)
    return record(fine[::inner], u[::inner], y[::inner] + 1e-3 * rng.standard_normal(steps), hold=hold)


def _process(change: Callable[[Array, Array, Array], tuple[ArrayLike, ArrayLike, ArrayLike]]) -> Any:
    """Return the fit of 3 / (s^2 / 16 + .1 s + 1) as a process model, after this change of its data."""
    applied = switching(1500, 40)
    u, x = simulated([[0, 1], [-16, -1.6]], [0, 16], applied, DT)
    y = 3.0 * x + 0.05 * np.random.default_rng(11).standard_normal(u.size)
    return lambda: fit("process:P2U", record(*change(DT * np.arange(u.size), u, y)))


def _at_rest(t: Array, u: Array, y: Array) -> tuple[Array, Array, Array]:
    return t, np.ones_like(u), 3.0 + 0.05 * np.random.default_rng(13).standard_normal(t.size)


def _resonance_above_half_the_rate() -> Estimate:
    u = switching(1500, 5)
    _, x = simulated([[0, 1], [-1600, -4]], [0, 1600], np.repeat(u, 100), 1e-3)
    y = x[::100] + 0.01 * np.random.default_rng(12).standard_normal(u.size)
    return fit("process:P2U", record(0.1 * np.arange(u.size), u, y))


@dataclass(frozen=True)
class Case:
    """Set of data: the fit to try, the truth, and words of its refusal or note. Without words the fit must be right."""

    make: Callable[[], Estimate]
    truth: Mapping[str, float]
    words: str = ""


def _columns(change: Callable[[Array, Array, Array], tuple[ArrayLike, ArrayLike, ArrayLike]], **options: Any) -> Any:
    return lambda: fit(motor(), record(*change(*motor_data())), **options)


def _spring(change: Callable[[Array, Array, Array], tuple[ArrayLike, ArrayLike, ArrayLike]], model: str = "") -> Any:
    return lambda: fit(model or spring(), record(*change(*spring_data())))


def _gap(t: Array, u: Array, y: Array) -> tuple[Array, Array, Array]:
    keep = (t < 3.0) | (t > 4.0)
    return t[keep], u[keep], y[keep]


def _lost(t: Array, u: Array, y: Array) -> tuple[Array, Array, Array]:
    keep = np.random.default_rng(7).random(t.size) > 0.1
    return t[keep], u[keep], y[keep]


def _spikes(t: Array, u: Array, y: Array) -> tuple[Array, Array, Array]:
    y = y.copy()
    y[[50, 120, 333]] += 20.0
    return t, u, y


def free(structure: str) -> Estimate:
    """Return the fit of a free response with dry friction, as command and page make it."""
    found, _ = by_output_error("impulse", structure_for("impulse", structure), [pendulum(0.6)])
    assert isinstance(found, Estimate)
    return found


def _in_degrees() -> Estimate:
    one = pendulum(0.0)
    return fit(
        pitch_rate(), replace(one, outputs={"q": replace(one.outputs["q"], value=one.outputs["q"].value * 57.3)})
    )


def _late(seconds: float) -> Any:
    """Return the fit of a motor whose input is logged this long after it acts, or before it if below 0."""
    k = round(seconds / DT)
    return _columns(lambda t, u, y: (t[abs(k) :], u[: u.size - k] if k > 0 else u[-k:], y[k:] if k > 0 else y[:k]))


def _driven(u: ArrayLike, dt: float = DT, noise: float = 0.02, start: float = 0.0) -> Any:
    """Return the fit of a motor under this input."""
    applied = np.asarray(u, dtype=float)
    _, y = simulated(MOTOR["a"], [MOTOR["b"]], applied, dt, noise=noise, start=start)
    return lambda: fit(motor(), record(dt * np.arange(applied.size), applied, y))


def _weak_actuator() -> Estimate:
    asked = np.repeat(np.random.default_rng(9).uniform(-1.5, 1.5, 40), 10)
    _, y = simulated(MOTOR["a"], [MOTOR["b"]], np.clip(asked, -0.5, 0.5), DT, noise=0.02)
    return fit(motor(), record(DT * np.arange(400), asked, y))


def _ageing() -> Estimate:
    t, u, _ = motor_data()
    _, y = simulated(MOTOR["a"], [MOTOR["b"]], u * np.linspace(1.0, 0.5, u.size), DT, noise=0.02)
    return fit(motor(), record(t, u, y))


def _undershooting() -> tuple[Array, Array, Array]:
    """Return data of y = (40 - 8 s) / (s^2 + 3 s + 40) u, which begins in the wrong direction."""
    u, x = switching(400), np.zeros(2)
    phi, gamma = held(np.array([[0.0, 1.0], [-40.0, -3.0]]), np.array([[0.0], [1.0]]), DT)
    rng, y = np.random.default_rng(6), np.zeros(400)
    for k in range(400):
        y[k] = 40.0 * x[0] - 8.0 * x[1] + 0.02 * rng.standard_normal()
        x = phi @ x + gamma[:, 0] * u[k]
    return DT * np.arange(400), u, y


def _with_zero() -> Structure:
    a, c = [[0, 1], ["-k", "-d"]], [["c0", "c1"]]
    guess = {"k": 30.0, "d": 1.0, "c0": 30.0, "c1": 1.0}
    return linear_model(a, [[0], [1]], c, inputs=["u"], outputs=["y"], guess=guess)


def _controlled(applied: Array, gain: float, noise: float) -> Estimate:
    u, y = simulated(MOTOR["a"], [MOTOR["b"]], applied, DT, feedback=gain, noise=noise)
    return fit(motor(), record(DT * np.arange(applied.size), u, y))


def _twin_inputs() -> Estimate:
    t, u, y = motor_data()
    guess = {"a": -1.0, "b": 1.0, "c": 1.0}
    two = linear_model([["a"]], [["b", "c"]], [[1]], inputs=["u", "w"], outputs=["y"], guess=guess)
    return fit(two, Record.from_columns(t, {"u": u, "w": 2.0 * u, "y": y}, ["u", "w"], ["y"]))


def _play(y: Array, width: float) -> Array:
    """Return the motion behind a play of this half width."""
    behind = np.zeros_like(y)
    for k in range(1, y.size):
        behind[k] = min(max(behind[k - 1], y[k] - width), y[k] + width)
    return behind


def _few(t: Array, u: Array, y: Array) -> tuple[Array, Array, Array]:
    keep = np.random.default_rng(8).random(t.size) > 0.6
    return t[keep], u[keep], y[keep]


def _slower(t: Array, u: Array, y: Array) -> tuple[Array, Array, Array]:
    keep = np.concatenate([np.arange(200), np.arange(200, 400, 2)])
    return t[keep], u[keep], y[keep]


CASES: Mapping[str, Case] = {
    # unstable
    "unstable, closed loop": Case(lambda: fit(motor(5.0), unstable(25.0, 40.0)), {"a": 25.0, "b": 1.0}),
    "unstable, guessed stable": Case(lambda: fit(motor(), unstable(3.0, 8.0)), {"a": 3.0, "b": 1.0}),
    "unstable, pushed": Case(lambda: fit(motor(5.0), unstable(5.0, 12.0, push=0.3)), {"a": 5.0, "b": 1.0}),
    "unstable, open loop": Case(lambda: fit(motor(1.0), unstable(2.0, 0.0, steps=150)), {"a": 2.0, "b": 1.0}),
    "inverted pendulum": Case(lambda: fit(spring(k=-20.0), inverted()), {"k": -30.0, "d": 1.0, "g": 50.0}),
    "inverted pendulum, pushed": Case(lambda: fit(spring(k=-20.0), inverted(0.2)), {"k": -30.0, "g": 50.0}),
    "unstable, by output error": Case(
        lambda: fit(motor(5.0), unstable(25.0, 40.0), disturbance="white"), {"a": 25.0}, "diverges|not finite"
    ),
    # drifting
    "integrator under a gust": Case(lambda: fit(motor(-0.1), unstable(0.0, 4.0, push=0.5)), {"b": 1.0}),
    "output drifts along a line": Case(_columns(lambda t, u, y: (t, u, y + 0.3 * t)), MOTOR, "wanders"),
    "output walks": Case(_columns(lambda t, u, y: (t, u, y + drift(t.size, 0.05))), MOTOR, "wanders"),
    "output swings slowly": Case(_columns(lambda t, u, y: (t, u, y + np.sin(0.7 * t))), MOTOR, "wanders"),
    "coloured noise": Case(
        _columns(lambda t, u, y: (t, u, y + lfilter([0.1], [1, -0.9], np.random.default_rng(3).standard_normal(400)))),
        MOTOR,
    ),
    # jittered
    "jitter of 2 ms": Case(lambda: fit(motor(), jittered(0.002, seed=15)), MOTOR),
    "jitter of 4 ms": Case(lambda: fit(motor(), jittered(0.004, seed=1)), MOTOR),
    "one sample in ten lost": Case(_spring(_lost), SPRING),
    "a second is missing": Case(_spring(_gap), SPRING, "gap"),
    "a stamp comes twice": Case(_columns(lambda t, u, y: (np.where(t == t[7], t[6], t), u, y)), MOTOR, "increase"),
    "the clock falls back": Case(_columns(lambda t, u, y: (np.where(t > 4.0, t - 1.0, t), u, y)), MOTOR, "increase"),
    # short
    "three samples": Case(_columns(lambda t, u, y: (t[:3], u[:3], y[:3])), MOTOR, "3 samples"),
    "two samples": Case(_columns(lambda t, u, y: (t[:2], u[:2], y[:2])), MOTOR, "2 samples|tell apart"),
    "six samples": Case(_columns(lambda t, u, y: (t[:6], u[:6], y[:6])), MOTOR, "few"),
    "before the excitation": Case(_spring(lambda t, u, y: (t, 0.0 * u, 0.01 * y)), SPRING, "say nothing|tell apart"),
    # offset
    "output far from 0": Case(_columns(lambda t, u, y: (t, u, y + 50.0)), MOTOR, "far from 0"),
    "input far from 0": Case(_spring(lambda t, u, y: (t, u + 20.0, y)), SPRING, "far from 0"),
    "output a little off": Case(_columns(lambda t, u, y: (t, u, y + 1.0)), MOTOR, "bias|trim"),
    "input a little off": Case(_spring(lambda t, u, y: (t, u + 1.0, y)), SPRING, "trim|bias"),
    # mis-scaled
    "time in milliseconds": Case(_spring(lambda t, u, y: (1e3 * t, u, y)), SPRING, "milliseconds"),
    "pitch rate in degrees": Case(_in_degrees, {"mu": 250.0}, "degrees"),
    "input in millionths": Case(_columns(lambda t, u, y: (t, 1e6 * u, y)), {"a": -2.0, "b": 3e-6}),
    "output upside down": Case(_spring(lambda t, u, y: (t, u, -y)), {**SPRING, "g": -60.0}),
    # wrong about the machine or the sensor
    "dry friction": Case(lambda: free("pitch-rate"), {"w_n": 2.81, "xi": 0.03}, "free-response"),
    "dry friction, by default": Case(lambda: free(AUTO), {"w_n": 2.81, "xi": 0.03, "coulomb": 0.6}),
    "input moves between samples": Case(
        lambda: fit(spring(k=2000.0, d=8.0, g=3000.0), smooth_input()),
        {"k": 2000.0, "d": 8.0, "g": 3000.0},
        "band-limited",
    ),
    "output saturates": Case(_columns(lambda t, u, y: (t, u, np.clip(y, -0.5, 0.5))), MOTOR, "depends on|leaves"),
    "a process drifts along a line": Case(_process(lambda t, u, y: (t, u, y + 0.5 * t + 20.0)), PROCESS, "drift"),
    "output error in steps, drifting": Case(_spring(lambda t, u, y: (t, u, y + 0.5 * t), "oe:2,2,1"), {}, "drift"),
    "a process at its limits": Case(_process(lambda t, u, y: (t, u, np.clip(y, -2.0, 2.0))), PROCESS, "limit"),
    "a process at rest": Case(_process(_at_rest), PROCESS, "never moves"),
    "a process of microseconds": Case(_process(lambda t, u, y: (1e-4 * t, u, y)), {**PROCESS, "Tw": 0.25e-4}),
    "a process in its smallest units": Case(_process(lambda t, u, y: (t, 1e9 * u, 1e-9 * y)), {**PROCESS, "K": 3e-18}),
    "a resonance above half the rate": Case(_resonance_above_half_the_rate, PROCESS, "depends on"),
    "spikes": Case(_spring(_spikes), SPRING),
    "a delay is left out": Case(_spring(lambda t, u, y: (t[5:], u[5:], y[:-5])), SPRING, "leaves out"),
    "damping below 0": Case(lambda: fit(pitch_rate(), pendulum(0.0, damping=-0.01)), {"w_n": 2.81}, "negative"),
    "not a number": Case(_columns(lambda t, u, y: (t, u, np.where(t == t[9], np.nan, y))), MOTOR, "finite"),
    "output stands still": Case(_columns(lambda t, u, y: (t, u, 0.0 * y)), MOTOR, "constant|nothing"),
    "without noise": Case(lambda: fit(spring(), record(*spring_data(noise=0.0))), SPRING),
    # more of the sensor
    "integers": Case(_columns(lambda t, u, y: (t, u, np.round(5.0 * y) / 5.0)), MOTOR),
    "bytes": Case(
        _columns(lambda t, u, y: (t, (50.0 * u + 100.0).astype(np.uint8), (50.0 * y + 100.0).astype(np.uint8))),
        MOTOR,
        "bias|trim",
    ),
    "thousandths": Case(_columns(lambda t, u, y: (t, u, np.round(1e3 * y).astype(int))), {"a": -2.0, "b": 3e3}),
    "billionths of a thousandth": Case(_columns(lambda t, u, y: (t, u, 1e-12 * y)), MOTOR, "times as large"),
    "a billion too much": Case(_columns(lambda t, u, y: (t, u, y + 1e9)), MOTOR, "far from 0"),
    "sensor stops": Case(_columns(lambda t, u, y: (t, u, np.where(t < 4.0, y, y[200]))), MOTOR, "stands still from 4"),
    "sensor is late": Case(_columns(lambda t, u, y: (t, u, y[np.arange(y.size) // 5 * 5])), MOTOR, "depends on"),
    "mains hum": Case(_columns(lambda t, u, y: (t, u, y + 0.8 * np.sin(151.0 * t))), MOTOR),
    "more noise than signal": Case(_driven(switching(4000), noise=1.5), MOTOR),
    "squared": Case(_columns(lambda t, u, y: (t, u, y * y)), MOTOR, "hardly tell"),
    "wraps at a turn": Case(
        _columns(lambda t, u, y: (t, u, (4.0 * y + np.pi) % (2.0 * np.pi) - np.pi)), MOTOR, "hardly tell"
    ),
    "play behind the motor": Case(_columns(lambda t, u, y: (t, u, _play(y, 0.3))), MOTOR, "wanders"),
    "a step of the zero": Case(_columns(lambda t, u, y: (t, u, y + (t > 4.0))), MOTOR, "bias|wanders"),
    "a block of NaN": Case(
        _columns(lambda t, u, y: (t, u, np.where((t > 2.0) & (t < 2.4), np.nan, y))), MOTOR, "not finite"
    ),
    "infinite input": Case(_columns(lambda t, u, y: (t, np.where(t == t[9], np.inf, u), y)), MOTOR, "not finite"),
    "complex output": Case(_columns(lambda t, u, y: (t, u, y + 0.1j)), MOTOR, "complex"),
    # more of the input
    "input logged late": Case(_late(0.2), MOTOR, "leaves something out"),
    "output logged late": Case(_late(-0.2), MOTOR, "leaves out"),
    "actuator saturates": Case(_weak_actuator, MOTOR, "wanders"),
    "gain falls by half": Case(_ageing, MOTOR, "wanders"),
    "input stands still": Case(_driven(np.ones(400)), MOTOR),
    "input stands still, settled": Case(_driven(np.ones(400), start=1.5), MOTOR, "hardly tell"),
    "one sample of input": Case(_driven(10.0 * np.eye(1, 400, 20)[0], noise=0.005), MOTOR),
    "nothing applied, in motion": Case(_driven(np.zeros(400), start=2.0), MOTOR, "say nothing"),
    "twin inputs": Case(_twin_inputs, MOTOR, "tell apart 'b' and 'c'"),
    "output is the input": Case(_spring(lambda t, u, y: (t, u, u)), SPRING, "is the input"),
    "columns swapped": Case(_columns(lambda t, u, y: (t, y, u)), MOTOR, "unstable"),
    "noise alone": Case(
        _columns(lambda t, u, y: (t, u, np.random.default_rng(3).standard_normal(t.size))), MOTOR, "hardly tell"
    ),
    # more of the plant
    "begins in the wrong direction": Case(
        lambda: fit(_with_zero(), record(*_undershooting())), {"k": 40.0, "d": 3.0, "c0": 40.0, "c1": -8.0}
    ),
    "without its zero": Case(lambda: fit(spring(), record(*_undershooting())), SPRING, "leaves out"),
    "too many states": Case(lambda: fit(spring(), record(*motor_data())), MOTOR, "fewer states|hardly tell"),
    "too few states": Case(lambda: fit(motor(), record(*spring_data())), SPRING, "wanders"),
    "controlled": Case(lambda: _controlled(4.0 * switching(400), 2.0, 0.02), MOTOR),
    "controlled, not excited": Case(lambda: _controlled(np.zeros(400), 2.0, 0.05), MOTOR, "hardly tell|depends on"),
    # more of the clock
    "a microsecond a step": Case(_driven(switching(400), dt=1e-6), MOTOR, "say nothing|tell apart|hardly tell|at rest"),
    "two steps in a time constant": Case(_driven(switching(400, 3), dt=0.25), MOTOR),
    "time since 1970": Case(_columns(lambda t, u, y: (t + 1.764e9, u, y)), MOTOR),
    "each row twice": Case(_columns(lambda t, u, y: (t.repeat(2), u.repeat(2), y.repeat(2))), MOTOR, "increase"),
    "backwards": Case(_columns(lambda t, u, y: (t[::-1], u, y)), MOTOR, "increase"),
    "half as often from the middle on": Case(_columns(_slower), MOTOR),
    "most samples lost": Case(_spring(_few), SPRING, "gaps"),
    "time in microseconds": Case(_spring(lambda t, u, y: (np.round(1e6 * t), u, y)), SPRING, "microseconds"),
}
