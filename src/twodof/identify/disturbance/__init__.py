"""Noise models of a fit: coloured noise, and gusts."""

from twodof.identify.disturbance.autoregression import Autoregression
from twodof.identify.disturbance.disturbance_model import DisturbanceModel
from twodof.identify.disturbance.gust import Gust

__all__ = ["Autoregression", "DisturbanceModel", "Gust"]
