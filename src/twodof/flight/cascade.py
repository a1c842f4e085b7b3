"""The position-velocity-attitude-rate cascade as one diagram, entered at the loop that the mode names."""

from typing import Any

from twodof.blocks import Block, Diagram, Port, int32, where
from twodof.flight.cascade_loops import AttitudeLoop, PositionLoop, Projection, RateLoop, VelocityLoop
from twodof.flight.declarations import SET_POINTS, add_inputs, ports
from twodof.flight.gains import DEFAULT, Gains
from twodof.signals import ATTITUDE, OFF, OPEN_LOOP, POSITION, RATE, VELOCITY


class ModeLogic(Block):
    """Which loops a mode closes. An integral outside the closed loops is held in reset, so that it starts afresh."""

    inputs = ports("mode", "in_reset")
    outputs = tuple(Port(name, "bool") for name in ("position", "velocity", "attitude", "reset_velocity", "reset_rate"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {
            "position": u.mode == int32(POSITION),
            "velocity": u.mode >= int32(VELOCITY),
            "attitude": u.mode != int32(RATE),
            "reset_velocity": u.in_reset | (u.mode < int32(VELOCITY)),
            "reset_rate": u.in_reset | (u.mode < int32(RATE)),
        }


class SetPointsInUse(Block):
    """The set-points in use; one that is not is 0, and in velocity mode x0 mirrors x, as the drone's logs have it."""

    inputs = (*ports("mode", "x0", "x", "v0", "theta0"), Port("projected", unit="rad"))
    outputs = ports("x0", "v0", "theta0")

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        along_rail = u.mode >= int32(VELOCITY)
        level = where(u.mode == int32(ATTITUDE), u.theta0, 0.0)
        return {
            "x0": where(u.mode == int32(POSITION), u.x0, where(along_rail, u.x, 0.0)),
            "v0": where(along_rail, u.v0, 0.0),
            "theta0": where(along_rail, u.projected, level),
        }


class GivenSetPoint(Block):
    """The set-point given while the mode is `mode`, else 0: a user's controller keeps its inner ones to itself."""

    def __init__(self, mode: int, unit: str) -> None:
        self.mode = mode
        self.inputs = (*ports("mode"), Port("given", unit=unit))
        self.outputs = (Port("used", unit=unit),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return where(u.mode == int32(self.mode), u.given, 0.0)


class MomentAndThrust(Block):
    """Moment and thrust to the mixer: the loops', or in open loop those of the message; nothing when off."""

    inputs = (*ports("mode"), Port("M_loop"), Port("T_loop"), *ports("M_open", "thrust"))
    outputs = ports("M", "T")

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        off = u.mode <= int32(OFF)
        moment = where(u.mode == int32(OPEN_LOOP), u.M_open, u.M_loop)
        thrust = where(u.mode >= int32(VELOCITY), u.T_loop, u.thrust)
        return {"M": where(off, 0.0, moment), "T": where(off, 0.0, thrust)}


def cascade(gains: Gains = DEFAULT, attitude: Diagram | None = None, position: Diagram | None = None) -> Diagram:
    """Return the cascade with `gains`, made for 250 Hz.

    Inputs: `mode` (int32, index into `signals.MODES`) and `in_reset` (bool: the integrals). The mode uses one of the
    set-points `x0` [m], `v0` [m/s], `theta0` [rad], `q0` [rad/s]. `thrust` is for the modes without velocity loop,
    `M_open` for open loop. The estimates are `x`, `v`, `theta`, `q`. Outputs: `M`, `T` and the set-points in use,
    `q0`, `theta0`, `v0`, `x0`. Parameters: `rate.kp/ki/kd/N/limit`, `attitude.kp/limit`, `velocity.kp/ki`,
    `projection.T_bar/eta_T`, `position.kp/limit`.

    `attitude` and `position` are diagrams of the templates of these names (`flight.templates`). They replace the stock
    loops, as the parts `attitude_control` and `position_control`. A set-point between loops inside such a part is not
    seen outside, so `q0` and `v0` are then 0 unless they are given. With `position` there is one more input,
    `ax0` [m/s2].
    """
    d = Diagram("cascade", "position, velocity, attitude and rate loop; the mode names the outermost that is closed")
    add_inputs(d, "mode", "in_reset", *SET_POINTS, "x", "v", "theta", "q")
    d.add("logic", ModeLogic(), mode="mode", in_reset="in_reset")
    v0_used, tilt, thrust = _stock_position(d, gains) if position is None else _own_position(d, position)
    d.add(
        "setpoints",
        SetPointsInUse(),
        mode="mode",
        x0="x0",
        x="x",
        v0=v0_used,
        theta0="theta0",
        projected=tilt,
    )
    q0_used, moment = _stock_attitude(d, gains) if attitude is None else _own_attitude(d, attitude)
    d.add(
        "command",
        MomentAndThrust(),
        mode="mode",
        M_loop=moment,
        T_loop=thrust,
        M_open="M_open",
        thrust="thrust",
    )
    d.output("M", "command.M")
    d.output("T", "command.T")
    d.output("q0", q0_used)
    for name in ("theta0", "v0", "x0"):
        d.output(name, f"setpoints.{name}")
    return d


def _stock_position(d: Diagram, gains: Gains) -> tuple[str, str, str]:
    """Add the stock loops; return the sources of v0, of the pitch set-point and of the thrust."""
    d.add("position", PositionLoop(gains.position), x0="x0", x="x", v0="v0", closed="logic.position")
    d.add("velocity", VelocityLoop(*gains.velocity), v0="position.v0", v="v", in_reset="logic.reset_velocity")
    d.add("projection", Projection(), force="velocity.force")
    return "position.v0", "projection.theta0", "projection.T"


def _own_position(d: Diagram, position: Diagram) -> tuple[str, str, str]:
    """Add a user's position controller; return the same sources."""
    add_inputs(d, "ax0")
    d.add(
        "position_control",
        position,
        x_0="x0",
        vx_0="v0",
        x="x",
        vx="v",
        ax_0="ax0",
        FLAG_RESET_INT_VEL="logic.reset_velocity",
        FLAG_POSITION_ENABLED="logic.position",
    )
    d.add("v0_used", GivenSetPoint(VELOCITY, "m/s"), mode="mode", given="v0")
    return "v0_used", "position_control.theta_0", "position_control.thrust"


def _stock_attitude(d: Diagram, gains: Gains) -> tuple[str, str]:
    """Add the stock loops; return the sources of q0 and of the moment."""
    d.add(
        "attitude",
        AttitudeLoop(gains.attitude),
        theta0="setpoints.theta0",
        theta="theta",
        q0="q0",
        closed="logic.attitude",
    )
    d.add("rate", RateLoop(*gains.rate), q0="attitude.q0", q="q", in_reset="logic.reset_rate")
    return "attitude.q0", "rate.M"


def _own_attitude(d: Diagram, attitude: Diagram) -> tuple[str, str]:
    """Add a user's attitude controller; return the same sources."""
    d.add(
        "attitude_control",
        attitude,
        theta_0="setpoints.theta0",
        q_0="q0",
        theta="theta",
        q="q",
        FLAG_RESET_INT="logic.reset_rate",
        FLAG_ATTITUDE_ENABLED="logic.attitude",
    )
    d.add("q0_used", GivenSetPoint(RATE, "rad/s"), mode="mode", given="q0")
    return "q0_used", "attitude_control.M"
