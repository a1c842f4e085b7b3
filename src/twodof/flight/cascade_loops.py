"""The loops of the cascade, and the level hold that finds the trim moment."""

from typing import Any

from twodof.blocks import Block, Port, State, int32, maximum, minimum, to_int32, to_real, where
from twodof.blocks.elementary.functions import atan, cos
from twodof.flight.declarations import finite, ports, tunables
from twodof.signals import ATTITUDE, RATE, VELOCITY


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
