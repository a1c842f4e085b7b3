"""What a simulated flight looks like on the ground: the drone's log, channel for channel, with its time stamps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.flightlog.log import FlightLog
from twodof.flightlog.steps import BOOT, step_channels

__all__ = ["BOOT", "flight_log"]


def flight_log(out: Mapping[str, NDArray[Any]], mode: NDArray[np.int32], provenance: dict[str, Any]) -> FlightLog:
    """The log of a flight whose signals at the control steps are `out`, as `ClosedLoop.fly` gives them.

    Samples that are not finite, which a user's controller may give, are left out: the channel has a gap there.
    """
    return FlightLog(step_channels(np.arange(len(mode), dtype=np.int64), out, mode), provenance)
