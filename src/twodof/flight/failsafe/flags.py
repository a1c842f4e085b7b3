"""Thresholds: measurements, estimates and set-points become flags, where they might chatter with a hysteresis."""

from functools import reduce
from operator import and_, or_
from typing import Any

from twodof.blocks import Block, Param, Port, State, int32, maximum, minimum, to_int32, where
from twodof.flight.declarations import ESTIMATED, IMU, RANGE, SET_POINTS, finite, ports, tunables
from twodof.signals import OFF, POSITION, RAIL_CENTRE, RATE, VELOCITY

MOST = 60.0
"""Longest time of a timer [s]: at 250 Hz a count of 15,000."""

_TIMEOUT = Param("timeout", 1.0, unit="s", low=0.004, high=MOST)
_TIME = Param("time", 0.5, unit="s", low=0.004, high=MOST)


def ticks(seconds: Any, dt: Any) -> Any:
    """`seconds` as a number of periods `dt`, to the nearest, one at least; int32."""
    return maximum(int32(1), to_int32(seconds / dt + 0.5))


class WatchdogTimer(Block):
    """Flag that is true once `alive` was false for `timeout` s, this tick included.

    With N = timeout / dt, `expired` comes in the Nth tick in a row without a sign of life (the first is tick 1). It
    goes in the tick of the next sign. The count saturates at N, where it starts, so that what was never alive is not
    waited for.
    """

    inputs = (Port("alive", "bool"),)
    outputs = (Port("expired", "bool"),)
    states = (State("count", "limit", "int32"),)
    derived = (Port("limit", "int32"),)

    def __init__(self, timeout: Param = _TIMEOUT) -> None:
        self.params = [timeout]

    def prepare(self, p: Any, t: Any) -> Any:
        return ticks(p.timeout, t.dt)

    def _count(self, u: Any, x: Any, p: Any) -> Any:
        # The comparison comes before the sum: a count that a fault has put anywhere cannot wrap around.
        return where(u.alive, int32(0), where(x.count < p.limit, maximum(x.count, int32(0)) + int32(1), p.limit))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self._count(u, x, p) >= p.limit  # the limit is 1 at least, and alive the count is 0

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self._count(u, x, p)


class OffDelay(Block):
    """`flag`, and for `time` s after it: what it starts lasts, so that nothing switches to and fro faster than that."""

    inputs = (Port("flag", "bool"),)
    outputs = (Port("lasting", "bool"),)
    states = (State("left", 0, "int32"),)
    derived = (Port("limit", "int32"),)

    def __init__(self, time: Param = _TIME) -> None:
        self.params = [time]

    def prepare(self, p: Any, t: Any) -> Any:
        return ticks(p.time, t.dt)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.flag | (x.left > int32(0))

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return where(u.flag, p.limit, maximum(int32(1), minimum(x.left, p.limit)) - int32(1))


class SensorFlags(Block):
    """Which sensors are alive.

    The IMU: `imu_moves`, a sample of finite numbers came in this tick, and at least one bit differs from the last
    (a driver that repeats itself gives the same bits). `axes_move`, it differs in each of its three axes, as its
    noise makes nearly every sample differ. The range sensor: `range_good`, a sample came that is a number and of a
    possible age. It lies within `range_error` of the published place of the cart at its time. `range_moves`, one that
    differs from the last. With the cart locked the range is not needed, and both are true. `watch_bits` off takes
    repeated samples for good, for simulations without noise only.

    `range_end`: two believed samples in a row lay at `range_end`, at an end of the rail, wherever the estimate is.

    `range_taken`: the sample that came may correct the estimate. While `arm`ed one that is not believed does not, or
    the estimate would follow it until it is; before that any number does, since the estimate begins anywhere.
    `range_age` is its age, 0 where none is taken.
    """

    inputs = ports(*IMU, "imu_new", *RANGE, "x", "v", "rings", "arm")
    outputs = (
        *(Port(name, "bool") for name in ("imu_moves", "axes_move", "range_good", "range_moves", "range_end")),
        Port("range_taken", "bool"),
        Port("range_age", unit="s"),
    )
    states = (
        *(State(port.name, unit=port.unit) for port in ports(*IMU, "dist")),
        State("at_end", False, "bool"),
    )
    params = tunables("failsafe.sensors")

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        moved = [u[axis] != x[axis] for axis in IMU]
        sample = u.imu_new & reduce(and_, [finite(u[axis]) for axis in IMU])
        good = self._good(u, p)
        taken = good | (u.dist_new & self._number(u, p) & ~u.arm)
        return {
            "imu_moves": sample & (reduce(or_, moved) | ~p.watch_bits),
            "axes_move": sample & (reduce(and_, moved) | ~p.watch_bits),
            "range_good": u.rings | good,
            "range_moves": u.rings | (u.dist_new & ((u.dist != x.dist) | ~p.watch_bits)),
            "range_end": ~u.rings & good & x.at_end & self._at_end(u, p),
            "range_taken": taken,
            "range_age": where(taken, u.dist_age, 0.0),
        }

    def _number(self, u: Any, p: Any) -> Any:
        return finite(u.dist) & (u.dist_age >= 0.0) & (u.dist_age <= p.range_old)

    def _good(self, u: Any, p: Any) -> Any:
        near = abs(u.dist - RAIL_CENTRE - (u.x - u.v * u.dist_age)) <= p.range_error
        return u.dist_new & self._number(u, p) & near

    def _at_end(self, u: Any, p: Any) -> Any:
        return abs(u.dist - RAIL_CENTRE) >= p.range_end

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {axis: where(u.imu_new, u[axis], x[axis]) for axis in IMU} | {
            "dist": where(u.dist_new, u.dist, x.dist),
            "at_end": where(u.dist_new, self._good(u, p) & self._at_end(u, p), x.at_end),
        }


class PlaceFlags(Block):
    """Where pitch and cart are, and whether the estimates are believed.

    `pitch_near`: |theta + look_ahead q| above `pitch_limit`, until below it by `pitch_margin`; `pitch_stop`: |theta| at
    `pitch_end`. `rail_near`: the place where the cart could be stopped, x + v reaction + v |v| / (2 braking), is beyond
    `rail_limit`, until inside by `rail_margin`; `rail_end`: |x| at `rail_end`. A locked cart is near no end.
    `estimate_lost`: theta, q, x or v is NaN or infinite, |theta| > `theta_bound` or |q| > `q_bound`. It asks for the
    strongest action, so NaN raises it alone: where the pitch is not known it is not said to be at its stop.
    """

    inputs = ports(*ESTIMATED, "rings")
    outputs = tuple(
        Port(name, "bool") for name in ("estimate_lost", "pitch_near", "pitch_stop", "rail_near", "rail_end", "tilted")
    )
    states = (State("pitch_near", False, "bool"), State("rail_near", False, "bool"))
    params = tunables("failsafe.place")

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        theta, q = abs(u.theta), abs(u.q)
        foreseen = abs(u.theta + p.look_ahead * u.q)
        stopped_at = abs(u.x + u.v * (p.reaction + abs(u.v) / (2.0 * p.braking)))
        believed = (theta <= p.theta_bound) & (q <= p.q_bound) & finite(u.x) & finite(u.v)
        return {
            "estimate_lost": ~believed,
            "pitch_near": foreseen > where(x.pitch_near, p.pitch_limit - p.pitch_margin, p.pitch_limit),
            "pitch_stop": theta >= p.pitch_end,
            "rail_near": ~u.rings & (stopped_at > where(x.rail_near, p.rail_limit - p.rail_margin, p.rail_limit)),
            "rail_end": ~u.rings & (abs(u.x) >= p.rail_end),
            "tilted": theta > p.arm_tilt,
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        now = self.output(u, x, p, t)
        return {"pitch_near": now["pitch_near"], "rail_near": now["rail_near"]}


class BatteryFlags(Block):
    """`full` and `usable`: the voltage is above the low and the critical threshold, and one that the pack can have.

    Once below one it counts as below until it is above by `margin`. A voltage above `high`, infinite or NaN is a sensor
    that has failed: how full the pack is is not known, and it counts as empty.
    """

    inputs = ports("voltage")
    outputs = (Port("full", "bool"), Port("usable", "bool"))
    states = (State("low", False, "bool"), State("critical", False, "bool"))
    params = tunables("failsafe.battery")

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        believed = u.voltage <= p.high
        return {
            "full": believed & (u.voltage >= where(x.low, p.low + p.margin, p.low)),
            "usable": believed & (u.voltage >= where(x.critical, p.critical + p.margin, p.critical)),
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        now = self.output(u, x, p, t)
        return {"low": ~now["full"], "critical": ~now["usable"]}


class SetPointFlags(Block):
    """Flags of the set-points: idle, invalid.

    `invalid`: one is infinite or NaN. `fed`: a set-point came in this tick, or none is needed since the mode is off.
    `active`: the motors are asked for something. `rings_wrong`: a mode that moves the cart, which is locked.
    """

    inputs = ports("mode", *SET_POINTS, "setpoint_new", "rings")
    outputs = tuple(Port(name, "bool") for name in ("invalid", "fed", "active", "rings_wrong"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        off = u.mode <= int32(OFF)
        along_rail = u.mode >= int32(VELOCITY)
        return {
            "invalid": ~reduce(and_, [finite(u[name]) for name in SET_POINTS]) | (u.mode > int32(POSITION)),
            "fed": u.setpoint_new | off,
            "active": ~off & (along_rail | (u.thrust != 0.0) | (u.M_open != 0.0)),
            "rings_wrong": u.rings & along_rail,
        }


class StuckCommands(Block):
    """`moves`: the commands that flew differ from those before in a bit, or need not, or the IMU gave nothing new.

    In a closed loop with thrust noise alone moves them; commands that stand still come of a controller that does.
    """

    inputs = (*ports("mode"), Port("imu_moves", "bool"), *ports("stopped", "fore", "aft"))
    outputs = (Port("moves", "bool"),)
    states = (State("fore"), State("aft"), State("moves", True, "bool"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.moves

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        moved = (u.fore != x.fore) | (u.aft != x.aft)
        standing = (u.fore == 0.0) & (u.aft == 0.0)
        needed = (u.mode >= int32(RATE)) & ~u.stopped & ~standing & u.imu_moves
        return {"fore": u.fore, "aft": u.aft, "moves": moved | ~needed}
