"""IdentifiedFlight: one log read by hand and by output error, with the curves for a picture of the fit."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError, LogError, finite, nearest
from twodof.flightlog.log import FlightLog
from twodof.identify import simple_pitch, simple_velocity
from twodof.identify.disturbance.disturbance_model import Disturbance
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import KINDS, cut
from twodof.identify.ready_made import (
    AUTO,
    PURPOSE,
    Sufficiency,
    by_hand,
    by_output_error,
    experiment_in,
    machine_of,
    reference_values,
    structure_for,
    sufficiency,
)
from twodof.identify.record import Record
from twodof.identify.simple_pitch import SimplePitch
from twodof.identify.simple_velocity import SimpleVelocity
from twodof.identify.validate import rmse
from twodof.models.structure import Structure
from twodof.signals import unit_of

Array = NDArray[np.float64]

MOST_POINTS = 8000
"""Of a curve in `view`: longer records are thinned out evenly, far finer than a screen shows."""


@dataclass(frozen=True, eq=False)
class IdentifiedFlight:
    """Models of one flight: the `greybox` fit, the paper's `simple` method beside it, and the `record` of both.

    `simple` is None where nothing can be read by hand, and `refusal` says why. `validation` are the records of other
    flights that the fit was checked on. `truth` has true values of a virtual rig by unknown, as far as the log allows.
    """

    experiment: str
    structure: Structure
    record: Record
    validation: tuple[Record, ...]
    greybox: Estimate
    simple: SimplePitch | SimpleVelocity | None
    refusal: str
    truth: Mapping[str, float]
    rig: str

    @property
    def sufficiency(self) -> Sufficiency:
        """Return the verdict on whether the data are informative enough for the experiment's purpose."""
        return sufficiency(self.greybox, PURPOSE.get(self.experiment, ()))

    def model(self) -> dict[str, Any]:
        """Return the model's document, as `twodof identify --out` writes it and `twodof design` reads it."""
        about = {"experiment": self.experiment, "method": "grey-box", "rig": self.rig}
        return {**about, **json.loads(self.greybox.to_json())}

    def view(self) -> dict[str, Any]:
        """Curves and figures as plain data: inputs, outputs with both models, tests of the residuals, estimates.

        Times are in seconds from the record's start. NaN and infinity are null.
        """
        found, judged = self.greybox, self.sufficiency
        start = self.record.start
        return {
            "experiment": self.experiment,
            "structure": self.structure.name,
            "log": self.record.name,
            "inputs": [
                {"name": name, "unit": unit_of(name), **_curve(self.record.time - start, value=value)}
                for name, value in self.record.inputs.items()
                if name in self.structure.inputs
            ],
            "outputs": self._outputs(),
            "tests": [test for one in found.identification for test in _tests(one.output, one)],
            "estimates": [self._row(label) for label in (*found.labels, *found.summed, *found.held)],
            "prior": {name: list(one) for name, one in found.prior.items()},
            "correlation": {"labels": list(found.labels), "rows": [_listed(row) for row in found.correlation]},
            "condition_number": found.condition_number,
            "disturbance": found.disturbance.text,
            "robust": not found.white,
            "converged": found.converged,
            "informative": {"enough": judged.enough, "trusted": judged.trusted, "text": judged.text},
            "remarks": list(found.remarks),
            "simple": None if self.simple is None else json.loads(self.simple.to_json()),
            "simple_text": self.refusal if self.simple is None else self.simple.table(),
        }

    def _row(self, label: str) -> dict[str, Any]:
        found, held = self.greybox, label in self.greybox.fixed
        low, high = (math.nan, math.nan) if held else found.interval(label)
        # A value that the method's own checks doubt stands in its text, with the reason.
        sound = self.simple is not None and not self.simple.remarks
        by_hand = getattr(self.simple.model, label, None) if self.simple is not None and sound else None
        row: dict[str, Any] = {
            "name": label,
            "unit": self.structure.unknowns[label].unit if held else found.unit(label),
            "text": self._text(label),
            "value": found.fixed[label] if held else found[label],
            "sigma": None if held else found.sigma(label),
            "held": held,
            "low": low,
            "high": high,
            "local": label in found.local,
            "sum": label in found.summed,
            "simple": by_hand,
            "truth": self.truth.get(label),
        }
        return dict(finite(row))

    def _text(self, label: str) -> str:
        """Return an unknown's text."""
        if label in self.greybox.summed and label not in self.greybox.labels:
            return " + ".join(self.greybox.sums[label])
        known = self.structure.unknowns.get(label)
        return "" if known is None else known.text

    def _outputs(self) -> list[dict[str, Any]]:
        """Return a row for each fitted or validated output, and one for an output that only the simple method reads."""
        fitted, checked = self.greybox.identification, self.greybox.validation
        rows = []
        for one in (*fitted, *checked):
            curves = {"measured": one.measured, "greybox": one.simulated, "residual": one.residual}
            if one in fitted and self.simple is not None and one.output == self.simple.output:
                _, _, offset, simulated = self._simulated(self.simple)
                curves["simple"] = simulated + offset
            ahead = one.ahead if self.greybox.disturbance.predicts else None
            figures = {"fit_percent": one.fit_percent, "fit_percent_ahead": ahead, "rmse": one.rmse}
            figures |= {"validation": one in checked, "wanders": one.wanders}
            rows.append(_output(one.output, one.record, figures, one.time - one.time[0], curves))
        if self.simple is not None and all(one.output != self.simple.output for one in fitted):
            time, measured, offset, simulated = self._simulated(self.simple)
            curves = {"measured": measured + offset, "simple": simulated + offset, "residual": measured - simulated}
            figures = {"fit_percent": self.simple.identification[1], "fit_percent_ahead": None}
            figures |= {"rmse": rmse(measured, simulated), "validation": False, "wanders": False}
            rows.append(_output(self.simple.output, self.record.name, figures, time - self.record.start, curves))
        return rows

    def _simulated(self, simple: SimplePitch | SimpleVelocity) -> tuple[Array, Array, float, Array]:
        """Return times, the measured output less its rest, that rest, and the simple model's output."""
        if isinstance(simple, SimplePitch):
            measured, simulated = simple_pitch.simulated_pair(simple.model, self.record)
        else:
            measured, simulated = simple_velocity.simulated_pair(simple.model, self.record)
        rest = float(self.record.outputs[simple.output].value[0] - measured[0])
        return self.record.output_time(simple.output), measured, rest, simulated


def identify_flight(
    log: FlightLog,
    experiment: str | None = None,
    *,
    structure: str = AUTO,
    impulse: FlightLog | None = None,
    others: Sequence[FlightLog] = (),
    window: tuple[float, float] | None = None,
    disturbance: Disturbance = "auto",
    prior: Mapping[str, tuple[float, float]] | None = None,
) -> IdentifiedFlight:
    """Identify an experiment of `KINDS` (None: what the log holds) by output error, and by hand beside it.

    `impulse` is the log of a free response, from which the poles of a doublet come. `others` validate. `window` [s] is
    the stretch of the log, `structure` a name of `ready_made.STRUCTURES`, `prior` as in `fit`.
    Raises LogError and IdentificationError.
    """
    kind = experiment_in(log) if experiment is None else experiment
    if kind not in KINDS:
        raise IdentificationError(f"no experiment called {kind!r:.80}", "", f"there are: {nearest(kind, KINDS)}")
    if impulse is not None and kind != "doublet":
        raise IdentificationError("the impulse's log is of use to a doublet only", kind, "leave it out")
    record = cut(log, kind, window)
    checks = tuple(cut(other, kind) for other in others)
    free = None if impulse is None else cut(impulse, "impulse")
    shape = structure_for(kind, structure)
    flown = zip((log, *others), (record, *checks), strict=True)
    machines = [machine_of(one, cut_out.start, float(cut_out.time[-1])) for one, cut_out in flown]
    found, fitted = by_output_error(
        kind, shape, [record], checks, free=free, disturbance=disturbance, machines=machines, prior=prior
    )
    if not isinstance(found, Estimate):
        raise IdentificationError("one log gives one estimate", kind)
    simple, refusal = None, ""
    try:
        simple = by_hand(kind, record, checks, free)
    except (IdentificationError, LogError) as reason:
        refusal = str(reason)
    unseen = tuple(fitted[len(fitted) - len(checks) :])
    record = fitted[0] if kind == "impulse" else record  # without the pulse
    truth = reference_values(log, kind, record.start, float(record.time[-1]))
    return IdentifiedFlight(kind, shape, record, unseen, found, simple, refusal, truth, machines[0].rig)


def _output(
    name: str, record: str, figures: Mapping[str, Any], time: Array, curves: Mapping[str, Array]
) -> dict[str, Any]:
    return {"name": name, "unit": unit_of(name), "record": record, **figures, **_curve(time, **curves)}


def _tests(output: str, one: Any) -> list[dict[str, Any]]:
    tests = {"itself": one.whiteness, **one.inputs}
    return [
        {
            "output": output,
            "against": name,
            "lags": test.lags.tolist(),
            "value": _listed(test.value),
            "bound": _listed(test.bound),
            "passed": test.passed if name == "itself" else test.causal.passed,
            "outside": test.outside,
            "allowed": test.allowed,
        }
        for name, test in tests.items()
        if test is not None
    ]


def _curve(time: Array, **values: Array) -> dict[str, Any]:
    step = max(1, -(-time.size // MOST_POINTS))
    return {"time": _listed(time[::step]), **{name: _listed(value[::step]) for name, value in values.items()}}


def _listed(values: Array) -> Any:
    return finite([float(f"{value:.6g}") for value in values])
