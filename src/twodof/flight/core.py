"""The flight core: sensors and set-points in, rotor commands out, at 250 Hz; one diagram."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from twodof.blocks import Block, Diagram, Port, State
from twodof.errors import DiagramError
from twodof.flight.control.cascade import cascade
from twodof.flight.control.level_hold import ArmingReset, LevelHold
from twodof.flight.control.mixer import Mixer
from twodof.flight.control.rotor_pairs import FiniteCommands, MotorFlags, RotorPairs
from twodof.flight.estimator.diagram import estimator
from twodof.flight.failsafe.diagram import INPUTS as FAILSAFE_INPUTS
from twodof.flight.failsafe.diagram import OUTPUTS as FAILSAFE_OUTPUTS
from twodof.flight.failsafe.diagram import OWN_INPUTS
from twodof.flight.failsafe.diagram import failsafe as failsafe_diagram
from twodof.flight.failsafe.output_selector import COMMANDS, StandbyReset
from twodof.flight.gains import DEFAULT, Gains
from twodof.flight.templates import ATTITUDE, MOTOR, POSITION, by_kind

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
"""Name, type, unit, meaning of each input of the core."""

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


GIVEN = ("mode", "x0", "v0", "theta0", "q0", "thrust", "M_open", "ax0")
"""The inputs that say what is to be flown; with the failsafe they pass through it."""


class PreviousPitch(Block):
    """The pitch of the sample before: the drone's estimator publishes after the controller has read."""

    inputs = (Port("theta", unit="rad"),)
    outputs = (Port("theta", unit="rad"),)
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
    """What flies: estimator, level hold, cascade, mixer, with the ports `INPUTS` and `OUTPUTS`, made for 250 Hz.

    Parameter paths: `estimator.filter...` (of the joint filter; else `estimator.pitch...`, `estimator.position...`),
    `cascade.rate.kp` and so on (see `cascade`), `hold.settle`, `hold.window`, `arming.samples`.

    `controllers` are diagrams of the templates (`flight.templates`), one of a kind at most. They take the place of the
    stock loops and of the mixer. Their parameters are `cascade.attitude_control...`, `cascade.position_control...` and
    `motor_control...`. If one of them asks for an infinite or NaN moment or thrust, the motors stop, and M or T shows
    it. A bad command of a single motor stops that motor. With a motor controller M and T are what the motors are given.

    With `failsafe` the ports of `flight.failsafe.diagram` are added, and its gate is the last thing before the motors.
    As long as nothing is wrong every output has the same bits as without. A user's controllers are then watched. The
    stock ones, computed at every step as `stock...` with their integrals in reset, stand ready to replace them.

    `outside` is for a user's controllers that are not trusted and run elsewhere, such as a whole core of theirs in a
    sandbox. Their commands come in as `flight.failsafe.diagram.OWN_INPUTS` and are watched in the same way. The output
    `own` says whether they were to fly in this tick.

    Raises ParameterError for an unknown position filter, DiagramError for a diagram that fits no template, and for
    `outside` without `failsafe` or with `controllers`.
    """
    own = by_kind(controllers)
    if outside and (own or not failsafe):
        raise DiagramError(
            "commands from outside are gated by the failsafe, in place of controllers inside",
            "outside",
            "give failsafe=True and no controllers",
        )
    d = Diagram("flight", "estimator, level hold, cascade and mixer at 250 Hz")
    safety = (*(FAILSAFE_INPUTS if failsafe else ()), *(OWN_INPUTS if outside else ()))
    for name, kind, unit, _ in (*INPUTS, *safety):
        d.input(name, kind, unit=unit)
    # Where the controllers read the mode and the set-points: as given, or as the failsafe lets them pass.
    given = {name: f"failsafe.safe_{name}" if failsafe else name for name in GIVEN}
    d.add("estimator", estimator(position_filter))
    for name in ("acc_x", "acc_z", "gyro_y", "dist"):
        d.connect(name, f"estimator.{name}")
    # A range that the failsafe does not believe is none.
    for name, believed in (("dist_new", "range_taken"), ("dist_age", "range_age")):
        d.connect(f"failsafe.{believed}" if failsafe else name, f"estimator.{name}")
    d.add("previous", PreviousPitch(), theta="estimator.theta")
    d.add("arming", ArmingReset(), mode=given["mode"], thrust=given["thrust"], in_reset="in_reset")
    d.add(
        "hold",
        LevelHold(),
        mode=given["mode"],
        thrust=given["thrust"],
        excitation=given["M_open"],
        use_trim="use_trim",
    )
    in_reset = "arming"
    if failsafe:
        d.add("standby", StandbyReset(bool(own)), in_reset="arming", own="failsafe.own")
        in_reset = "standby.own_in_reset" if own else "standby.stock_in_reset"
    _cascade(d, "cascade", cascade(gains, own.get(ATTITUDE.name), own.get(POSITION.name)), given, in_reset)
    if POSITION.name in own:
        d.connect(given["ax0"], "cascade.ax0")
    command = "cascade"
    if own:
        command = d.add("sound", FiniteCommands(), M="cascade.M", T="cascade.T")
    if MOTOR.name in own:
        pairs, flown = _own_motors(d, own[MOTOR.name], command, given["mode"], in_reset), "pairs.M"
        shown = {"M": "pairs.M_shown", "T": "pairs.T_shown"}
    else:
        pairs, flown = d.add("mixer", Mixer(), T=f"{command}.T", M=f"{command}.M"), f"{command}.M"
        shown = {"M": "cascade.M", "T": "cascade.T"}
    commands = shown | {name: f"{pairs}.{name}" for name in ("fore", "aft")}
    if failsafe:
        _failsafe(d, given, commands, gains if own else None, outside)
        commands = {name: f"failsafe.{name}" for name in COMMANDS}
        flown = "failsafe.M"
    for name in COMMANDS:
        d.output(name, commands[name])
    for name in ("x0", "v0", "theta0", "q0"):
        d.output(name, f"cascade.{name}")
    d.connect(flown, "hold.M")
    d.output("theta", "estimator.theta")
    d.output("q", "estimator.q")
    d.output("x", "estimator.x_published")
    d.output("v", "estimator.v_published")
    d.output("M_trim", "hold.M_trim")
    return d


def _cascade(d: Diagram, name: str, item: Diagram, given: Mapping[str, str], in_reset: str) -> None:
    """Adds a cascade, fed by the set-points `given` and the estimates."""
    d.add(
        name,
        item,
        in_reset=in_reset,
        M_open="hold.M_open",
        x="estimator.x_published",
        v="estimator.v_published",
        theta="previous.theta",
        q="estimator.q",
        inputs={port: given[port] for port in ("mode", "x0", "v0", "theta0", "q0", "thrust")},
    )


def _failsafe(
    d: Diagram, given: Mapping[str, str], commands: Mapping[str, str], reserve: Gains | None, outside: bool
) -> None:
    """Adds the failsafe behind `commands`; where those are a user's, stock controllers with the gains `reserve`."""
    d.add("failsafe", failsafe_diagram())
    for name, _, _, _ in FAILSAFE_INPUTS:
        d.connect(name, f"failsafe.{name}")
    for name in ("acc_x", "acc_z", "gyro_y", "dist", "dist_new", "dist_age", *GIVEN):
        d.connect(name, f"failsafe.{name}")
    for name, source in (("theta", "theta"), ("q", "q"), ("x", "x_published"), ("v", "v_published")):
        d.connect(f"estimator.{source}", f"failsafe.{name}")
    stock = commands
    if reserve is not None:
        _cascade(d, "stock", cascade(reserve), given, "standby.stock_in_reset")
        d.add("stock_mixer", Mixer(), T="stock.T", M="stock.M")
        stock = {"M": "stock.M", "T": "stock.T", "fore": "stock_mixer.fore", "aft": "stock_mixer.aft"}
    for name in COMMANDS:
        d.connect(stock[name], f"failsafe.{name}")
        d.connect(f"own_{name}" if outside else commands[name], f"failsafe.own_{name}")
    d.connect("own_given" if outside else "standby.own_given", "failsafe.own_given")
    for name, _, _ in FAILSAFE_OUTPUTS:
        d.output(name, f"failsafe.{name}")
    if outside:
        d.output("own", "failsafe.own")


def _own_motors(d: Diagram, motors: Diagram, command: str, mode: str, in_reset: str) -> str:
    """Adds a user's motor controller in the mixer's place, fed by the part `command`; returns what makes the pairs."""
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
