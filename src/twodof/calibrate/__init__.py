"""Calibrate: the `lab` rig from the logs of real flights: its parameters, its gusts, and what they let a FIT reach."""

from twodof.calibrate.calibration import (
    FLIGHTS,
    PRIOR_WEIGHT,
    UNKNOWNS,
    Calibration,
    CalibrationFlight,
    CalibrationProgress,
    ChargeEstimate,
    calibrate,
    estimate_charge,
    find_flights,
    to_rig,
)
from twodof.calibrate.gusts import HOLDS, GustEstimate, HoverHold, gust_ceiling, gust_fits, measure_gusts

__all__ = [
    "FLIGHTS",
    "HOLDS",
    "PRIOR_WEIGHT",
    "UNKNOWNS",
    "Calibration",
    "CalibrationFlight",
    "CalibrationProgress",
    "ChargeEstimate",
    "GustEstimate",
    "HoverHold",
    "calibrate",
    "estimate_charge",
    "find_flights",
    "gust_ceiling",
    "gust_fits",
    "measure_gusts",
    "to_rig",
]
