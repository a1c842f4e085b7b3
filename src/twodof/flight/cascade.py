"""The position-velocity-attitude-rate cascade as one diagram, entered at the loop that the mode names."""

from __future__ import annotations

from typing import Any

from twodof.blocks import Block, Diagram, Port, int32, where
from twodof.flight.gains import DEFAULT, Gains
from twodof.flight.loops import AttitudeLoop, PositionLoop, Projection, RateLoop, VelocityLoop
from twodof.signals import MODES

OFF, OPEN_LOOP, RATE, ATTITUDE, VELOCITY, POSITION = range(len(MODES))
"""The modes by number: the index into `signals.MODES`, the value of the input `mode`."""


class ModeLogic(Block):
    """Which loops a mode closes. An integral outside the closed loops is held in reset, so that it starts afresh."""

    inputs = (Port("mode", "int32"), Port("in_reset", "bool"))
    outputs = (
        Port("position", "bool"),
        Port("velocity", "bool"),
        Port("attitude", "bool"),
        Port("reset_velocity", "bool"),
        Port("reset_rate", "bool"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {
            "position": u.mode == int32(POSITION),
            "velocity": u.mode >= int32(VELOCITY),
            "attitude": u.mode != int32(RATE),
            "reset_velocity": u.in_reset | (u.mode < int32(VELOCITY)),
            "reset_rate": u.in_reset | (u.mode < int32(RATE)),
        }


class SetPoints(Block):
    """The set-points in use; one that is not is 0, and in velocity mode x0 mirrors x, as the drone's logs have it."""

    inputs = (
        Port("mode", "int32"),
        Port("x0", unit="m"),
        Port("x", unit="m"),
        Port("v0", unit="m/s"),
        Port("theta0", unit="rad"),
        Port("projected", unit="rad"),
    )
    outputs = (Port("x0", unit="m"), Port("v0", unit="m/s"), Port("theta0", unit="rad"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        along_rail = u.mode >= int32(VELOCITY)
        level = where(u.mode == int32(ATTITUDE), u.theta0, 0.0)
        return {
            "x0": where(u.mode == int32(POSITION), u.x0, where(along_rail, u.x, 0.0)),
            "v0": where(along_rail, u.v0, 0.0),
            "theta0": where(along_rail, u.projected, level),
        }


class Command(Block):
    """Moment and thrust to the mixer: the loops', or in open loop those of the message; nothing when off."""

    inputs = (
        Port("mode", "int32"),
        Port("M_loop"),
        Port("T_loop"),
        Port("M_open"),
        Port("thrust"),
    )
    outputs = (Port("M"), Port("T"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        off = u.mode <= int32(OFF)
        moment = where(u.mode == int32(OPEN_LOOP), u.M_open, u.M_loop)
        thrust = where(u.mode >= int32(VELOCITY), u.T_loop, u.thrust)
        return {"M": where(off, 0.0, moment), "T": where(off, 0.0, thrust)}


def cascade(gains: Gains = DEFAULT) -> Diagram:
    """The cascade with `gains`, made for 250 Hz.

    Inputs: `mode` (int32, index into `signals.MODES`), `in_reset` (bool: the integrals), the set-points `x0` [m],
    `v0` [m/s], `theta0` [rad], `q0` [rad/s] of which the mode uses one, `thrust` (in the modes without velocity loop),
    `M_open` (in open loop), and the estimates `x`, `v`, `theta`, `q`. Outputs: `M`, `T` and the set-points in use,
    `q0`, `theta0`, `v0`, `x0`. Parameters: `rate.kp/ki/kd/N/limit`, `attitude.kp/limit`, `velocity.kp/ki`,
    `projection.T_bar/eta_T`, `position.kp/limit`.
    """
    d = Diagram("cascade", "position, velocity, attitude and rate loop; the mode names the outermost that is closed")
    d.input("mode", "int32")
    d.input("in_reset", "bool")
    for name, unit in (
        ("x0", "m"),
        ("v0", "m/s"),
        ("theta0", "rad"),
        ("q0", "rad/s"),
        ("thrust", ""),
        ("M_open", ""),
        ("x", "m"),
        ("v", "m/s"),
        ("theta", "rad"),
        ("q", "rad/s"),
    ):
        d.input(name, unit=unit)
    d.add("logic", ModeLogic(), mode="mode", in_reset="in_reset")
    d.add("position", PositionLoop(gains.position), x0="x0", x="x", v0="v0", closed="logic.position")
    d.add("velocity", VelocityLoop(*gains.velocity), v0="position.v0", v="v", in_reset="logic.reset_velocity")
    d.add("projection", Projection(), force="velocity.force")
    d.add(
        "setpoints",
        SetPoints(),
        mode="mode",
        x0="x0",
        x="x",
        v0="position.v0",
        theta0="theta0",
        projected="projection.theta0",
    )
    d.add(
        "attitude",
        AttitudeLoop(gains.attitude),
        theta0="setpoints.theta0",
        theta="theta",
        q0="q0",
        closed="logic.attitude",
    )
    d.add("rate", RateLoop(*gains.rate), q0="attitude.q0", q="q", in_reset="logic.reset_rate")
    d.add(
        "command",
        Command(),
        mode="mode",
        M_loop="rate.M",
        T_loop="projection.T",
        M_open="M_open",
        thrust="thrust",
    )
    d.output("M", "command.M")
    d.output("T", "command.T")
    d.output("q0", "attitude.q0")
    d.output("theta0", "setpoints.theta0")
    d.output("v0", "setpoints.v0")
    d.output("x0", "setpoints.x0")
    return d
