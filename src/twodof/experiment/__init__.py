"""Experiments: protocols that excite a rig whose flight controller runs a diagram, and the flights they make."""

from twodof.experiment.flight import Check, Flight, Laboratory, simulate
from twodof.experiment.protocol import EXPERIMENTS, IDENTIFICATION, Experiment, experiment

__all__ = [
    "EXPERIMENTS",
    "IDENTIFICATION",
    "Check",
    "Experiment",
    "Flight",
    "Laboratory",
    "experiment",
    "simulate",
]
