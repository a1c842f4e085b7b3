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
from twodof.identify.disturbance import DisturbanceModel, Gust
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import KINDS, ExperimentKind, cut, only
from twodof.identify.frequency.frequency_response import FrequencyResponse, frequency_response
from twodof.identify.frequency.transfer_fit import TransferFactor, TransferFit, fit_transfer
from twodof.identify.greybox import fit
from twodof.identify.information import Information, predict
from twodof.identify.record import Record, Samples
from twodof.identify.repeated import Repeated, Spread, repeat
from twodof.identify.rotor_speed import RotorSpeed, RotorSpeeds, rotor_speeds
from twodof.identify.search.multi_start import LocalMinimum, MultiStart, fit_from_several
from twodof.identify.search.subspace import SubspaceModel, subspace
from twodof.identify.selection.ranking import Ranking, rank, select
from twodof.identify.selection.stepwise import Stepwise, stepwise
from twodof.identify.simple_pitch import SimplePitch, identify_pitch
from twodof.identify.simple_velocity import SimpleVelocity, identify_velocity
from twodof.identify.simulation import initial_state, predict_ahead, simulate
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
    "DisturbanceModel",
    "Estimate",
    "ExperimentKind",
    "FrequencyResponse",
    "Gust",
    "Information",
    "Limits",
    "LocalMinimum",
    "MultiStart",
    "Ranking",
    "Record",
    "Repeated",
    "RotorSpeed",
    "RotorSpeeds",
    "Samples",
    "SimplePitch",
    "SimpleVelocity",
    "Spread",
    "Stepwise",
    "SubspaceModel",
    "TransferFactor",
    "TransferFit",
    "best",
    "compare",
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
    "multisines",
    "only",
    "predict",
    "predict_ahead",
    "rank",
    "repeat",
    "rmse",
    "rotor_speeds",
    "select",
    "simulate",
    "stepwise",
    "subspace",
    "three_two_one_ones",
    "vaf",
    "whiteness",
]
