"""Design: from a model to a controller, and what may change before the loop becomes unstable."""

from twodof.design.certified.certificate import Certificate, RegionStability, certificate
from twodof.design.certified.stability_radius import StabilityRadius, stability_radius
from twodof.design.closed_loop_poles import Motion, closed_loop_poles
from twodof.design.disk_margin import DiskMargin
from twodof.design.loop_transfer import LoopTransfer
from twodof.design.margins import GainCrossing, LoopMargins, PhaseCrossing, margins
from twodof.design.root_locus import root_locus
from twodof.design.synthesis.cascade import CascadeDesign, cascade_design
from twodof.design.synthesis.cascade_hinf import cascade_hinf
from twodof.design.synthesis.pid import PidGains, pid, shaped_pid
from twodof.design.synthesis.requirements import check
from twodof.design.synthesis.specification import Specification, read_specification
from twodof.design.synthesis.state_feedback import lqg_attitude, lqi, placed_attitude, pole_placement
from twodof.design.synthesis.structured_hinf import structured_hinf
from twodof.design.uncertain.pitch_family import PitchFamily
from twodof.design.uncertain.promise import Promise, promise
from twodof.design.uncertain.robustness import Robustness, robustness
from twodof.design.uncertain.sampled_controller import SampledController
from twodof.design.uncertain.saturated_step import SaturatedStep, saturated_step
from twodof.design.uncertain.tuning_preview import TuningPreview, controller_preview, tuning_preview

__all__ = [
    "CascadeDesign",
    "Certificate",
    "DiskMargin",
    "GainCrossing",
    "LoopMargins",
    "LoopTransfer",
    "Motion",
    "PhaseCrossing",
    "PidGains",
    "PitchFamily",
    "Promise",
    "RegionStability",
    "Robustness",
    "SampledController",
    "SaturatedStep",
    "Specification",
    "StabilityRadius",
    "TuningPreview",
    "cascade_design",
    "cascade_hinf",
    "certificate",
    "check",
    "closed_loop_poles",
    "controller_preview",
    "lqg_attitude",
    "lqi",
    "margins",
    "pid",
    "placed_attitude",
    "pole_placement",
    "promise",
    "read_specification",
    "robustness",
    "root_locus",
    "saturated_step",
    "shaped_pid",
    "stability_radius",
    "structured_hinf",
    "tuning_preview",
]
