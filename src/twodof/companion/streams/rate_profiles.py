"""What a client gets that has asked for nothing: the flight controller's rates, onboard and ground, or none.

What comes at each change too would be held back by thinning, and passes as it comes.
"""

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

from twodof.errors import LinkError, listed, shown
from twodof.link.mavlink import dialect
from twodof.link.mavlink.rates import PROFILES as FLIGHT_CONTROLLERS
from twodof.link.mavlink.rates import RATES

EVERY = 0  # interval of a message that is passed on whenever it comes
OFF = -1
_PASSED = frozenset(row.number for row in RATES if row.on_change)
# Of these what all get who know our own messages, as they come; the rest passes as the flight controller sends it.
_OWN = ("TWODOF_RIG", "TWODOF_LEASE", "TWODOF_SAFETY", "TWODOF_TIMING")
_RATES: Mapping[str, Mapping[int, float]] = {**FLIGHT_CONTROLLERS, "none": {}}
PROFILES = tuple(_RATES)
# REQUEST_DATA_STREAM's groups (MAV_DATA_STREAM); group 0 is all of a client's.
GROUPS = MappingProxyType(
    {
        1: ("HIGHRES_IMU",),
        2: ("SYS_STATUS", "EXTENDED_SYS_STATE", "BATTERY_STATUS"),
        3: ("SERVO_OUTPUT_RAW",),
        6: ("LOCAL_POSITION_NED", "ODOMETRY"),
        10: ("ATTITUDE", "ATTITUDE_QUATERNION", "ATTITUDE_TARGET"),
        11: ("VFR_HUD", "POSITION_TARGET_LOCAL_NED"),
        12: ("DISTANCE_SENSOR",),
    }
)


@cache
def profile(name: str) -> Mapping[int, int]:
    """Message id -> interval [us] (EVERY, or 1 and more) of the rates called `name`. Raises LinkError if none are."""
    if name not in _RATES:
        raise LinkError(f"no rates {shown(name)}", "companion", f"there are {listed(PROFILES)}")
    rates = {number: rate for number, rate in _RATES[name].items() if number not in _PASSED}
    thinned = {number: round(1e6 / rate) if rate > 0.0 else EVERY for number, rate in rates.items()}
    return dict.fromkeys(map(dialect.message_id, _OWN), EVERY) | thinned


def group(number: int) -> tuple[int, ...] | None:
    """Message ids of a group of REQUEST_DATA_STREAM, None for all."""
    return None if number == 0 else tuple(dialect.message_id(name) for name in GROUPS.get(number, ()))
