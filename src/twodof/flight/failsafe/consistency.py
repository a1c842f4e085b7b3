"""Agreement: whether the sensors feel what pitch, thrust, moment and rail explain. Else one has failed."""

from functools import reduce
from operator import or_
from typing import Any

from twodof.blocks import Block, Port, State, minimum, where
from twodof.flight.declarations import ports, tunables
from twodof.signals import GRAVITY

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
