"""Experiments: protocols that excite a rig whose flight controller runs a diagram, and the resulting flights."""

from twodof.experiment.experiments import EXPERIMENTS, IDENTIFICATION, Experiment, experiment
from twodof.experiment.flight import Flight, FlightCheck, Laboratory, simulate
from twodof.experiment.fly import fly
from twodof.experiment.prediction import PredictedMotion, predict

__all__ = [
    "EXPERIMENTS",
    "IDENTIFICATION",
    "Experiment",
    "Flight",
    "FlightCheck",
    "Laboratory",
    "PredictedMotion",
    "experiment",
    "fly",
    "predict",
    "simulate",
]
