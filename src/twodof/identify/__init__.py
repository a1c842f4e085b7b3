"""Identification: from a record to a model and its uncertainty; from a model to the experiment that tells it best."""

from twodof.identify.best_excitation import (
    PITCH_LIMITS,
    RAIL_LIMITS,
    Design,
    Limits,
    best,
    doublets,
    multisines,
    three_two_one_ones,
)
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import KINDS, ExperimentKind, cut, only
from twodof.identify.frequency import FrequencyResponse, frequency_response
from twodof.identify.greybox import fit
from twodof.identify.information import Information, predict
from twodof.identify.record import Record, Samples
from twodof.identify.repeated import Repeated, Spread, repeat
from twodof.identify.simple_pitch import SimplePitch, identify_pitch
from twodof.identify.simple_velocity import SimpleVelocity, identify_velocity
from twodof.identify.validate import (
    Comparison,
    Correlation,
    compare,
    cross_correlation,
    fit_percent,
    rmse,
    vaf,
    whiteness,
)

__all__ = [
    "KINDS",
    "PITCH_LIMITS",
    "RAIL_LIMITS",
    "Comparison",
    "Correlation",
    "Design",
    "Estimate",
    "ExperimentKind",
    "FrequencyResponse",
    "Information",
    "Limits",
    "Record",
    "Repeated",
    "Samples",
    "SimplePitch",
    "SimpleVelocity",
    "Spread",
    "best",
    "compare",
    "cross_correlation",
    "cut",
    "doublets",
    "fit",
    "fit_percent",
    "frequency_response",
    "identify_pitch",
    "identify_velocity",
    "multisines",
    "only",
    "predict",
    "repeat",
    "rmse",
    "three_two_one_ones",
    "vaf",
    "whiteness",
]
