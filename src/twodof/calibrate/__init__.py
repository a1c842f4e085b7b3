"""Calibration of the `lab` rig on logs of real flights: its parameters, its gusts, and the FIT that these allow."""

from twodof.calibrate.calibration import (
    FLIGHTS,
    PRIOR_WEIGHT,
    UNKNOWNS,
    Calibration,
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
