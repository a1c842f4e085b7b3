"""Whether the data of a flight are good enough for what it was flown for."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.experiment.experiments import SETPOINT, Experiment
from twodof.experiment.script import Script
from twodof.signals import PERIOD

Signals = Mapping[str, NDArray[Any]]
"""Each signal at the control steps of a flight, (steps,), by name; NaN where a sample was lost."""

STOP_MARGIN = 1e-3
"""A flight that came nearer than this to a stop [m, rad] touched it: the rig is pressed into a stop by less."""

MOST_LOST = 0.01
"""Share of samples that may be lost: the real drone's public logs lack up to .2 % of them, and identify well."""

LONGEST_GAP = 0.04
"""Longest gap of samples [s] from the excitation's start on: two periods of the course's 50 Hz messages."""

_EXCITED = {"M_open": "q", "q0": "q", "theta0": "theta", "v0": "v", "x0": "x"}


_SPEED = {"theta": "q", "x": "v"}


@dataclass(frozen=True)
class FlightCheck:
    """Whether a flight is good for its purpose in one respect, and what was seen."""

    name: str
    passed: bool
    seen: str


def data_checks(experiment: Experiment, plan: Script, out: Signals, stops: Mapping[str, float]) -> list[FlightCheck]:
    """No stop was touched, and the response stands out of what the signal did before (five standard deviations).

    `stops` are `pitch_stop` [rad] and `rail_stop` [m]. Pitch and place are the true ones in the steps in which `out`
    has them, and `seen` says so. The response is looked for in the estimates, since models are identified from them.
    """
    flown = slice(plan.begin, plan.end)
    steepest, by = _farthest(out, "theta", flown)
    checks = [
        FlightCheck(
            "pitch free", steepest < stops["pitch_stop"] - STOP_MARGIN, f"{np.degrees(steepest):.1f} deg, {by}"
        ),
        _excited(experiment, plan, out),
    ]
    if not experiment.rings:
        farthest, by = _farthest(out, "x", flown)
        checks.append(FlightCheck("rail free", farthest < stops["rail_stop"] - STOP_MARGIN, f"{farthest:.3f} m, {by}"))
    return checks


def _farthest(out: Signals, name: str, flown: slice) -> tuple[float, str]:
    """The largest magnitude that a signal reached, of the true one where it is known, and which of the two it is.

    Each sample is followed to the next one at its own speed. What strikes a stop between two samples is on its way back
    when the next one is taken. A fast swing would else bounce unseen, up to .01 rad from the stop.
    """
    estimate, true = _reached(out, name, "", flown), out.get(f"true_{name}")
    if true is None:
        return _largest(estimate), "estimated"
    known = np.isfinite(true[flown])
    unknown = int((~known).sum())
    by = f"true but for {unknown} of {len(known)} steps, estimated" if unknown else "true"
    return _largest(np.where(known, _reached(out, name, "true_", flown), estimate)), by


def _reached(out: Signals, name: str, source: str, flown: slice) -> NDArray[Any]:
    """The farther of each sample and where its speed takes it by the next one."""
    place, speed = out[f"{source}{name}"][flown], out[f"{source}{_SPEED[name]}"][flown]
    return np.where(np.isfinite(speed), np.maximum(np.abs(place), np.abs(place + PERIOD * speed)), np.abs(place))


def _largest(values: NDArray[Any]) -> float:
    """The largest magnitude; NaN where nothing was received, which passes no check."""
    known = values[np.isfinite(values)]
    return float(np.abs(known).max()) if known.size else float("nan")


def _excited(experiment: Experiment, plan: Script, out: Signals) -> FlightCheck:
    name = _EXCITED[SETPOINT[experiment.mode]]
    before = out[name][max(0, plan.begin - 250) : plan.begin]
    before = before[np.isfinite(before)]
    if not before.size:
        return FlightCheck("excited", False, f"no sample of {name} before the excitation")
    largest = _largest(out[name][plan.begin : plan.end] - before.mean())
    return FlightCheck(
        "excited", largest > 5.0 * float(before.std()), f"{name} moves by {largest:.3g}, {before.std():.2g} before"
    )


def commanded(out: Signals) -> FlightCheck:
    """Whether the controllers always gave numbers."""
    lost = {name: np.flatnonzero(~np.isfinite(out[name])) for name in ("M", "T")}
    first = {name: steps[0] * PERIOD for name, steps in lost.items() if steps.size}
    if not first:
        return FlightCheck("commands are numbers", True, "M and T are")
    name = min(first, key=lambda name: first[name])
    return FlightCheck(
        "commands are numbers",
        False,
        f"{name} is not finite from {first[name]:.3f} s on, in {lost[name].size} steps, where the motors were stopped",
    )


def not_judged(reason: str) -> FlightCheck:
    """What stands for the checks of the data of a flight that was broken off."""
    return FlightCheck("data", False, f"not judged: {reason}")


def received(plan: Script, have: NDArray[np.bool_]) -> FlightCheck:
    """Whether enough samples came over the link; `have` (n,) says of which of the control steps that were flown."""
    missing = int((~have).sum())
    flown = have[plan.begin : plan.end]
    edges = np.flatnonzero(np.concatenate(([True], flown, [True])))
    gap = float(np.diff(edges).max() - 1) * PERIOD
    good = missing <= MOST_LOST * len(have) and gap <= LONGEST_GAP
    seen = f"{missing} of {len(have)} lost" + (f", longest gap in the excitation {1e3 * gap:.0f} ms" if gap else "")
    return FlightCheck("samples received", good, seen)
