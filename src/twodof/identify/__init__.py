"""Identification: from a record to a model and its uncertainty; from a model to the experiment that tells it best."""

from twodof.identify.disturbance import DisturbanceModel, Gust
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import KINDS, ExperimentKind, cut, only
from twodof.identify.frequency_response import FrequencyResponse, frequency_response
from twodof.identify.greybox import fit, named_model
from twodof.identify.information import (
    PITCH_LIMITS,
    RAIL_LIMITS,
    Design,
    Information,
    Limits,
    best,
    doublets,
    multisines,
    predict,
    three_two_one_ones,
)
from twodof.identify.multi_start import LocalMinimum, MultiStart, fit_from_several
from twodof.identify.ranking import Ranking, rank, select
from twodof.identify.record import Record, Samples, merge
from twodof.identify.repeated import Repeated, Spread, repeat
from twodof.identify.simple_pitch import SimplePitch, identify_pitch
from twodof.identify.simple_velocity import SimpleVelocity, identify_velocity
from twodof.identify.simulation import ComparedModel, ModelTable, compare, initial_state, predict_ahead, simulate
from twodof.identify.subspace import SubspaceModel, subspace
from twodof.identify.transfer_fit import TransferFactor, TransferFit, fit_transfer
from twodof.identify.validate import (
    Comparison,
    Correlation,
    comparison,
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
    "ComparedModel",
    "Comparison",
    "Correlation",
    "Design",
    "DisturbanceModel",
    "Estimate",
    "ExperimentKind",
    "FrequencyResponse",
    "Gust",
    "Information",
    "Limits",
    "LocalMinimum",
    "ModelTable",
    "MultiStart",
    "Ranking",
    "Record",
    "Repeated",
    "Samples",
    "SimplePitch",
    "SimpleVelocity",
    "Spread",
    "SubspaceModel",
    "TransferFactor",
    "TransferFit",
    "best",
    "compare",
    "comparison",
    "cross_correlation",
    "cut",
    "doublets",
    "fit",
    "fit_from_several",
    "fit_percent",
    "fit_transfer",
    "frequency_response",
    "identify_pitch",
    "identify_velocity",
    "initial_state",
    "merge",
    "multisines",
    "named_model",
    "only",
    "predict",
    "predict_ahead",
    "rank",
    "repeat",
    "rmse",
    "select",
    "simulate",
    "subspace",
    "three_two_one_ones",
    "vaf",
    "whiteness",
]
