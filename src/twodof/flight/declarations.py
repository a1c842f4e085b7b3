"""Declarations of the flight code's blocks: ports by name, and parameters by their rows in `parameters`.

A port's name has one type and unit in all of the blocks.
"""

from collections.abc import Mapping
from functools import reduce
from operator import and_
from types import MappingProxyType
from typing import Any

from twodof.blocks import Diagram, Param, Port, where
from twodof.parameters import TUNABLES


def finite(value: Any) -> Any:
    """Return True if a real is finite: for an infinite one and for NaN, value - value is not 0."""
    return value - value == 0.0


PLAUSIBLE = MappingProxyType({"theta": 1.5, "bias": 100.0, "x": 1e6, "x_filter": 1e6, "v": 1e3})
"""Largest plausible magnitude of a filter's state, by name, in SI."""


def restarted(new: Mapping[str, Any], first: Mapping[str, Any]) -> dict[str, Any]:
    """Return the states `new` of a filter, or its initial states if one of `new` is NaN or beyond `PLAUSIBLE`.

    The initial states are `first`, by name, else 0. Without this restart one NaN sample would leave the filter's states
    NaN for ever.
    """
    sound = reduce(and_, [abs(value) <= PLAUSIBLE[name] for name, value in new.items() if name in PLAUSIBLE])
    return {name: where(sound, value, first.get(name, 0.0)) for name, value in new.items()}


INPUTS: tuple[tuple[str, str, str, str], ...] = (
    ("acc_x", "real", "m/s2", "specific force along the body's x axis"),
    ("acc_z", "real", "m/s2", "specific force along the body's z axis (down)"),
    ("gyro_y", "real", "rad/s", "pitch rate"),
    ("dist", "real", "m", "time-of-flight range; x = dist - 0.50"),
    ("dist_new", "bool", "", "a range sample is handed over in this tick"),
    ("dist_age", "real", "s", "its age at this tick"),
    ("mode", "int32", "", "index into signals.MODES"),
    ("in_reset", "bool", "", "hold the integrals in reset (besides the reset at arming, which is inside)"),
    ("x0", "real", "m", "position set-point, in position mode"),
    ("v0", "real", "m/s", "velocity set-point, in velocity mode"),
    ("ax0", "real", "m/s2", "acceleration set-point, a feed-forward that only a user's position controller reads"),
    ("theta0", "real", "rad", "pitch set-point, in attitude mode"),
    ("q0", "real", "rad/s", "pitch-rate set-point, in rate mode"),
    ("thrust", "real", "", "thrust in open-loop, rate and attitude mode"),
    ("M_open", "real", "", "moment in open loop"),
    ("use_trim", "bool", "", "add the trim moment that the last level hold found to M_open"),
)
"""Name, type, unit and meaning of each input of the flight core."""

FAILSAFE_INPUTS: tuple[tuple[str, str, str, str], ...] = (
    ("arm", "bool", "", "arm; a rising edge arms if nothing speaks against it, false disarms at once"),
    (
        "setpoint_new",
        "bool",
        "",
        "a set-point came in this tick, from whatever source has the command, on board or not",
    ),
    ("link_new", "bool", "", "something came over the link in this tick"),
    ("imu_new", "bool", "", "the IMU gave a sample in this tick"),
    ("rings", "bool", "", "the rings lock the cart: range and rail end do not matter"),
    ("voltage", "real", "V", "of the battery"),
    ("step_late", "bool", "", "the flight controller's last step ran out of its time"),
    (
        "user_late",
        "bool",
        "",
        "the user's controller ran out of its time, its commands of this tick are not to be used",
    ),
)
"""Name, type, unit and meaning of each further input of a flight core with the failsafe."""

USER_INPUTS: tuple[tuple[str, str, str, str], ...] = (
    ("user_given", "bool", "", "a user's commands are there and are to fly as long as they are healthy"),
    ("user_fore", "real", "", "the user's command of the fore rotor pair"),
    ("user_aft", "real", "", "of the aft pair"),
    ("user_M", "real", "", "the user's moment, to be shown while it flies"),
    ("user_T", "real", "", "the user's thrust, the same"),
)
"""Name, type, unit and meaning of each further input of a core whose user's commands come from outside it."""

IMU = ("acc_x", "acc_z", "gyro_y")
RANGE = ("dist", "dist_new", "dist_age")
ESTIMATED = ("theta", "q", "x", "v")
SET_POINTS = ("x0", "v0", "theta0", "q0", "thrust", "M_open")
"""Set-points that are real numbers and that the stock controllers read."""
COMMANDS = ("fore", "aft", "M", "T")

_PORTS = {name: Port(name, kind, unit=unit) for name, kind, unit, _ in (*INPUTS, *FAILSAFE_INPUTS, *USER_INPUTS)} | {
    port.name: port
    for port in (
        Port("theta", unit="rad"),
        Port("q", unit="rad/s"),
        Port("x", unit="m"),
        Port("v", unit="m/s"),
        Port("acceleration", unit="m/s2"),
        *(Port(name) for name in (*COMMANDS, "sine", "cosine")),
        *(Port(name, "int32") for name in ("state", "timer", "mask")),
        *(Port(name, "bool") for name in ("user_flies", "stopped", "failed", "stuck_off", "user_lost", "command_lost")),
    )
}


def ports(*names: str) -> tuple[Port, ...]:
    """Return the declared ports with these names, for a block."""
    return tuple(_PORTS[name] for name in names)


def add_inputs(d: Diagram, *names: str) -> None:
    """Declare the ports with these names as inputs of a diagram."""
    for port in ports(*names):
        d.input(port.name, port.kind, unit=port.unit)


def tunable(path: str, value: float | None = None) -> Param:
    """Return the block parameter of the row at `path` ("cascade.rate.kp"), with its default or `value`."""
    row = TUNABLES[path]
    default = row.default if value is None else value
    unit = "" if row.unit == "-" else row.unit
    name = path.rpartition(".")[2]
    if isinstance(row.default, bool):
        return Param(name, default, "bool", unit=unit, text=row.text)
    kind = "int32" if isinstance(row.default, int) else "real"
    return Param(name, default, kind, unit=unit, low=row.low, high=row.high, text=row.text)


def tunables(block: str, *names: str, **values: Any) -> tuple[Param, ...]:
    """Return the parameters of the flight block at the path `block`: all its rows, or those in `names`.

    `values` are other defaults, by name.
    """
    prefix = f"{block}."
    own = [path.removeprefix(prefix) for path in TUNABLES if path.startswith(prefix)]
    return tuple(tunable(prefix + name, values.get(name)) for name in names or own)
