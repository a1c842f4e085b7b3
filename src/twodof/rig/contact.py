"""Contact: friction with true sticking, and stops that give back a share of the speed, as impulses and locks.

Sliding friction acts as an impulse at the end of the step, clamped so that it stops the motion and never reverses it.
The speed that it takes away within the step also takes away half of the way, as the force was there all along. What is
at rest is held in `derivative`: its acceleration is exactly 0 as long as the load stays within the friction or presses
against a stop. So a body at rest stays there to the bit.
"""

import math
from typing import Any

from twodof.blocks import maximum, minimum, where


def stays_at_rest(speed: Any, load: Any, friction: Any, place: Any, low: Any, high: Any) -> Any:
    """Whether a body at `place` with `speed` stays at rest under `load`: stuck, or pressed against a stop."""
    # A stop bears any load that presses against it, friction at most its own either way.
    up = where(place >= high, math.inf, friction)
    down = where(place <= low, math.inf, friction)
    return (speed == 0.0) & (load <= up) & (-down <= load)


def after_friction(place: Any, speed: Any, loss: Any, dt: Any) -> tuple[Any, Any]:
    """(place, speed) after friction that can take `loss` of speed within the step."""
    lost = maximum(-loss, minimum(loss, speed))
    return place - (0.5 * dt) * lost, speed - lost


def after_stops(place: Any, speed: Any, low: Any, high: Any, restitution: Any, rest: Any) -> tuple[Any, Any]:
    """(place, speed) after the stops: a body that went beyond one comes back with `restitution` of its speed.

    A rebound slower than `rest` ends on the stop.
    """
    stop = where(place > high, high, low)
    hit = ((place > high) & (speed > 0.0)) | ((place < low) & (speed < 0.0))
    back = -restitution * speed
    ends = abs(back) < rest
    after_place = where(ends, stop, stop - restitution * (place - stop))
    return where(hit, after_place, place), where(hit, where(ends, 0.0, back), speed)
