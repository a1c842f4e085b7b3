"""Design: from a model to a controller, and what may change before the loop becomes unstable."""

from twodof.design.cascade import CascadeDesign, cascade_design, cascade_hinf
from twodof.design.closed_loop_poles import Motion, closed_loop_poles, root_locus
from twodof.design.designed_controller import SaturatedStep, saturated_step
from twodof.design.loop_transfer import LoopTransfer
from twodof.design.margins import DiskMargin, GainCrossing, LoopMargins, PhaseCrossing, margins
from twodof.design.own_loop import own_loop, read_rational, step_response
from twodof.design.pid import PidGains, pid_at, shaped_pid
from twodof.design.pitch_family import PitchFamily
from twodof.design.promise import Promise, promise
from twodof.design.robustness import Robustness, robustness
from twodof.design.sampled_controller import SampledController
from twodof.design.specification import Specification, check, read_specification
from twodof.design.state_feedback import lqg_attitude, lqi
from twodof.design.structured_hinf import structured_hinf
from twodof.design.tuning_preview import TuningPreview, tuning_preview

__all__ = [
    "CascadeDesign",
    "DiskMargin",
    "GainCrossing",
    "LoopMargins",
    "LoopTransfer",
    "Motion",
    "PhaseCrossing",
    "PidGains",
    "PitchFamily",
    "Promise",
    "Robustness",
    "SampledController",
    "SaturatedStep",
    "Specification",
    "TuningPreview",
    "cascade_design",
    "cascade_hinf",
    "check",
    "closed_loop_poles",
    "lqg_attitude",
    "lqi",
    "margins",
    "own_loop",
    "pid_at",
    "promise",
    "read_rational",
    "read_specification",
    "robustness",
    "root_locus",
    "saturated_step",
    "shaped_pid",
    "step_response",
    "structured_hinf",
    "tuning_preview",
]
