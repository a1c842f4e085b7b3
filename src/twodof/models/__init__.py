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
    "SampledStateSpace",
    "StepFigures",
    "Structure",
    "UnknownParameter",
    "Velocity",
    "free_response",
    "linear_model",
    "longitudinal",
    "pitch_and_velocity",
    "pitch_on_cart",
    "pitch_rate",
    "rail",
    "step_figures",
    "thrust_curve",
    "velocity",
]
