"""Loops of position, velocity, attitude and rate, and their cascade, entered at the loop that the mode names."""

from typing import Any

from twodof.blocks import Block, Diagram, Port, State, int32, maximum, minimum, to_int32, to_real, where
from twodof.blocks.elementary.functions import atan, cos
from twodof.flight.declarations import SET_POINTS, add_inputs, finite, ports, tunables
from twodof.flight.gains import DEFAULT, Gains
from twodof.signals import ATTITUDE, OFF, OPEN_LOOP, POSITION, RATE, VELOCITY


def limited(value: Any, limit: Any) -> Any:
    """`value` kept within +-`limit`."""
    return maximum(-limit, minimum(limit, value))


def _integral(error: Any, u: Any, x: Any, p: Any) -> tuple[Any, Any, Any]:
    """(sum, carry, increment) of the integral Ki e by backward Euler; in reset its own sample's contribution, Ki Ts e.

    The drone sums its integrals in double precision. In float32 a plain sum of some 1e4 terms drifts by 1e-6 of the
    moment. With the rounding error carried along (Kahan, CACM 8-1, 1965) it stays where the double sum is.
    """
    increment = p.ki_dt * error
    term = increment - x.carry
    total = x.sum + term
    carry = (total - x.sum) - term
    return where(u.in_reset, increment, total), where(u.in_reset, 0.0, carry), increment


class PositionLoop(Block):
    """v0 = Kp (x0 - x) in position mode, else the velocity set-point that is given."""

    inputs = (*ports("x0", "x", "v0"), Port("closed", "bool"))
    outputs = ports("v0")

    def __init__(self, kp: float | None = None) -> None:
        self.params = tunables("cascade.position", kp=kp)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return where(u.closed, limited(p.kp * (u.x0 - u.x), p.limit), u.v0)


class VelocityLoop(Block):
    """force = Kp e + integral of Ki e, e = v0 - v."""

    inputs = ports("v0", "v", "in_reset")
    outputs = tuple(Port(name, unit="N") for name in ("force", "proportional", "integral", "increment"))
    states = (State("sum", unit="N"), State("carry", unit="N"))
    derived = (Port("ki_dt"),)

    def __init__(self, kp: float | None = None, ki: float | None = None) -> None:
        self.params = tunables("cascade.velocity", kp=kp, ki=ki)

    def prepare(self, p: Any, t: Any) -> Any:
        return p.ki * t.dt

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        integral, _, increment = _integral(u.v0 - u.v, u, x, p)
        proportional = p.kp * (u.v0 - u.v)
        return {
            "force": proportional + integral,
            "proportional": proportional,
            "integral": integral,
            "increment": increment,
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        integral, carry, _ = _integral(u.v0 - u.v, u, x, p)
        return {"sum": integral, "carry": carry}


class Projection(Block):
    """Pitch and thrust that push with `force` along the rail and keep the vertical thrust.

    theta0 = -atan(force / (T_bar eta_T)), T = T_bar / cos(theta0).
    """

    inputs = (Port("force", unit="N"),)
    outputs = ports("theta0", "T")
    params = tunables("cascade.projection")

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        theta0 = -atan(u.force / (p.T_bar * p.eta_T))
        return {"theta0": theta0, "T": p.T_bar / cos(theta0)}


class AttitudeLoop(Block):
    """q0 = Kp (theta0 - theta), or in rate mode the rate set-point that is given."""

    inputs = (*ports("theta0", "theta", "q0"), Port("closed", "bool"))
    outputs = ports("q0")

    def __init__(self, kp: float | None = None) -> None:
        self.params = tunables("cascade.attitude", kp=kp)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return where(u.closed, limited(p.kp * (u.theta0 - u.theta), p.limit), u.q0)


class RateLoop(Block):
    """M = Kp e + integral of Ki e + Kd derivative, e = q0 - q, within +-limit.

    The derivative is (z - 1) / ((1/N + Ts) z - 1/N) and is never reset. No anti-windup, no feed-forward.
    `proportional`, `integral`, `derivative` and `increment` are the terms of M, for the log and for the replay.
    """

    inputs = ports("q0", "q", "in_reset")
    outputs = tuple(Port(name) for name in ("M", "proportional", "integral", "derivative", "increment"))
    states = (State("sum"), State("carry"), State("slope", unit="rad/s2"), State("error", unit="rad/s"))
    derived = (Port("ki_dt"), Port("decay"), Port("rise"))

    def __init__(self, kp: float | None = None, ki: float | None = None, kd: float | None = None) -> None:
        self.params = tunables("cascade.rate", kp=kp, ki=ki, kd=kd)

    def prepare(self, p: Any, t: Any) -> Any:
        lag = 1.0 / p.N
        return {"ki_dt": p.ki * t.dt, "decay": lag / (lag + t.dt), "rise": 1.0 / (lag + t.dt)}

    def _slope(self, u: Any, x: Any, p: Any) -> Any:
        return p.decay * x.slope + p.rise * ((u.q0 - u.q) - x.error)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        integral, _, increment = _integral(u.q0 - u.q, u, x, p)
        proportional = p.kp * (u.q0 - u.q)
        derivative = p.kd * self._slope(u, x, p)
        return {
            "M": limited(proportional + integral + derivative, p.limit),
            "proportional": proportional,
            "integral": integral,
            "derivative": derivative,
            "increment": increment,
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        integral, carry, _ = _integral(u.q0 - u.q, u, x, p)
        slope = self._slope(u, x, p)
        # Never reset, it would else be none for ever after one rate that is no number.
        return {"sum": integral, "carry": carry, "slope": where(finite(slope), slope, 0.0), "error": u.q0 - u.q}


class LevelHold(Block):
    """Finds the moment M_trim that holds the pitch, and adds it to an open-loop excitation flown right after.

    The hold begins `settle` s after the attitude mode was entered with thrust on. From then on M_trim is the mean of
    the moment over at most the last `window` s; what is older is forgotten exponentially. It is kept when the mode
    changes, until the next hold. In open loop M_open = excitation + M_trim where `use_trim`, else the excitation alone.
    """

    inputs = (*ports("mode", "M", "thrust"), Port("excitation"), *ports("use_trim"))
    outputs = (*ports("M_open"), Port("M_trim"))
    states = (State("mean"), State("samples", 0, "int32"))
    derived = (Port("settle_samples", "int32"), Port("window_samples"))
    params = tunables("hold")

    def prepare(self, p: Any, t: Any) -> Any:
        return {"settle_samples": to_int32(p.settle / t.dt + 0.5), "window_samples": p.window / t.dt}

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"M_open": u.excitation + where(u.use_trim, x.mean, 0.0), "M_trim": x.mean}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        holding = (u.mode == int32(ATTITUDE)) & (u.thrust > 0.0)
        samples = where(holding, minimum(x.samples + int32(1), int32(2**24)), int32(0))
        used = samples - p.settle_samples
        weight = 1.0 / minimum(maximum(to_real(used), 1.0), p.window_samples)
        return {
            "mean": where(used > int32(0), x.mean + weight * (u.M - x.mean), x.mean),
            "samples": samples,
        }


class ArmingReset(Block):
    """Reset of the integrals: while the drone gives no thrust, and for `samples` samples beyond the thrust's edge.

    There is thrust where the velocity loop makes it, and in rate and attitude mode where `thrust` > 0.
    """

    inputs = ports("mode", "thrust", "in_reset")
    outputs = ports("in_reset")
    states = (State("count", 0, "int32"),)
    # The drone's logs show two to four samples.
    params = tunables("arming")

    def _thrusting(self, u: Any) -> Any:
        return (u.mode >= int32(VELOCITY)) | ((u.mode >= int32(RATE)) & (u.thrust > 0.0))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.in_reset | ~self._thrusting(u) | (x.count < p.samples)

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return where(self._thrusting(u), minimum(x.count + int32(1), p.samples), int32(0))


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
