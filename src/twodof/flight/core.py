"""The flight core: sensors and set-points in, rotor commands out, at 250 Hz; one diagram."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from twodof.blocks import Block, Diagram, State
from twodof.errors import DiagramError
from twodof.flight.cascade import ArmingReset, LevelHold, cascade
from twodof.flight.declarations import (
    COMMANDS,
    FAILSAFE_INPUTS,
    IMU,
    INPUTS,
    RANGE,
    SET_POINTS,
    USER_INPUTS,
    add_inputs,
    ports,
)
from twodof.flight.estimator import estimator
from twodof.flight.failsafe.diagram import OUTPUTS as FAILSAFE_OUTPUTS
from twodof.flight.failsafe.diagram import StandbyReset
from twodof.flight.failsafe.diagram import failsafe as failsafe_diagram
from twodof.flight.gains import DEFAULT, Gains
from twodof.flight.mixer import FiniteCommands, Mixer, MotorFlags, RotorPairs
from twodof.flight.templates import ATTITUDE, MOTOR, POSITION, by_kind

OUTPUTS: tuple[tuple[str, str, str], ...] = (
    ("fore", "", "command of the fore rotor pair, 0 to 1"),
    ("aft", "", "command of the aft rotor pair, 0 to 1"),
    ("M", "", "normalised moment commanded"),
    ("T", "", "normalised thrust commanded"),
    ("theta", "rad", "estimated pitch of this sample; the cascade reads that of the sample before"),
    ("q", "rad/s", "estimated pitch rate"),
    ("x", "m", "estimated position as published at 100 Hz"),
    ("v", "m/s", "estimated velocity as published at 100 Hz"),
    ("x0", "m", "position set-point in use"),
    ("v0", "m/s", "velocity set-point in use"),
    ("theta0", "rad", "pitch set-point in use"),
    ("q0", "rad/s", "pitch-rate set-point in use"),
    ("M_trim", "", "trim moment that the last level hold found"),
)
"""Name, unit, meaning of each output of the core."""

PUBLISHED = MappingProxyType({"theta": "theta", "q": "q", "x": "x_published", "v": "v_published"})
"""For each estimate that other parts read, the output of the estimator that carries it."""

GIVEN = ("mode", *SET_POINTS, "ax0")
"""Inputs that command the flight: mode and set-points; with the failsafe they pass through it."""


class PreviousPitch(Block):
    """Pitch of the previous sample, as the drone's estimator publishes after the controller has read."""

    inputs = outputs = ports("theta")
    states = (State("theta", unit="rad"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.theta

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.theta


def core(
    gains: Gains = DEFAULT,
    position_filter: str = "joint",
    controllers: Iterable[Diagram] = (),
    failsafe: bool = False,
    outside: bool = False,
) -> Diagram:
    """Return the flight core for 250 Hz: estimator, level hold, cascade, mixer; its ports are `INPUTS` and `OUTPUTS`.

    Parameter paths: `estimator.filter...` (of the joint filter; else `estimator.pitch...`, `estimator.position...`),
    `cascade.rate.kp` and so on (see `cascade`), `hold.settle`, `hold.window`, `arming.samples`.

    `controllers` are diagrams of the templates (`flight.templates`), one of a kind at most. They take the place of the
    stock loops and of the mixer. Their parameters are `cascade.attitude_control...`, `cascade.position_control...` and
    `motor_control...`. If one of them asks for an infinite or NaN moment or thrust, the motors stop, and the output M
    or T is that value. An infinite or NaN command of a single motor stops that motor. With a motor controller M and T
    are computed from the motors' commands.

    With `failsafe` the ports of `flight.failsafe.diagram` are added, and its gate is the last part before the motors.
    While no cause holds, every output has the same bits as without the failsafe. A user's controllers are then
    monitored. The stock ones, parts `stock...` that are computed at every step with their integrals in reset, are ready
    to replace them.

    `outside` is for a user's controllers that are not trusted and run elsewhere, such as a whole core in a sandbox.
    Their commands are the inputs `flight.declarations.USER_INPUTS` and are monitored in the same way. The output
    `user_flies` is true in a tick in which they are selected to fly.

    Raises ParameterError for an unknown position filter, DiagramError for a diagram that fits no template, and for
    `outside` without `failsafe` or with `controllers`.
    """
    users = by_kind(controllers)
    if outside and (users or not failsafe):
        what = "commands of an outside controller need the failsafe and exclude `controllers`"
        raise DiagramError(what, "outside", "give failsafe=True and no controllers")
    d = Diagram("flight", "estimator, level hold, cascade and mixer at 250 Hz")
    safety = (*(FAILSAFE_INPUTS if failsafe else ()), *(USER_INPUTS if outside else ()))
    add_inputs(d, *(name for name, *_ in (*INPUTS, *safety)))
    # Where the controllers read the mode and the set-points: as given, or as the failsafe lets them pass.
    given = {name: f"failsafe.safe_{name}" if failsafe else name for name in GIVEN}
    d.add("estimator", estimator(position_filter))
    for name in (*IMU, "dist"):
        d.connect(name, f"estimator.{name}")
    # A range sample that the failsafe rejects does not reach the estimator.
    for name, believed in (("dist_new", "range_taken"), ("dist_age", "range_age")):
        d.connect(f"failsafe.{believed}" if failsafe else name, f"estimator.{name}")
    d.add("previous", PreviousPitch(), theta="estimator.theta")
    d.add("arming", ArmingReset(), mode=given["mode"], thrust=given["thrust"], in_reset="in_reset")
    d.add(
        "hold", LevelHold(), mode=given["mode"], thrust=given["thrust"], excitation=given["M_open"], use_trim="use_trim"
    )
    in_reset = "arming"
    if failsafe:
        d.add("standby", StandbyReset(bool(users)), in_reset="arming", user_flies="failsafe.user_flies")
        in_reset = "standby.user_in_reset" if users else "standby.stock_in_reset"
    _cascade(d, "cascade", cascade(gains, users.get(ATTITUDE.name), users.get(POSITION.name)), given, in_reset)
    if POSITION.name in users:
        d.connect(given["ax0"], "cascade.ax0")
    command = "cascade"
    if users:
        command = d.add("sound", FiniteCommands(), M="cascade.M", T="cascade.T")
    if MOTOR.name in users:
        pairs, flown = _user_motors(d, users[MOTOR.name], command, given["mode"], in_reset), "pairs.M"
        shown = {"M": "pairs.M_shown", "T": "pairs.T_shown"}
    else:
        pairs, flown = d.add("mixer", Mixer(), T=f"{command}.T", M=f"{command}.M"), f"{command}.M"
        shown = {"M": "cascade.M", "T": "cascade.T"}
    commands = shown | {name: f"{pairs}.{name}" for name in ("fore", "aft")}
    if failsafe:
        _failsafe(d, given, commands, gains if users else None, outside)
        commands = {name: f"failsafe.{name}" for name in COMMANDS}
        flown = "failsafe.M"
    for name in COMMANDS:
        d.output(name, commands[name])
    for name in ("x0", "v0", "theta0", "q0"):
        d.output(name, f"cascade.{name}")
    d.connect(flown, "hold.M")
    for name, source in PUBLISHED.items():
        d.output(name, f"estimator.{source}")
    d.output("M_trim", "hold.M_trim")
    return d


def _cascade(d: Diagram, name: str, item: Diagram, given: Mapping[str, str], in_reset: str) -> None:
    """Add a cascade, fed by the set-points `given` and the estimates."""
    d.add(
        name,
        item,
        in_reset=in_reset,
        M_open="hold.M_open",
        x="estimator.x_published",
        v="estimator.v_published",
        theta="previous.theta",
        q="estimator.q",
        inputs={name: given[name] for name in ("mode", *SET_POINTS) if name != "M_open"},
    )


def _failsafe(
    d: Diagram, given: Mapping[str, str], commands: Mapping[str, str], reserve: Gains | None, outside: bool
) -> None:
    """Add the failsafe behind `commands`, and stock controllers with the gains `reserve` behind a user's commands."""
    d.add("failsafe", failsafe_diagram())
    for name in (*(row[0] for row in FAILSAFE_INPUTS), *IMU, *RANGE, *GIVEN):
        d.connect(name, f"failsafe.{name}")
    for name, source in PUBLISHED.items():
        d.connect(f"estimator.{source}", f"failsafe.{name}")
    stock = commands
    if reserve is not None:
        _cascade(d, "stock", cascade(reserve), given, "standby.stock_in_reset")
        d.add("stock_mixer", Mixer(), T="stock.T", M="stock.M")
        stock = {"M": "stock.M", "T": "stock.T", "fore": "stock_mixer.fore", "aft": "stock_mixer.aft"}
    for name in COMMANDS:
        d.connect(stock[name], f"failsafe.{name}")
        d.connect(f"user_{name}" if outside else commands[name], f"failsafe.user_{name}")
    d.connect("user_given" if outside else "standby.user_given", "failsafe.user_given")
    for name, _, _ in FAILSAFE_OUTPUTS:
        d.output(name, f"failsafe.{name}")
    if outside:
        d.output("user_flies", "failsafe.user_flies")


def _user_motors(d: Diagram, motors: Diagram, command: str, mode: str, in_reset: str) -> str:
    """Add a user's motor controller in the mixer's place, fed by `command`; return the part that makes the pairs."""
    d.add("flags", MotorFlags(), mode=mode)
    d.add(
        MOTOR.name,
        motors,
        M_0=f"{command}.M",
        thrust_0=f"{command}.T",
        theta_0="cascade.theta0",
        q_0="cascade.q0",
        x_0="cascade.x0",
        vx_0="cascade.v0",
        theta="previous.theta",
        q="estimator.q",
        x="estimator.x_published",
        vx="estimator.v_published",
        acc_x="acc_x",
        acc_z="acc_z",
        gyro_y="gyro_y",
        FLAG_RESET_INT=in_reset,
    )
    for flag in ("rate", "attitude", "velocity", "position"):
        d.connect(f"flags.{flag}", f"{MOTOR.name}.FLAG_{flag.upper()}_ENABLED")
    d.add("pairs", RotorPairs(), mode=mode)
    for port in MOTOR.outputs:
        d.connect(f"{MOTOR.name}.{port.name}", f"pairs.{port.name}")
    return "pairs"
