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
    """Return `seconds` as a number of periods of `dt` s, rounded to the nearest, at least 1; int32."""
    return maximum(int32(1), to_int32(seconds / dt + 0.5))


class WatchdogTimer(Block):
    """Flag that is true once `alive` was false for `timeout` s, this tick included.

    With N = timeout / dt, `expired` becomes true in the Nth tick in a row with `alive` false, and false as soon as
    `alive` is true. The count of ticks saturates at N. It starts there, so `expired` is true from the start until
    `alive` is true for the first time.
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
    """Flag that stays true for `time` s after `flag` has become false, so that an action does not switch to and fro."""

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
    """Flags of working sensors.

    IMU: `imu_moves`, a finite sample came in this tick, and at least one bit differs from the sample before (a driver
    that repeats itself gives the same bits); `axes_move`, it differs in each of its three axes, as noise makes nearly
    every sample do. Range sensor: `range_good`, a finite sample of a possible age came, within `range_error` of the
    cart's estimated position at that time; `range_moves`, a sample came that differs from the one before. With the cart
    locked the range is not needed, and both are true. With `watch_bits` false, repeated samples are accepted, for
    simulations without noise.

    `range_end`: two good samples in a row lay beyond `range_end`, the end of the rail.

    `range_taken`: the sample may correct the estimate. While armed only a good one may: otherwise the estimate would
    follow a wrong range until that counts as good. Before arming any finite one may, since the estimate starts
    anywhere. `range_age` is the age of an accepted sample, else 0.
    """

    inputs = ports(*IMU, "imu_new", *RANGE, "x", "v", "rings", "arm")
    outputs = (
        *(Port(name, "bool") for name in ("imu_moves", "axes_move", "range_good", "range_moves", "range_end")),
        Port("range_taken", "bool"),
        Port("range_age", unit="s"),
    )
    states = (*(State(port.name, unit=port.unit) for port in ports(*IMU, "dist")), State("at_end", False, "bool"))
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


class EstimateFlags(Block):
    """Flags of the estimates: pitch and cart near their stops, and estimates that cannot be right.

    `pitch_near`: |theta + look_ahead q| above `pitch_limit`, until below it by `pitch_margin`. `pitch_stop`: |theta| >=
    `pitch_end`. `rail_near`: the place where the cart could be stopped, x + v reaction + v |v| / (2 braking), is beyond
    `rail_limit`, until inside by `rail_margin`. `rail_end`: |x| >= `rail_end`. With the cart locked both are false.
    `estimate_lost`: theta, q, x or v is NaN or infinite, |theta| > `theta_bound` or |q| > `q_bound`. A NaN pitch raises
    this flag only, which asks for the strongest action, and not `pitch_stop`. `tilted`: |theta| above `arm_tilt`.
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
    """Flags `full` and `usable`: the voltage is above the threshold `low`, and above `critical`.

    After a voltage below a threshold the flag stays false until the voltage is above it by `margin`. A voltage above
    `high`, infinite or NaN comes from a failed sensor: both flags are then false.
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
    """Flags of mode and set-points.

    `invalid`: a set-point is infinite or NaN, or the mode is unknown. `fed`: a set-point came in this tick, or none is
    needed since the mode is off. `active`: the set-points ask for thrust or moment. `rings_wrong`: the mode moves the
    cart, but the rings lock it.
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
    """Flag `moves`: the commands to the motors differ in a bit from those of the tick before, or need not differ.

    In a closed loop with thrust, sensor noise makes the commands differ in every tick; constant ones tell that the
    controller has stopped. They need not differ in open loop, with motors stopped, or without a new IMU sample.
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


FORCE_SUMS = ("forth", "back", "hit_forth", "hit_back", "up", "down")
RATE_SUMS = ("faster", "slower")

Sums = dict[str, tuple[Any, Any]]
"""For each sum by name: its value after this sample, and a flag that it is at its limit."""


def cumulative_sum(total: Any, excess: Any, limit: Any, dt: Any) -> tuple[Any, Any]:
    """Return the cumulative sum (Page, Biometrika 41-1954) after a sample, and a flag that it has reached its limit.

    `total` is the sum before, `excess` the deviation less its slack. The sum is kept within 0 and the limit, so that
    the flag goes soon after its cause. One large or many small excesses reach the limit; deviations below the slack
    never do. A NaN sum is 0 again with the next finite sample.
    """
    new = total + excess * dt
    reached = new >= limit
    return where(new > 0.0, where(reached, limit, new), 0.0), reached


def _totals(sums: Sums) -> dict[str, Any]:
    return {name: total for name, (total, _) in sums.items()}


def _told(sums: Sums) -> dict[str, Any]:
    return _totals(sums) | {"disagrees": reduce(or_, [reached for _, reached in sums.values()])}


class ForceConsistency(Block):
    """Check of the measured specific force against the pitch and the commands of the tick before.

    An IMU that stands `imu_below` under the bearing and `imu_ahead` of it feels accelerations of its own, which follow
    from the rate `gyro_y` and its change `turning`; they are taken away. The estimated pitch (`sine`, `cosine`) turns
    the rest into a vertical part and one along the rail, whose values are known. Vertical: -g, as the rail holds the
    drone up. Along the rail: the cart's acceleration, which is 0 with the cart locked, else -`pull` T sin(theta) by the
    tilted thrust and -`drag` v. A remainder means a fault. Then the gyro does not follow the drone, an accelerometer is
    wrong, or the cart hits or presses against an end of the rail. A pitch error d leaves g d, less the thrust's share.

    The sums are unexplained speeds [m/s]. The slack along the rail is `along_slack` plus the share `pull_share` of the
    thrust's part, as a sagging battery pulls less. With the cart locked the limit is twice as high: the same pitch
    error leaves twice as much, and the cart rattles in the play of the rings. A second pair of sums, `hit_...`, has
    more slack and a lower limit. It detects the few samples of an impact on an end of the rail, for a free cart only.

    `speed` is the speed that pull and drag alone give the cart.
    """

    inputs = (*ports(*IMU, "sine", "cosine", "v", "fore", "aft", "rings"), Port("turning", unit="rad/s2"))
    outputs = (Port("disagrees", "bool"), *(Port(name, unit="m/s") for name in (*FORCE_SUMS, "speed")))
    states = (*(State(name, unit="m/s") for name in (*FORCE_SUMS, "speed")), State("thrust"))
    params = tunables("failsafe.force")

    def _sums(self, u: Any, x: Any, p: Any, t: Any) -> Sums:
        pull = p.pull * x.thrust * u.sine
        squared = u.gyro_y * u.gyro_y
        acc_x = u.acc_x - p.imu_below * u.turning + p.imu_ahead * squared
        acc_z = u.acc_z + p.imu_below * squared + p.imu_ahead * u.turning
        along = u.cosine * acc_x + u.sine * acc_z + where(u.rings, 0.0, pull + p.drag * u.v)
        down = u.cosine * acc_z - u.sine * acc_x + GRAVITY
        share = where(u.rings, 0.0, p.pull_share * abs(pull))
        slack = p.along_slack + share
        # Rotors shake the vertical axis more: by the tilt that is felt along the rail.
        hit_slack = p.hit_slack * (1.0 + 2.0 * abs(u.sine)) + share
        limit = where(u.rings, 2.0 * p.along_limit, p.along_limit)
        free = where(u.rings, 0.0, along)
        return {
            "forth": cumulative_sum(x.forth, along - slack, limit, t.dt),
            "back": cumulative_sum(x.back, -along - slack, limit, t.dt),
            "hit_forth": cumulative_sum(x.hit_forth, free - hit_slack, p.hit_limit, t.dt),
            "hit_back": cumulative_sum(x.hit_back, -free - hit_slack, p.hit_limit, t.dt),
            "up": cumulative_sum(x.up, -down - p.up_slack, p.up_limit, t.dt),
            "down": cumulative_sum(x.down, down - p.up_slack, p.up_limit, t.dt),
        }

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return _told(self._sums(u, x, p, t)) | {"speed": x.speed}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        speed = x.speed - (p.pull * x.thrust * u.sine + p.drag * x.speed) * t.dt
        return _totals(self._sums(u, x, p, t)) | {
            "speed": where(finite(speed), speed, 0.0),
            "thrust": 0.5 * (u.fore + u.aft),
        }


class RangeConsistency(Block):
    """Check of the measured range against the motion that pitch and thrust cause.

    `speed` is that motion, computed without the accelerometer. It is integrated to a place, which is sampled when a
    range sample is accepted (`range_taken`), so that both have the same delay. Place and range pass the same high-pass,
    (s / (s + `band`))^3, as the start, a tilted rail and the trim are unknown. The distance between them is the smaller
    one of two samples in a row, less `slack` and the share `share` of the expected motion. When its sum reaches
    `limit`, the range has stepped, or stays while the cart moves. Nothing is summed before the first sample, while
    disarmed, or with the cart locked.
    """

    inputs = (Port("speed", unit="m/s"), *ports("dist"), Port("range_taken", "bool"), *ports("arm", "rings"))
    outputs = (Port("disagrees", "bool"), Port("apart", unit="m*s"))
    states = (
        State("apart", unit="m*s"),
        *(State(name, unit="m") for name in ("place", "taken", "dist", "gap", "gap_before")),
        *(State(name, unit="m") for name in ("low_1", "low_2", "mean_1", "mean_2", "mean_3")),
        State("sampled", False, "bool"),
    )
    derived = (Port("per_band"),)
    params = tunables("failsafe.motion")

    def prepare(self, p: Any, t: Any) -> Any:
        return p.band * t.dt

    def _signals(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        def sampled(new: Any, held: Any) -> Any:
            return where(u.range_taken, new, held)

        taken, dist = sampled(x.place, x.taken), sampled(u.dist, x.dist)
        # Each stage of the high-pass; the place's first one is in its integration.
        stages = {"low_1": taken - x.low_1, "mean_1": dist - x.mean_1}
        stages |= {"low_2": stages["low_1"] - x.low_2, "mean_2": stages["mean_1"] - x.mean_2}
        stages |= {"mean_3": stages["mean_2"] - x.mean_3}
        expected = stages["low_2"]
        gap = stages["mean_3"] - expected
        before = sampled(x.gap, x.gap_before)
        lasting = where(gap * before > 0.0, minimum(abs(gap), abs(before)), 0.0)  # a single wrong sample does not last
        excess = lasting - p.slack - p.share * abs(expected)
        held = {"taken": taken, "dist": dist, "gap": sampled(gap, x.gap), "gap_before": before}
        return held, stages, cumulative_sum(x.apart, excess, p.limit, t.dt)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        *_, (apart, reached) = self._signals(u, x, p, t)
        return {"disagrees": reached & u.arm & ~u.rings, "apart": apart}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        held, stages, (apart, _) = self._signals(u, x, p, t)
        dist = held.pop("dist")
        new = held | {name: x[name] + p.per_band * high for name, high in stages.items()}
        new |= {"apart": apart, "place": x.place + u.speed * t.dt - p.per_band * x.place}
        start = dict.fromkeys(new, 0.0) | {"mean_1": dist}
        compared = u.arm & ~u.rings & x.sampled
        followed = {name: where(compared, value, start[name]) for name, value in new.items()}
        return {"dist": dist, "sampled": x.sampled | u.range_taken} | followed


class RateConsistency(Block):
    """Check of the gyro against the angular acceleration that the motors' commands cause.

    The expected acceleration is `turn` (lift(fore) - lift(aft)) with lift(u) = (1 - `curve`) u + `curve` u^2. One lag
    `answer` stands for the rotors' delay and lag; gravity takes away `swing` times the `sine` of the pitch. Another
    change of the gyro's rate means that the gyro is stuck, a rotor does not follow its command, or the drone has hit an
    end stop.

    The sums are unexplained rates [rad/s]. The slack is `turn_slack`, plus the share `turn_share` of the expected
    acceleration, plus the acceleration still within the lag, whose arrival is known to a few milliseconds only.

    `turning` is the change of the gyro's rate.
    """

    inputs = ports("gyro_y", "sine", "fore", "aft")
    outputs = (
        Port("disagrees", "bool"),
        *(Port(name, unit="rad/s") for name in RATE_SUMS),
        Port("turning", unit="rad/s2"),
    )
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

    def _turning(self, u: Any, x: Any, p: Any) -> Any:
        return (u.gyro_y - x.gyro_y) * p.per_dt

    def _sums(self, u: Any, x: Any, p: Any, t: Any) -> Sums:
        expected = p.turn * x.arrived - p.swing * u.sine
        left = self._turning(u, x, p) - expected
        slack = p.turn_slack + p.turn_share * abs(expected) + p.turn * abs(x.asked - x.arrived)
        return {
            "faster": cumulative_sum(x.faster, left - slack, p.turn_limit, t.dt),
            "slower": cumulative_sum(x.slower, -left - slack, p.turn_limit, t.dt),
        }

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return _told(self._sums(u, x, p, t)) | {"turning": self._turning(u, x, p)}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        def lift(command: Any) -> Any:
            return command * ((1.0 - p.curve) + p.curve * command)

        asked = lift(u.fore) - lift(u.aft)
        return _totals(self._sums(u, x, p, t)) | {
            "gyro_y": u.gyro_y,
            "asked": asked,
            "arrived": x.arrived + p.per_answer * (asked - x.arrived),
        }
