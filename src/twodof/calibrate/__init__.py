"""Calibration of the `lab` rig on logs of real flights: its parameters, its gusts, and the FIT that these allow."""

from twodof.calibrate.calibration import FLIGHTS as FLIGHTS
from twodof.calibrate.calibration import PRIOR_WEIGHT as PRIOR_WEIGHT
from twodof.calibrate.calibration import UNKNOWNS as UNKNOWNS
from twodof.calibrate.calibration import Calibration as Calibration
from twodof.calibrate.calibration import CalibrationProgress as CalibrationProgress
from twodof.calibrate.calibration import ChargeEstimate as ChargeEstimate
from twodof.calibrate.calibration import calibrate as calibrate
from twodof.calibrate.calibration import estimate_charge as estimate_charge
from twodof.calibrate.calibration import find_flights as find_flights
from twodof.calibrate.calibration import to_rig as to_rig
from twodof.calibrate.gusts import HOLDS as HOLDS
from twodof.calibrate.gusts import GustEstimate as GustEstimate
from twodof.calibrate.gusts import HoverHold as HoverHold
from twodof.calibrate.gusts import gust_ceiling as gust_ceiling
from twodof.calibrate.gusts import gust_fits as gust_fits
from twodof.calibrate.gusts import measure_gusts as measure_gusts
