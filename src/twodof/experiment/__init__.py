"""Experiments: protocols that excite a rig whose flight controller runs a diagram, and the resulting flights."""

from twodof.experiment.experiments import EXPERIMENTS as EXPERIMENTS
from twodof.experiment.experiments import IDENTIFICATION as IDENTIFICATION
from twodof.experiment.experiments import Experiment as Experiment
from twodof.experiment.experiments import experiment as experiment
from twodof.experiment.flight import Flight as Flight
from twodof.experiment.flight import FlightCheck as FlightCheck
from twodof.experiment.flight import Laboratory as Laboratory
from twodof.experiment.flight import simulate as simulate
from twodof.experiment.fly import fly as fly
from twodof.experiment.prediction import PredictedMotion as PredictedMotion
from twodof.experiment.prediction import predict as predict
