"""Loops of position, velocity, attitude and rate, and their cascade; the mode selects the outermost closed loop."""

from typing import Any

from twodof.blocks import Block, Diagram, Port, State, int32, maximum, minimum, to_int32, to_real, where
from twodof.blocks.elementary.functions import atan, cos
from twodof.flight.declarations import SET_POINTS, add_inputs, finite, ports, tunables
from twodof.flight.gains import DEFAULT, Gains
from twodof.signals import ATTITUDE, OFF, OPEN_LOOP, POSITION, RATE, VELOCITY


def limited(value: Any, limit: Any) -> Any:
    """Return `value` limited to +-`limit`."""
    return maximum(-limit, minimum(limit, value))


def _integral(error: Any, u: Any, x: Any, p: Any) -> tuple[Any, Any, Any]:
    """Return (sum, carry, increment) of the integral of Ki e by backward Euler; in reset the sum is Ki Ts e alone.

    The drone sums its integrals in double precision. In float32 a plain sum of some 1e4 terms drifts by 1e-6 of the
    moment. Carrying the rounding error along (Kahan, CACM 8-1, 1965) keeps it at the sum in double precision.
    """
    increment = p.ki_dt * error
    term = increment - x.carry
    total = x.sum + term
    carry = (total - x.sum) - term
    return where(u.in_reset, increment, total), where(u.in_reset, 0.0, carry), increment


class PositionLoop(Block):
    """v0 = Kp (x0 - x) within +-limit while `closed`, else the velocity set-point at the input."""

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
    """q0 = Kp (theta0 - theta) within +-limit while `closed`, else the rate set-point at the input."""

    inputs = (*ports("theta0", "theta", "q0"), Port("closed", "bool"))
    outputs = ports("q0")

    def __init__(self, kp: float | None = None) -> None:
        self.params = tunables("cascade.attitude", kp=kp)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return where(u.closed, limited(p.kp * (u.theta0 - u.theta), p.limit), u.q0)


class RateLoop(Block):
    """The PID of the pitch rate: M = Kp e + integral of Ki e + Kd derivative, e = q0 - q, within +-limit.

    The derivative's filter is (z - 1) / ((1/N + Ts) z - 1/N); `in_reset` resets the integral alone. There is no
    anti-windup and no feed-forward. `proportional`, `integral`, `derivative` and `increment` (of the integral) are for
    log and replay.
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
        # Reset on NaN; otherwise one NaN rate would stay in the state for ever.
        return {"sum": integral, "carry": carry, "slope": where(finite(slope), slope, 0.0), "error": u.q0 - u.q}


class LevelHold(Block):
    """Estimator of the moment M_trim that holds the pitch, which is added to an open-loop excitation flown right after.

    The hold begins `settle` s after the attitude mode was entered with thrust on. From then on M_trim is the mean of
    the moment, up to the first `window` s, and then its exponential average with that time constant. M_trim is kept
    when the mode changes, until the next hold. M_open = excitation + M_trim with `use_trim`, else the excitation.
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
        return {"mean": where(used > int32(0), x.mean + weight * (u.M - x.mean), x.mean), "samples": samples}


class ArmingReset(Block):
    """Reset of the integrals: while the drone gives no thrust, and for the first `samples` samples with thrust.

    There is thrust in velocity and position mode, and in rate and attitude mode with `thrust` > 0.
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
    """Flags of the loops that a mode closes, and resets of the integrals in open loops, which start from 0 later."""

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
    """Set-points in use, for the log; an unused one is 0, but x0 is x in velocity mode, as in the drone's logs."""

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
    """Set-point from outside while the mode is `mode`, else 0, as those inside a user's controller are not known."""

    def __init__(self, mode: int, unit: str) -> None:
        self.mode = mode
        self.inputs = (*ports("mode"), Port("given", unit=unit))
        self.outputs = (Port("used", unit=unit),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return where(u.mode == int32(self.mode), u.given, 0.0)


class MomentAndThrust(Block):
    """Moment and thrust for the mixer: of the closed loops, or in open loop of the set-points; 0 in the mode off."""

    inputs = (*ports("mode"), Port("M_loop"), Port("T_loop"), *ports("M_open", "thrust"))
    outputs = ports("M", "T")

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        off = u.mode <= int32(OFF)
        moment = where(u.mode == int32(OPEN_LOOP), u.M_open, u.M_loop)
        thrust = where(u.mode >= int32(VELOCITY), u.T_loop, u.thrust)
        return {"M": where(off, 0.0, moment), "T": where(off, 0.0, thrust)}


def cascade(gains: Gains = DEFAULT, attitude: Diagram | None = None, position: Diagram | None = None) -> Diagram:
    """Return the diagram of the cascade with `gains`, made for 250 Hz.

    Inputs: `mode` (int32, index into `signals.MODES`) and `in_reset` (bool, holds the integrals in reset). The mode
    uses one of the set-points `x0` [m], `v0` [m/s], `theta0` [rad], `q0` [rad/s]. `thrust` is for the modes without
    velocity loop, `M_open` for open loop. The estimates are `x`, `v`, `theta`, `q`. Outputs: `M`, `T` and the
    set-points in use, `q0`, `theta0`, `v0`, `x0`. Parameters: `rate.kp/ki/kd/N/limit`, `attitude.kp/limit`,
    `velocity.kp/ki`, `projection.T_bar/eta_T`, `position.kp/limit`.

    `attitude` and `position` are diagrams of the templates `attitude_control` and `position_control`
    (`flight.templates`), which replace the stock loops as parts of these names. The set-points between loops inside
    such a part are not known outside, so the outputs `q0` and `v0` are then 0 unless the mode takes them as inputs.
    With `position` there is one more input, `ax0` [m/s2].
    """
    d = Diagram("cascade", "position, velocity, attitude and rate loop; the mode names the outermost that is closed")
    add_inputs(d, "mode", "in_reset", *SET_POINTS, "x", "v", "theta", "q")
    d.add("logic", ModeLogic(), mode="mode", in_reset="in_reset")
    v0_used, tilt, thrust = _stock_position(d, gains) if position is None else _user_position(d, position)
    d.add("setpoints", SetPointsInUse(), mode="mode", x0="x0", x="x", v0=v0_used, theta0="theta0", projected=tilt)
    q0_used, moment = _stock_attitude(d, gains) if attitude is None else _user_attitude(d, attitude)
    d.add("command", MomentAndThrust(), mode="mode", M_loop=moment, T_loop=thrust, M_open="M_open", thrust="thrust")
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


def _user_position(d: Diagram, position: Diagram) -> tuple[str, str, str]:
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


def _user_attitude(d: Diagram, attitude: Diagram) -> tuple[str, str]:
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
