"""DesignedController: from an identified family to a diagram that flies, with its robustness and its promise."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from twodof.blocks.diagram import Diagram
from twodof.design.cascade import SEPARATION, CascadeDesign, cascade_design, cascade_hinf
from twodof.design.pitch_family import PitchFamily
from twodof.design.promise import MEMBERS, Promise, promise
from twodof.design.robustness import Robustness, robustness
from twodof.design.sampled_controller import SampledController
from twodof.design.saturated_step import SaturatedStep, saturated_step
from twodof.design.specification import Requirement, Specification, check
from twodof.design.state_feedback import lqg_attitude
from twodof.errors import ParameterError, shown
from twodof.flight.starters.attitude import pid_attitude
from twodof.models.plant import PitchRate

CROSSOVER = 20.0
"""Default crossover of the rate loop [rad/s]."""

METHODS = ("cascade", "lqg")
"""The cascade of the drone, or LQG: state feedback with a Kalman filter."""


@dataclass(frozen=True, eq=False)
class DesignedController:
    """A controller for `family`, as the `diagram` that flies, with the results of its checks.

    `cascade` has the gains and their figures; it is None for another method. `robustness` says whether the controller
    keeps the whole family stable, `saturation` what the motors' limits do to a step, and `promise` how the drone will
    fly. `requirements` compares the controller with the specification.
    """

    method: str
    family: PitchFamily
    diagram: Diagram
    cascade: CascadeDesign | None
    robustness: Robustness
    saturation: SaturatedStep
    promise: Promise
    requirements: tuple[Requirement, ...]

    @property
    def ready(self) -> bool:
        """Return True if all sampled drones are stable under the controller, and it meets the specification."""
        return self.robustness.robust and all(one.met for one in self.requirements)

    def to_json(self) -> dict[str, Any]:
        """Return everything but the diagram, as plain data."""
        return {
            "family": self.family.to_json(),
            "method": self.method,
            "design": None if self.cascade is None else self.cascade.to_json(),
            "robustness": self.robustness.to_json(),
            "saturation": self.saturation.to_json(),
            "promise": self.promise.to_json(),
            "specification": [one.to_json() for one in self.requirements],
        }


def design_controller(
    family: PitchFamily,
    crossover: float = CROSSOVER,
    phase_margin: float | None = None,
    separation: float = SEPARATION,
    method: str = "cascade",
    specification: Specification | None = None,
    goal: float = math.radians(10.0),
    members: int = MEMBERS,
    seed: int = 1,
    progress: Callable[[str, float], None] = lambda text, share: None,
    anti_windup: str = "none",
) -> DesignedController:
    """Design a controller for `crossover` [rad/s] and `phase_margin` [rad] of the rate loop, or for a `specification`.

    `separation` is that of `cascade_design`. `goal` [rad] is the step of the pitch that is promised; a specification
    names its own. `members` drones, drawn with `seed`, make the promise. `progress` is called with the present task and
    the share done. `anti_windup` is that of the cascade's PID (`pid_attitude`). Raise ParameterError for numbers out of
    range and gains that the drone refuses.
    """
    if method not in METHODS:
        raise ParameterError(f"unknown method {shown(method)}", "design", f"choose one of {', '.join(METHODS)}")
    if specification is not None and method != "cascade":
        remedy = "leave the specification out, or choose the method cascade"
        raise ParameterError("a specification is for the method cascade only", f"method {method}", remedy)
    if anti_windup != "none" and method != "cascade":
        remedy = "leave anti-windup out, or choose the method cascade"
        raise ParameterError("anti-windup is for the method cascade only", f"method {method}", remedy)
    v = family.values
    plant = PitchRate(v["w_n"], v["xi"], v["mu"], v["dead_time"])
    goal = goal if specification is None else specification.goal
    if specification is None:
        made = cascade_design(plant, crossover, phase_margin=phase_margin, lag=v["lag"], separation=separation)
    else:
        best = cascade_hinf(family, specification, seed=seed, progress=lambda s: progress("the best gains", 0.3 * s))
        made = CascadeDesign.of(plant, best.gains, v["lag"])
    diagram = pid_attitude(made.gains, anti_windup) if method == "cascade" else lqg_attitude(family)
    flown = SampledController.of(diagram)
    sure = robustness(flown, family, seed=seed, progress=lambda s: progress("the worst member", 0.3 + 0.1 * s))
    found = promise(
        flown,
        family,
        goal=goal,
        members=members,
        seed=seed,
        name=diagram.name,
        progress=lambda s: progress("flying the members", 0.4 + 0.5 * s),
    )
    limited = saturated_step(diagram, family, goal, progress=lambda s: progress("the motors' limits", 0.9 + 0.1 * s))
    checked = () if specification is None else check(specification, flown, family, found)
    cascade = made if method == "cascade" else None
    return DesignedController(method, family, diagram, cascade, sure, limited, found, checked)
