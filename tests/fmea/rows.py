"""The rows of the hazard analysis: what fails and how, and where it is flown."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from tests.fmea.faults import FLAG_KINDS, KINDS

ATTITUDE, HOLD, RATE, OPEN, POSITION, STEPS, VELOCITY, OWN, OWN_POSITION = (
    "attitude",
    "hold",
    "rate",
    "open loop",
    "position",
    "position steps",
    "velocity",
    "own attitude",
    "own position",
)
SITUATIONS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        ATTITUDE: {"mode": 3, "thrust": 0.4, "theta0": 0.4, "half": 1500, "rings": True},
        HOLD: {"mode": 3, "thrust": 0.4, "rings": False},
        RATE: {"mode": 2, "thrust": 0.4, "rings": True},
        OPEN: {"mode": 1, "thrust": 0.1, "rings": True},
        POSITION: {"mode": 5, "x0": 0.25, "rings": False},
        STEPS: {"mode": 5, "x0": 0.15, "half": 2000, "rings": False},
        VELOCITY: {"mode": 4, "v0": 0.3, "half": 500, "rings": False},
        OWN: {"mode": 3, "thrust": 0.4, "rings": True, "own": True},
        OWN_POSITION: {"mode": 5, "x0": 0.25, "rings": False, "own": True},
    }
)
"""What is flown when the fault comes, by the parameters of the script."""

PITCHING = (ATTITUDE, POSITION, VELOCITY)
SLIDING = (POSITION, STEPS, VELOCITY)
ALL = (ATTITUDE, HOLD, POSITION, VELOCITY)


@dataclass(frozen=True)
class Row:
    """A fault: the component, what happens to it, the parameters of the loop that make it, where it is flown.

    `changes` are parameters that are changed in flight.
    """

    component: str
    text: str
    faults: Mapping[str, Any]
    situations: tuple[str, ...]
    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Component and fault, unique."""
        return f"{self.component}: {self.text}"


def number(channels: str | tuple[str, ...], kind: str, size: float = 0.0, period: int = 25) -> dict[str, Any]:
    """The parameters of a fault in numbers."""
    names = (channels,) if isinstance(channels, str) else channels
    return {
        f"{name}.{key}": value
        for name in names
        for key, value in (("kind", KINDS.index(kind)), ("size", size), ("period", period))
    }


def flag(channels: str | tuple[str, ...], kind: str, period: int = 2) -> dict[str, Any]:
    """The parameters of a fault in flags."""
    names = (channels,) if isinstance(channels, str) else channels
    return {
        f"{name}.{key}": value
        for name in names
        for key, value in (("kind", FLAG_KINDS.index(kind)), ("period", period))
    }


def _healthy() -> Iterator[Row]:
    """Where nothing may act: no fault, or a rig that differs from the model by what a rig may."""
    yield Row("no fault", "nothing fails", {}, tuple(SITUATIONS))

    def row(text: str, **rig: float) -> Row:
        # Level on a tilted rail the cart rolls away, rightly.
        where = (POSITION, STEPS) if "rail_force" in rig else (HOLD, POSITION, STEPS)
        return Row("no fault", text, {f"rig.{name}": value for name, value in rig.items()}, where)

    yield row("the drone heavier by 15 %", mass_drone=1.15 * 0.374)
    yield row("the drone lighter by 15 %", mass_drone=0.85 * 0.374)
    yield row("a trim moment of .01 N m", trim=0.01)
    yield row("a trim moment of -.01 N m", trim=-0.01)
    yield row("the rail tilted by a degree", rail_force=0.09)
    yield row("the range off by .02 m", tof_bias=0.02)
    yield row("the range .06 s old", tof_age=0.06)
    yield row("the accelerometer's gain off by 3 %", acc_scale=1.03)
    yield row("the gyro's gain off by 3 %", gyro_scale=1.03)
    yield row("a battery at .3", charge_start=0.3)
    yield row("half as much noise again", noise=1.5)


def _imu() -> Iterator[Row]:
    axes = ("acc_x", "acc_z", "gyro_y")

    def row(text: str, faults: Mapping[str, Any]) -> Row:
        return Row("IMU, all axes", text, faults, ALL)

    noisy = number("gyro_y", "frozen with noise", 0.01) | number(("acc_x", "acc_z"), "frozen with noise", 1.0)
    yield row("silent", number(axes, "frozen") | flag("imu_new", "never"))
    yield row("frozen", number(axes, "frozen"))
    yield row("frozen with noise", noisy)
    yield row("late by 8 ms", number(axes, "late", 8))
    yield row("late by 40 ms", number(axes, "late", 40))
    yield row("late by 100 ms", number(axes, "late", 100))
    yield row("every 2nd sample missing", flag("imu_new", "missed", 2))
    yield row("4 of 5 samples missing", flag("imu_new", "rarely", 5))
    yield row("5 of 6 samples missing", flag("imu_new", "rarely", 6))
    yield row("NaN", number(axes, "NaN"))
    yield row("zero", number(axes, "stuck", 0.0))


def _axis(axis: str, unit: str, steps: tuple[float, ...], drift: float, full: float, noise: float) -> Iterator[Row]:
    where = ALL

    def row(text: str, faults: Mapping[str, Any]) -> Row:
        return Row(axis, text, faults, where)

    yield row("frozen", number(axis, "frozen"))
    yield row("frozen with noise", number(axis, "frozen with noise", noise))
    yield row("zero", number(axis, "stuck", 0.0))
    for size in steps:
        for sign in (1, -1):
            yield row(f"step of {sign * size:+g} {unit}", number(axis, "step", sign * size))
    for sign in (1, -1):
        yield row(f"drift of {sign * drift:+g} {unit} a second", number(axis, "drift", sign * drift))
        yield row(f"saturated at {sign * full:+g} {unit}", number(axis, "stuck", sign * full))
    yield row("late by 20 ms", number(axis, "late", 20))
    yield row("late by 60 ms", number(axis, "late", 60))
    yield row("swapped with another axis", number(axis, "swapped"))
    yield row("sign reversed", number(axis, "scaled", -1.0))
    yield row("half", number(axis, "scaled", 0.5))
    yield row("double", number(axis, "scaled", 2.0))
    yield row("noise raised tenfold", number(axis, "noise", 10 * noise))
    yield row(f"spikes of {full:g} {unit}, 5 a second", number(axis, "spikes", full, 50))
    yield row("zero in every 5th sample", number(axis, "dropouts", 0.0, 5))
    yield row("NaN", number(axis, "NaN"))
    yield row("infinite", number(axis, "infinite", 1.0))


def _range() -> Iterator[Row]:
    def row(text: str, faults: Mapping[str, Any]) -> Row:
        return Row("range", text, faults, SLIDING)

    yield row("silent", flag("dist_new", "never"))
    yield row("frozen", number("dist", "frozen"))
    yield row("frozen with noise", number("dist", "frozen with noise", 0.004))
    for size in (0.05, 0.1, 0.16, 0.2, 0.3):
        for sign in (1, -1):
            yield row(f"step of {sign * size:+g} m", number("dist", "step", sign * size))
    for size in (0.03, 0.05, 0.1, 0.2):
        for sign in (1, -1):
            yield row(f"drift of {sign * size:+g} m a second", number("dist", "drift", sign * size))
    yield row("saturated at 4 m", number("dist", "stuck", 4.0))
    yield row("zero", number("dist", "stuck", 0.0))
    yield row("late by 100 ms", number("dist", "late", 100) | flag("dist_new", "late", 25))
    yield row("late by 240 ms", number("dist", "late", 240) | flag("dist_new", "late", 60))
    yield row("mirrored (at the rail's other end)", number("dist", "swapped"))
    yield row("noise of .05 m", number("dist", "noise", 0.05))
    yield row("noise of .2 m", number("dist", "noise", 0.2))
    yield row("spikes of .3 m in half of the samples", number("dist", "spikes", 0.3, 2))
    yield row("zero in half of the samples", number("dist", "dropouts", 0.0, 2))
    yield row("NaN", number("dist", "NaN"))
    yield row("infinite", number("dist", "infinite", 1.0))
    yield row("old samples handed over as new at 250 Hz", flag("dist_new", "always"))
    yield row("3 of 4 samples missing", flag("dist_new", "rarely", 4))
    yield row("age of .1 s stamped", number("dist_age", "step", 0.1))
    yield row("age of 10 s stamped", number("dist_age", "step", 10.0))
    yield row("age of -.1 s stamped", number("dist_age", "step", -0.1))
    yield row("age that drifts by .1 s a second", number("dist_age", "drift", 0.1))
    yield row("age NaN", number("dist_age", "NaN"))


def _voltage() -> Iterator[Row]:
    def row(text: str, faults: Mapping[str, Any]) -> Row:
        return Row("voltage", text, faults, (ATTITUDE, POSITION))

    yield row("frozen (an empty battery is not noticed)", number("voltage", "frozen"))
    yield row("zero", number("voltage", "stuck", 0.0))
    yield row("step of -1.3 V", number("voltage", "step", -1.3))
    yield row("step of -2.5 V", number("voltage", "step", -2.5))
    yield row("step of +3 V", number("voltage", "step", 3.0))
    yield row("drift of -.5 V a second", number("voltage", "drift", -0.5))
    yield row("saturated at 60 V", number("voltage", "stuck", 60.0))
    yield row("noise of 1 V", number("voltage", "noise", 1.0))
    yield row("zero in every 5th sample", number("voltage", "dropouts", 0.0, 5))
    yield row("NaN", number("voltage", "NaN"))
    yield row("infinite", number("voltage", "infinite", 1.0))
    yield row("infinite, negative", number("voltage", "infinite", -1.0))


def _motors() -> Iterator[Row]:
    for pair in ("fore", "aft"):

        def row(text: str, faults: Mapping[str, Any], name: str = pair) -> Row:
            return Row(f"{name} pair", text, faults, PITCHING)

        yield row("dead", number(pair, "scaled", 0.0))
        yield row("stuck at full", number(pair, "stuck", 1.0))
        yield row("stuck at hover", number(pair, "stuck", 0.4))
        yield row("frozen", number(pair, "frozen"))
        yield row("half gain", number(pair, "scaled", 0.5))
        yield row(".9 of the gain", number(pair, "scaled", 0.9))
        yield row("limited to .5", number(pair, "clipped", 0.5))
        yield row("late by 20 ms", number(pair, "late", 20))
        yield row("noise of .1", number(pair, "noise", 0.1))
        yield row("off in every 5th step", number(pair, "dropouts", 0.0, 5))

    def row_both(text: str, faults: Mapping[str, Any]) -> Row:
        return Row("both pairs", text, faults, PITCHING)

    both = ("fore", "aft")
    yield row_both("dead", number(both, "scaled", 0.0))
    yield row_both("stuck at full", number(both, "stuck", 1.0))
    yield row_both("frozen", number(both, "frozen"))
    yield row_both("swapped (moment reversed)", number(both, "swapped"))
    yield row_both("half gain", number(both, "scaled", 0.5))
    yield row_both("late by 8 ms", number(both, "late", 8))
    yield row_both("late by 20 ms", number(both, "late", 20))
    yield row_both("late by 60 ms", number(both, "late", 60))
    yield row_both("off in every 5th step", number(both, "dropouts", 0.0, 5))


def _link() -> Iterator[Row]:
    def row(text: str, faults: Mapping[str, Any], *where: str) -> Row:
        return Row("link", text, faults, where)

    asked = ("x0", "v0", "theta0", "thrust")
    yield row("link silent", flag("link_new", "never"), ATTITUDE, POSITION)
    yield row("set-points silent", flag("setpoint_new", "never") | number(asked, "frozen"), *ALL)
    yield row("a set-point every .2 s", flag("setpoint_new", "rarely", 50), *ALL)
    yield row("a set-point every .8 s", flag("setpoint_new", "rarely", 200), *ALL)
    yield row("set-points late by .25 s", number(asked, "late", 250), ATTITUDE, STEPS, VELOCITY)
    for name, wrong, where in (
        ("theta0", 3.0, ATTITUDE),
        ("theta0", -3.0, HOLD),
        ("thrust", 1.0, ATTITUDE),
        ("thrust", -1.0, ATTITUDE),
        ("q0", 100.0, RATE),
        ("q0", 1.0, RATE),
        ("x0", 5.0, POSITION),
        ("x0", -5.0, POSITION),
        ("v0", 9.0, VELOCITY),
        ("v0", 0.3, VELOCITY),
        ("M_open", 1.0, OPEN),
        ("M_open", 0.03, OPEN),
    ):
        yield row(f"`{name}` {wrong:g}", number(name, "stuck", wrong), where)
    for name, where in (("theta0", ATTITUDE), ("thrust", ATTITUDE), ("x0", POSITION), ("v0", VELOCITY)):
        yield row(f"`{name}` NaN", number(name, "NaN"), where)
        yield row(f"`{name}` infinite", number(name, "infinite", 1.0), where)
    yield row("`x0` and `v0` swapped", number(("x0", "v0"), "swapped"), POSITION, VELOCITY)
    yield row("`theta0` and `thrust` swapped", number(("theta0", "thrust"), "swapped"), ATTITUDE, HOLD)
    yield row("`x0` in turn 5 and -5, 1 s each", number("x0", "square", 5.0, 250), POSITION)
    yield row("`v0` in turn 9 and -9, 1 s each", number("v0", "square", 9.0, 250), VELOCITY)
    yield row("`theta0` in turn 3 and -3, .1 s each", number("theta0", "square", 3.0, 25), ATTITUDE, HOLD)
    yield row("a mode that is none, 99", {"script.mode_after": 99}, ATTITUDE, POSITION)
    yield row("a mode that is none, -5 (taken for off)", {"script.mode_after": -5}, ATTITUDE, POSITION)
    yield row("a mode that moves the locked cart", {"script.mode_after": 4}, ATTITUDE)
    yield row("open loop where a loop was closed", {"script.mode_after": 1}, ATTITUDE, POSITION)


def _step() -> Iterator[Row]:
    def row(text: str, faults: Mapping[str, Any]) -> Row:
        return Row("step", text, faults, PITCHING)

    yield row("late in each tick", flag("step_late", "always"))
    yield row("late once", flag("step_late", "once"))
    yield row("every 2nd tick missed", flag("step", "missed", 2))
    yield row("every 10th tick missed", flag("step", "missed", 10))
    yield row("4 of 5 ticks missed", flag("step", "rarely", 5))
    yield row("24 of 25 ticks missed", flag("step", "rarely", 25))
    yield row("no step any more", flag("step", "never"))
    yield row("commands late by one tick", number(("fore", "aft"), "late", 4))


def _own() -> Iterator[Row]:
    def row(text: str, faults: Mapping[str, Any]) -> Row:
        return Row("user's controller", text, faults, (OWN, OWN_POSITION))

    yield row("NaN", number("own_M", "NaN"))
    yield row("infinite", number("own_M", "infinite", 1.0))
    yield row("infinite, negative", number("own_M", "infinite", -1.0))
    yield row("frozen", number("own_M", "frozen"))
    yield row("frozen with noise", number("own_M", "frozen with noise", 0.01))
    yield row("hard over, M = 1", number("own_M", "stuck", 1.0))
    yield row("hard over, M = -1", number("own_M", "stuck", -1.0))
    yield row("M = .05", number("own_M", "stuck", 0.05))
    yield row("M = 0", number("own_M", "stuck", 0.0))
    yield row("step of +.05", number("own_M", "step", 0.05))
    yield row("drift of .02 a second", number("own_M", "drift", 0.02))
    yield row("sign reversed", number("own_M", "scaled", -1.0))
    yield row("half", number("own_M", "scaled", 0.5))
    yield row("times 5", number("own_M", "scaled", 5.0))
    yield row("late by 20 ms", number("own_M", "late", 20))
    yield row("late by 60 ms", number("own_M", "late", 60))
    yield row("noise of .1", number("own_M", "noise", 0.1))
    yield row("M of +-1 in turn, .1 s each", number("own_M", "square", 1.0, 25))
    yield row("out of time in each tick", flag("user_late", "always"))
    yield row("out of time once", flag("user_late", "once"))


def _parameters() -> Iterator[Row]:
    def row(text: str, **changes: Any) -> Row:
        paths = {path.replace("__", "."): value for path, value in changes.items()}
        return Row("parameter", text, {}, PITCHING, {f"flight.{path}": value for path, value in paths.items()})

    yield row("rate P 0", cascade__rate__kp=0.0)
    yield row("rate P at its bound, .12", cascade__rate__kp=0.12)
    yield row("rate D at its bound, .003", cascade__rate__kd=0.003)
    yield row("attitude P 0", cascade__attitude__kp=0.0)
    yield row("attitude P at its bound, 15 1/s", cascade__attitude__kp=15.0)
    yield row("velocity P at its bound, 4 N s/m", cascade__velocity__kp=4.0)
    yield row("velocity P and I 0", cascade__velocity__kp=0.0, cascade__velocity__ki=0.0)
    yield row("position P at its bound, 2.5 1/s", cascade__position__kp=2.5)
    yield row("filter: range noise of 1 mm", estimator__filter__sigma_range=0.001)
    yield row("filter: gyro noise thousandfold", estimator__filter__sigma_gyro=2.0)


def _double() -> Iterator[Row]:
    def row(text: str, faults: Mapping[str, Any], where: tuple[str, ...] = (HOLD, *SLIDING)) -> Row:
        return Row("two at once", text, faults, where)

    silent = flag("setpoint_new", "never") | number(("x0", "v0", "theta0", "thrust"), "frozen")
    still = number("dist", "frozen with noise", 0.004)
    for size in (0.09, -0.09, 0.07, -0.07):
        yield row(f"set-points silent, range step of {size:+g} m", silent | number("dist", "step", size))
    yield row(
        "acc_x and range frozen with noise, flown", number("acc_x", "frozen with noise", 1.0) | still, (STEPS, VELOCITY)
    )
    yield row(
        "acc_x and range frozen with noise, held", number("acc_x", "frozen with noise", 1.0) | still, (HOLD, POSITION)
    )
    yield row(
        "acc_z and range frozen with noise, flown", number("acc_z", "frozen with noise", 2.5) | still, (STEPS, VELOCITY)
    )
    yield row("set-points silent, range drift of +0.1 m a second", silent | number("dist", "drift", 0.1))
    yield row("set-points silent, range frozen with noise", silent | still)
    yield row("voltage frozen, range step of +0.09 m", number("voltage", "frozen") | number("dist", "step", 0.09))
    yield row("acc_x late by 60 ms, range step of -0.09 m", number("acc_x", "late", 60) | number("dist", "step", -0.09))
    yield row("acc_x half, range frozen with noise, flown", number("acc_x", "scaled", 0.5) | still, (STEPS, VELOCITY))
    yield row("gyro_y half, range step of +0.09 m", number("gyro_y", "scaled", 0.5) | number("dist", "step", 0.09))
    yield row(
        "range late by 100 ms, acc_x +0.5 m/s2",
        number("dist", "late", 100) | flag("dist_new", "late", 25) | number("acc_x", "step", 0.5),
    )
    yield row(
        "both pairs half gain, range frozen with noise, flown",
        number(("fore", "aft"), "scaled", 0.5) | still,
        (STEPS, VELOCITY),
    )


ROWS: tuple[Row, ...] = (
    *_healthy(),
    *_imu(),
    *_axis("gyro_y", "rad/s", (0.05, 0.2, 0.5, 2.0), 0.05, 34.9, 0.01),
    *_axis("acc_x", "m/s2", (0.5, 2.0, 5.0), 0.5, 78.5, 1.0),
    *_axis("acc_z", "m/s2", (0.5, 2.0, 5.0), 0.5, 78.5, 2.5),
    *_range(),
    *_voltage(),
    *_motors(),
    *_link(),
    *_step(),
    *_own(),
    *_parameters(),
    *_double(),
)
"""All rows."""
