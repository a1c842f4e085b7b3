"""Flags from measurements, estimates and set-points: timers, thresholds with hysteresis, consistency of the IMU."""

from functools import reduce
from operator import and_, or_
from typing import Any

from twodof.blocks import Block, Param, Port, State, int32, maximum, minimum, to_int32, where
from twodof.flight.declarations import ESTIMATED, IMU, RANGE, SET_POINTS, finite, ports, tunables
from twodof.signals import GRAVITY, OFF, POSITION, RAIL_CENTRE, RATE, VELOCITY

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


FORCE_SUMS = ("forth", "back", "up", "down")
RATE_SUMS = ("faster", "slower")

Sums = dict[str, tuple[Any, Any]]
"""Name of a sum -> what it is after this sample, and whether it is at its limit."""


def cumulative_sum(total: Any, excess: Any, limit: Any, dt: Any) -> tuple[Any, Any]:
    """Return a cumulative sum (Page, Biometrika 41-1954) of the excess after a sample, and whether it is at its limit.

    It never falls below 0 and is held at the limit, so that it goes soon after its cause. It reaches the limit by one
    large sample or by many small ones in a row; what stays below the slack for ever it never adds up. A sum that is
    NaN is 0 again with the next finite sample.
    """
    new = total + excess * dt
    reached = new >= limit
    return where(new > 0.0, where(reached, limit, new), 0.0), reached


def _totals(sums: Sums) -> dict[str, Any]:
    return {name: total for name, (total, _) in sums.items()}


def _told(sums: Sums) -> dict[str, Any]:
    return _totals(sums) | {"disagrees": reduce(or_, [reached for _, reached in sums.values()])}


class ForceConsistency(Block):
    """Check of the specific force against the pitch and the commands that flew the tick before.

    Turned by the estimated pitch (`sine`, `cosine`), the specific force has two parts that are known without it.
    Vertical it is -g, as the rail holds the drone up. Along the rail it is the cart's acceleration: 0 with the cart
    locked, else that of the thrust tilted by theta, -`pull` T sin(theta), and -`drag` v. What is left has another
    cause. The gyro does not turn with the drone: a pitch that is wrong by d leaves g d, or g d less the thrust's share.
    An accelerometer is off. The cart stands against an end of the rail though the thrust pulls, or has just hit it.

    The sums are unexplained speeds. The slack along the rail is `along_slack` and the share `pull_share` of the
    thrust's part, as a battery that sags pulls less. With the cart locked the same error of the pitch leaves twice as
    much, and the play of the rings rattles: the limit is twice as high.
    """

    inputs = ports("acc_x", "acc_z", "sine", "cosine", "v", "fore", "aft", "rings")
    outputs = (Port("disagrees", "bool"), *(Port(name, unit="m/s") for name in FORCE_SUMS))
    states = (*(State(name, unit="m/s") for name in FORCE_SUMS), State("thrust"))
    params = tunables("failsafe.force")

    def _sums(self, u: Any, x: Any, p: Any, t: Any) -> Sums:
        pull = p.pull * x.thrust * u.sine
        along = u.cosine * u.acc_x + u.sine * u.acc_z + where(u.rings, 0.0, pull + p.drag * u.v)
        down = u.cosine * u.acc_z - u.sine * u.acc_x + GRAVITY
        slack = p.along_slack + where(u.rings, 0.0, p.pull_share * abs(pull))
        limit = where(u.rings, 2.0 * p.along_limit, p.along_limit)
        return {
            "forth": cumulative_sum(x.forth, along - slack, limit, t.dt),
            "back": cumulative_sum(x.back, -along - slack, limit, t.dt),
            "up": cumulative_sum(x.up, -down - p.up_slack, p.up_limit, t.dt),
            "down": cumulative_sum(x.down, down - p.up_slack, p.up_limit, t.dt),
        }

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return _told(self._sums(u, x, p, t))

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return _totals(self._sums(u, x, p, t)) | {"thrust": 0.5 * (u.fore + u.aft)}


class RateConsistency(Block):
    """Check of the gyro against the turning that the commands ask for.

    The commands that flew turn the drone by `turn` (lift(fore) - lift(aft)), with lift(u) = (1 - `curve`) u +
    `curve` u^2. They act after the rotors' delay and lag, here one lag `answer`. Gravity turns it back by `swing` times
    the `sine` of the pitch. No other change of the gyro's rate is expected. Where one is seen, the gyro stands still
    while the moment grows, a rotor does not obey, or the drone has hit an end stop.

    The sums are unexplained rates. The slack is `turn_slack`, the share `turn_share` of what is expected, and what is
    still under way through the lag. When that arrives is known to a few milliseconds only.
    """

    inputs = ports("gyro_y", "sine", "fore", "aft")
    outputs = (Port("disagrees", "bool"), *(Port(name, unit="rad/s") for name in RATE_SUMS))
    states = (
        *(State(name, unit="rad/s") for name in RATE_SUMS),
        State("gyro_y", unit="rad/s"),
        State("asked"),
        State("arrived"),
    )
    derived = (Port("per_answer"), Port("per_dt", unit="1/s"))
    params = tunables("failsafe.rate")

    def prepare(self, p: Any, t: Any) -> Any:
        return {"per_answer": minimum(1.0, t.dt / p.answer), "per_dt": 1.0 / t.dt}

    def _sums(self, u: Any, x: Any, p: Any, t: Any) -> Sums:
        expected = p.turn * x.arrived - p.swing * u.sine
        left = (u.gyro_y - x.gyro_y) * p.per_dt - expected
        slack = p.turn_slack + p.turn_share * abs(expected) + p.turn * abs(x.asked - x.arrived)
        return {
            "faster": cumulative_sum(x.faster, left - slack, p.turn_limit, t.dt),
            "slower": cumulative_sum(x.slower, -left - slack, p.turn_limit, t.dt),
        }

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return _told(self._sums(u, x, p, t))

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        def lift(command: Any) -> Any:
            return command * ((1.0 - p.curve) + p.curve * command)

        asked = lift(u.fore) - lift(u.aft)
        return _totals(self._sums(u, x, p, t)) | {
            "gyro_y": u.gyro_y,
            "asked": asked,
            "arrived": x.arrived + p.per_answer * (asked - x.arrived),
        }
