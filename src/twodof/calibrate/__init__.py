"""Calibrate: the `lab` rig from the logs of real flights: its parameters, its gusts, and what they let a FIT reach."""

from twodof.calibrate.calibration import (
    FLIGHTS,
    PRIOR_WEIGHT,
    UNKNOWNS,
    Calibration,
    CalibrationFlight,
    CalibrationProgress,
    calibrate,
    find_flights,
    to_rig,
)
from twodof.calibrate.ceiling import gust_ceiling, gust_fits
from twodof.calibrate.charge import ChargeEstimate, estimate_charge
from twodof.calibrate.gusts import HOLDS, GustEstimate, HoverHold, measure_gusts

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
