"""DesignedController: from an identified family to a diagram that flies, with its robustness and its promise."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.diagram import Diagram
from twodof.blocks.reference.interpreter import Reference
from twodof.design.cascade import SEPARATION, CascadeDesign, cascade_design, cascade_hinf
from twodof.design.pitch_family import PitchFamily
from twodof.design.pitch_loop import AHEAD, PitchLoop, Q
from twodof.design.promise import DURATION, GOAL, MEMBERS, Promise, promise
from twodof.design.robustness import Robustness, robustness
from twodof.design.sampled_controller import SampledController
from twodof.design.specification import Requirement, Specification, check
from twodof.design.state_feedback import lqg_attitude
from twodof.design.tuning_preview import SETTLED
from twodof.errors import ParameterError, finite, is_number, shown
from twodof.flight.starters.attitude import pid_attitude
from twodof.models.lti import step_figures
from twodof.models.plant import PitchRate
from twodof.signals import HOVER, PERIOD

Array = NDArray[np.float64]

WOUND_UP = 0.02
"""Share of the step: so much more overshoot by the motors' limits counts as windup of the integral."""


@dataclass(frozen=True)
class SaturatedStep:
    """A step of theta by `goal` [rad]: for `saturated` seconds the motors give less moment than M asks for.

    `overshoot` (a share) and `settling_time` [s] into 5 % are with the motors' limits, the `linear_` ones without. A
    time that is not reached is infinite. `largest` [rad] is the step from which on M reaches the limit.
    """

    goal: float
    saturated: float
    overshoot: float
    settling_time: float
    linear_overshoot: float
    linear_settling_time: float
    largest: float

    @property
    def winds_up(self) -> bool:
        """Return True if the limits add overshoot: the integral has grown while the motors were saturated."""
        return self.saturated > 0.0 and self.overshoot > self.linear_overshoot + WOUND_UP

    @property
    def text(self) -> str:
        """The result as a sentence."""
        step = f"a step of {math.degrees(self.goal):.3g} deg"
        if self.saturated == 0.0:
            return (
                f"{step} keeps the motors within their limits; from {math.degrees(self.largest):.3g} deg on it does not"
            )
        more = f"overshoot {100.0 * self.overshoot:.1f} %, {100.0 * self.linear_overshoot:.1f} % without the limits"
        progress = f"{step} saturates the motors for {1e3 * self.saturated:.0f} ms: {more}"
        return f"{progress}: the integral winds up" if self.winds_up else progress

    def to_json(self) -> dict[str, Any]:
        """Return plain data; an infinite time is null."""
        return {**finite(vars(self)), "winds_up": self.winds_up}


def acting_moment(moment: float, thrust: float = HOVER) -> float:
    """Return the part of M that acts at `thrust`: each of the two pairs of motors is limited to 0 to 1."""
    return 0.5 * (min(max(thrust + moment, 0.0), 1.0) - min(max(thrust - moment, 0.0), 1.0))


def saturated_step(
    diagram: Diagram,
    family: PitchFamily,
    goal: float = GOAL,
    duration: float = DURATION,
    progress: Callable[[float], None] = lambda share: None,
) -> SaturatedStep:
    """Simulate a step of theta by `goal` [rad] from rest on the estimate of `family`, without gust and noise.

    `diagram` fits the template attitude_control. The reference interpreter runs it with all its limits; in hover the
    motors limit M as `acting_moment` says. Raises DiagramError for another diagram, ParameterError for a step that is
    not .001 to 1.5 rad and a duration that is not .1 to 20 s.
    """
    if not (is_number(goal, 1e-3, 1.5) and is_number(duration, 0.1, 20.0)):
        what = f"a step of {shown(goal)} rad for {shown(duration)} s is out of range"
        raise ParameterError(what, "saturated_step", "give .001 to 1.5 rad, and .1 to 20 s")
    controller = SampledController.of(diagram)
    loop = PitchLoop(family.nominal(), controller)
    steps = round(duration / PERIOD) + 1
    linear, _, moments = loop.simulate(np.full(steps, goal))
    theta, clipped = _flown(diagram, loop, goal, steps, progress)
    time = np.arange(steps) * PERIOD
    figures = [step_figures(time, y, 0.0, goal, SETTLED) for y in (theta, linear[:, 0])]
    settled = [math.inf if math.isnan(one.settling_time) else float(one.settling_time) for one in figures]
    peak = float(np.abs(moments).max())
    return SaturatedStep(
        goal,
        clipped * PERIOD,
        figures[0].overshoot,
        settled[0],
        figures[1].overshoot,
        settled[1],
        goal * HOVER / peak if peak > 0.0 else math.inf,
    )


def _flown(
    diagram: Diagram, loop: PitchLoop, goal: float, steps: int, progress: Callable[[float], None]
) -> tuple[Array, int]:
    """Return theta (steps,) under the diagram itself, and the number of samples with a moment beyond the motors."""
    a, b = (part[0] for part in loop.plant)
    machine = Reference(diagram, PERIOD).machine()
    x, theta, clipped = np.zeros(len(a)), np.empty(steps), 0
    given = {"theta_0": goal, "q_0": 0.0, "FLAG_RESET_INT": False, "FLAG_ATTITUDE_ENABLED": True}
    for k in range(steps):
        if k % 50 == 0:
            progress(k / steps)
        theta[k] = x[0] + AHEAD * x[Q]
        moment = float(machine.step({**given, "theta": float(x[-1]), "q": float(x[Q])})["M"])
        acting = acting_moment(moment)
        # The diagram's own limit is the motors' one where it stands at it.
        clipped += abs(moment) > HOVER - 1e-9
        x = a @ x + b * acting
    return theta, clipped


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
