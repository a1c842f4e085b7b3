"""Plant models: linear ones in closed form, and structures (diagrams with unknown parameters) for identification."""

from twodof.models.lti import DelayedStateSpace, SampledStateSpace, StepFigures, step_figures
from twodof.models.plant import (
    PAPER_PITCH_RATE,
    PAPER_VELOCITY_GREYBOX,
    PAPER_VELOCITY_SIMPLE,
    Longitudinal,
    PitchRate,
    Velocity,
    thrust_curve,
)
from twodof.models.polynomial import PolynomialModel, armax, arx, bj, oe
from twodof.models.process import process
from twodof.models.structure import Structure, UnknownParameter, linear_model
from twodof.models.structures import (
    free_response,
    longitudinal,
    pitch_and_velocity,
    pitch_on_cart,
    pitch_rate,
    rail,
    velocity,
)

__all__ = [
    "PAPER_PITCH_RATE",
    "PAPER_VELOCITY_GREYBOX",
    "PAPER_VELOCITY_SIMPLE",
    "DelayedStateSpace",
    "Longitudinal",
    "PitchRate",
    "PolynomialModel",
    "SampledStateSpace",
    "StepFigures",
    "Structure",
    "UnknownParameter",
    "Velocity",
    "armax",
    "arx",
    "bj",
    "free_response",
    "linear_model",
    "longitudinal",
    "model_named",
    "oe",
    "pitch_and_velocity",
    "pitch_on_cart",
    "pitch_rate",
    "process",
    "rail",
    "step_figures",
    "thrust_curve",
    "velocity",
]
