"""The result of a fit: values with units and uncertainty, how well the model reproduces the data, and the checks."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.linearize import linearize
from twodof.errors import IdentificationError, finite, listed
from twodof.identify.disturbance.disturbance_model import DisturbanceModel
from twodof.identify.validate import Comparison, deviations
from twodof.models.polynomial import PolynomialModel
from twodof.models.structure import Structure

Array = NDArray[np.float64]

CONTRADICTED = 3.0
"""Standard deviations between an estimate and its prior that are not put down to chance."""

_UNTOLD = 0.9
"""Share of the prior's standard deviation that is left if the data hardly show an unknown."""

_TOGETHER = 0.2
"""A sum is known this much better than its parts if the data show the parts only together."""

_FEW = 10
"""Samples beyond the unknowns below which the standard deviations are uncertain themselves."""

_ALIKE = 0.98
"""Correlation from which on two unknowns are hardly told apart."""

_SURE = 0.05
"""A quantity that is known to this share of its value needs no remark on its correlations."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Result of a fit.

    `values`, `covariance` and `robust` are in the order of `labels` (SI units, `units`); `local` are the labels that
    belong to one record (initial states, trim, bias). `covariance` supposes white residuals and is then the Cramer-Rao
    bound at the estimate; `robust` holds for coloured ones too. An unknown that its bound holds has no standard
    deviation (NaN). The covariances are those with it free, where the data tell it: a bound makes nothing surer.
    `at_rest` names unknowns that were held at 0, as dry friction holds at the start what they are the speed of.
    `sums` are sums of unknowns by name (`Structure.sums`), which `found[name]`, `sigma` and `interval` know as well.
    `noise` is each output's residual standard deviation, `disturbance` the noise model under which all this holds.
    Under one that is not white, `covariance` and all tests are those of its prediction errors. `identification` and
    `validation` compare model and data, one entry an output of a record. `prior` has mean and standard deviation of
    the estimated unknowns before the fit. It is part of the estimate and of its doubt. `gaps` says
    where inputs lost so many samples in a row that it is not known what was applied (`Record.gaps`). `offsets` names
    inputs and outputs far from 0 that the model does not account for, `suggestions` what else would explain the data.
    `model` is what was fitted.
    """

    structure: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    local: frozenset[str]
    values: Array
    covariance: Array
    robust: Array
    noise: dict[str, float]
    fixed: dict[str, float]
    at_bound: tuple[str, ...]
    condition_number: float
    identification: tuple[Comparison, ...]
    validation: tuple[Comparison, ...]
    iterations: int
    converged: bool
    domain: str
    sums: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    disturbance: DisturbanceModel = field(default_factory=DisturbanceModel)
    at_rest: tuple[str, ...] = ()
    prior: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    gaps: tuple[str, ...] = ()
    offsets: tuple[str, ...] = ()
    suggestions: tuple[str, ...] = ()
    model: Structure | PolynomialModel | None = None

    def __getitem__(self, label: str) -> float:
        """Return the value of an unknown, or of a sum of unknowns. Raises IdentificationError for an unknown name."""
        held = sum(self.fixed[part] for part in self.sums.get(label, ()) if part not in self.labels)
        return float(self.values[self._places(label)].sum()) + held

    def __repr__(self) -> str:
        def value(of: str) -> str:
            if of in self.at_bound:
                return f"{of} {self[of]:.4g} (at its bound)"
            return f"{of} {self[of]:.4g} +- {self.sigma(of):.2g} {self.unit(of)}".rstrip()

        fits = listed(f"{one.fit_percent:.1f} %" for one in self.identification)
        return (
            f"<Estimate {self.structure}: {listed(map(value, (*self.labels, *self.summed)))}; +- 1 sigma; FIT {fits}>"
        )

    def linear(self, dt: float) -> LinearModel:
        """Return the fitted model of steps `dt` [s] as matrices, at rest, such as for `to_control` and `margins`.

        Of unknowns of several records the first count. Raises DiagramError for a structure that cannot be linearised
        at rest, IdentificationError for an estimate without its model and for a polynomial model at other steps.
        """
        model, found = self.model, {name: float(self.values[i]) for name, i in self.places("").items()}
        if isinstance(model, PolynomialModel):
            period = self.disturbance.dt
            if abs(dt - period) > 1e-3 * period:  # clocks differ by less
                what = f"a model of steps of {period:g} s is asked for at steps of {dt:g} s"
                raise model.error(what, f"ask for linear({period:g}), or fit a record.resample({dt:g})")
            a, b, c, d = model.polynomials(self.values).matrices()
            states = tuple(f"x{i + 1}" for i in range(len(a)))
            return LinearModel(a, b, c, d, dt, states, model.inputs, model.outputs, name=model.kind)
        if model is None:
            raise IdentificationError("the estimate does not know its model", "Estimate", "give the result of `fit`")
        still = {name: 0.0 for name in found if name in self.local}
        at = {name: one for name, one in {**self.fixed, **found, **still}.items() if name in model.unknowns}
        return linearize(model.diagram, dt / model.substeps, at=at)

    def places(self, record: str) -> dict[str, int]:
        """Return the place of each parameter among the labels: "mu[doublet.mat]" is mu of that record."""
        found: dict[str, int] = {}
        for i, label in enumerate(self.labels):
            name, _, of = label.partition("[")
            if name not in found or of.rstrip("]") == record:
                found[name] = i
        return found

    @property
    def white(self) -> bool:
        """Return True if the residuals of every identification record passed the whiteness test."""
        return all(c.whiteness is None or c.whiteness.passed for c in self.identification)

    @property
    def wanders(self) -> bool:
        """Return True if the residual of a record wanders (`Comparison.wanders`): all sigma are then too small."""
        return any(c.wanders for c in self.identification)

    @property
    def quoted(self) -> Array:
        """The covariance to quote: `covariance` if the residuals are white, else `robust`."""
        return self.covariance if self.white else self.robust

    def sigma(self, label: str) -> float:
        """Return the standard deviation to quote (see `quoted`)."""
        return self._deviation(self.quoted, label)

    def cramer_rao(self, label: str) -> float:
        """Return the Cramer-Rao bound on the standard deviation at the estimate, for white noise of the size found."""
        return self._deviation(self.covariance, label)

    def interval(self, label: str, level: float = 0.95) -> tuple[float, float]:
        """Return the confidence interval at `level` (normal distribution, standard deviation as quoted).

        Raises IdentificationError for an unknown name and for a level that is not between 0 and 1.
        """
        half = deviations(level) * self.sigma(label)
        return self[label] - half, self[label] + half

    @property
    def summed(self) -> tuple[str, ...]:
        """Return the sums with at least one part that was estimated for all records."""
        return tuple(name for name, parts in self.sums.items() if any(part in self.labels for part in parts))

    def unit(self, label: str) -> str:
        """Return the unit of an unknown, or of a sum of unknowns. Raises IdentificationError for an unknown name."""
        return self.units[self._places(label)[0]]

    @property
    def correlation(self) -> Array:
        """Correlation matrix of the estimates, from the quoted covariance."""
        deviation = np.array([self.sigma(label) for label in self.labels])
        return np.asarray(self.quoted / np.outer(deviation, deviation))

    @property
    def held(self) -> dict[str, float]:
        """The unknowns that had a given value other than 0 in this fit."""
        return {name: value for name, value in self.fixed.items() if value != 0.0}

    @property
    def supposed(self) -> tuple[str, ...]:
        """Return the priors and the held values, a line each."""
        lines = []
        if self.prior:
            known = (f"{name} {mean:.5g} +- {width:.2g}" for name, (mean, width) in self.prior.items())
            lines.append(f"prior: {', '.join(known)}")
        if self.held:
            lines.append(f"held: {', '.join(f'{name} {value:.5g}' for name, value in self.held.items())}")
        return tuple(lines)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return what a reader should know before using the figures, one sentence each with what to do about it."""
        return (*_on_search(self), *_on_priors(self), *_on_unknowns(self), *_on_residuals(self))

    def table(self) -> str:
        """Return values, standard deviations (white, robust), fits and remarks as text for a terminal."""
        width = max(12, *(len(label) for label in self.labels)) + 1
        lines = [f"{self.structure} ({self.domain}), condition number {self.condition_number:.3g}"]
        lines.append(f"{'':{width}}{'estimate':>12}{'1 sigma':>11}{'robust':>11}  unit")
        for label in (*self.labels, *self.summed):
            white, robust = self._deviation(self.covariance, label), self._deviation(self.robust, label)
            # For residuals that wander, only a lower limit is known.
            least = "-" if math.isnan(robust) else f"{'> ' if self.wanders else ''}{robust:.2g}"
            sigma = "at bound" if label in self.at_bound else "-" if math.isnan(white) else f"{white:.2g}"
            unit = self.unit(label) or "-"
            if label not in self.labels:
                unit += f" ({' + '.join(self.sums[label])})"
            lines.append(f"{label:{width}}{self[label]:12.5g}{sigma:>11}{least:>11}  {unit}")
        if self.disturbance.kind != "white":
            lines.append(f"disturbance: {self.disturbance.text}")
        lines.extend(self.supposed)
        for title, comparisons in (("identification", self.identification), ("validation", self.validation)):
            lines.extend(f"{title}: {self._compared(c)}" for c in comparisons)
        lines.extend(f"note: {remark}" for remark in self.remarks)
        return "\n".join(lines)

    def _compared(self, one: Comparison) -> str:
        """Say how well the model reproduces an output; in closed loop how well it predicts it, which is what counts."""
        place = f"{one.output} in '{one.record}'"
        if self.disturbance.kind == "innovation":
            return f"{place}: FIT {one.fit_percent:.2f} % one sample ahead, VAF {one.vaf:.2f} %, RMSE {one.rmse:.3g}"
        if one.ahead is not None and self.disturbance.predicts:
            return (
                f"{place}: FIT {one.ahead:.2f} % one sample ahead; {one.fit_percent:.2f} % without the gusts, "
                "which says little in closed loop"
            )
        if one.ahead is not None and isinstance(self.model, PolynomialModel):
            return (
                f"{place}: FIT {one.fit_percent:.2f} % simulated, {one.ahead:.2f} % one sample ahead, "
                f"VAF {one.vaf:.2f} %, RMSE {one.rmse:.3g}"
            )
        if self.disturbance.predicts and self.disturbance.kind != "white":
            # Of a flight that was not fitted the noise model has not been asked.
            return f"{place}: FIT {one.fit_percent:.2f} % without the gusts, which says little in closed loop"
        return f"{place}: FIT {one.fit_percent:.2f} %, VAF {one.vaf:.2f} %, RMSE {one.rmse:.3g}"

    def to_json(self) -> str:
        """Return everything but the signals as JSON text; NaN is null."""
        document = {
            **{name: getattr(self, name) for name in ("structure", "domain")},
            "estimates": {
                label: {
                    "value": self.values[i],
                    "unit": self.units[i],
                    "sigma": self._deviation(self.covariance, label),
                    "sigma_robust": self._deviation(self.robust, label),
                    "sigma_quoted": self.sigma(label),
                }
                for i, label in enumerate(self.labels)
            },
            "sums": {
                name: {"value": self[name], "sigma": self.sigma(name), "parts": self.sums[name]} for name in self.summed
            },
            **{name: getattr(self, name) for name in ("fixed", "prior", "noise")},
            "disturbance": self.disturbance.to_json(),
            **{name: getattr(self, name) for name in ("condition_number", "correlation")},
            "identification": [c.to_json() for c in self.identification],
            "validation": [c.to_json() for c in self.validation],
            **{name: getattr(self, name) for name in ("converged", "iterations", "remarks")},
        }
        return json.dumps(finite(document), indent=2)

    def _places(self, label: str) -> list[int]:
        """Return the place of an unknown among the estimates, or those of the parts of a sum that were estimated."""
        parts = (label,) if label in self.labels else self.sums.get(label, ())
        found = [self.labels.index(part) for part in parts if part in self.labels]
        if not found:
            remedy = f"estimated were: {', '.join(self.labels)}"
            raise IdentificationError(f"'{label}' was not estimated", f"structure '{self.structure}'", remedy)
        return found

    def _deviation(self, covariance: Array, label: str) -> float:
        """Return the root of the variance of an unknown or a sum; NaN for an unknown that its bound holds."""
        places = self._places(label)
        if len(places) == 1:
            return math.nan if label in self.at_bound else math.sqrt(float(covariance[places[0], places[0]]))
        # Where not even the covariance with it free is known, that of the other parts is left.
        own = [i for i in places if math.isfinite(covariance[i, i])]
        return math.sqrt(float(covariance[np.ix_(own, own)].sum())) if own else math.nan


def _on_search(found: Estimate) -> Iterator[str]:
    """Yield remarks on the end of the search and on what was held."""
    if not found.converged:
        yield "the search did not converge: give better first guesses or fix unknowns"
    yield from found.offsets
    yield from found.suggestions
    for gap in found.gaps:
        yield f"{gap}: fit the pieces between (Record.pieces)"
    for label in found.at_bound:
        whole = next((name for name, parts in found.sums.items() if label in parts), "")
        remedy = f"read {whole}, the sum that the data tell" if whole else "widen the bound or fix it"
        yield f"{label} is held by its bound: {remedy}"
    for name in found.at_rest:
        yield f"{name} is held at 0: dry friction holds the drone at the start, where no speed can be told"
    samples = sum(one.measured.size for one in found.identification)
    unknowns = len(found.labels) + len(found.disturbance.gains)
    if 0 < samples - unknowns < _FEW:
        yield (
            f"{samples} samples for {unknowns} unknowns are few: the standard deviations are themselves known to "
            f"{100.0 / math.sqrt(2.0 * (samples - unknowns)):.0f} % only. Take a longer record"
        )
    if "xi" in found.labels and found["xi"] < 0.0:
        sure = "xi" not in found.prior and found["xi"] < -found.sigma("xi")
        yield (
            "xi is negative, a swing that grows by itself: the record does not show the damping. "
            + ("Hold w_n and xi at those of a free response" if sure else "Take its interval, which reaches above 0")
        )


def _on_priors(found: Estimate) -> Iterator[str]:
    """Yield remarks on priors that the data contradict, then on those that they only repeat."""
    repeated = []
    for label in found.labels:
        mean, width = found.prior.get(label.partition("[")[0], (0.0, math.inf))
        known = f"{mean:.3g} +- {width:.2g}"
        if abs(found[label] - mean) > CONTRADICTED * width:
            yield (
                f"the data contradict what was known of {label}, {known}: "
                "give another `prior`, or look for what the structure leaves out"
            )
        elif found.sigma(label) > _UNTOLD * width:
            repeated.append(f"{label} is mostly its prior, {known}: the data hardly tell it")
    yield from repeated


def _on_unknowns(found: Estimate) -> Iterator[str]:
    """Yield remarks on unknowns that the data show only together, hardly, or hardly apart."""
    noise = found.disturbance
    memory = noise.dt * max((model.order for model in noise.noise.values()), default=0)
    if (
        noise.answering
        and memory
        and not noise.swing
        and "w_n" in found.labels
        and found["w_n"] * memory < 2.0 * math.pi
    ):
        yield (
            f"the noise model remembers {memory:.2g} s and a swing lasts {2.0 * math.pi / found['w_n']:.2g} s, so slow "
            "noise passes for w_n and xi: do not rely on them"
        )
    together = set[str]()
    for name in found.summed:
        parts = [part for part in found.sums[name] if part in found.labels]
        known = [found.sigma(part) for part in parts if not math.isnan(found.sigma(part))]
        if len(parts) > 1 and known and found.sigma(name) < _TOGETHER * max(known):
            together.update(found.sums[name])
            yield f"the data tell {' and '.join(found.sums[name])} only together: use {name}, or hold one of them"
    for label, value in zip(found.labels, found.values.tolist(), strict=True):
        sigma = found.sigma(label)
        if label not in {*found.local, *together, *found.prior} and sigma > abs(value):
            yield f"the data hardly tell {label}: {value:.3g} +- {sigma:.2g}"
    if isinstance(found.model, PolynomialModel):
        return  # a coefficient is not read by itself, and those of A or F are known together
    groups: list[set[str]] = []
    for i, j in np.argwhere(np.abs(np.triu(found.correlation, 1)) > _ALIKE).tolist():
        pair = {found.labels[i], found.labels[j]}
        if not pair <= together:
            touched = [group for group in groups if group & pair]
            groups = [group for group in groups if not group & pair] + [pair.union(*touched)]
    for group in groups:
        shared = group.difference(found.local)
        if shared and all(found.sigma(label) < _SURE * abs(found[label]) for label in shared):
            continue
        names = listed(label for label in found.labels if label in group)
        yield f"{names} are hardly told apart (correlations above {_ALIKE}): fix one or add an experiment"


def _on_residuals(found: Estimate) -> Iterator[str]:
    """Yield remarks on the colour of the residuals and on what they still hold of the inputs."""
    noise = found.disturbance
    taken_for_white = not found.white and noise.kind == "white"
    if not found.white:
        yield (
            "the residuals are not white, so believe the column `robust` (`sigma_quoted` in a file): "
            "the structure or the noise model leaves something out"
        )
    if taken_for_white and noise.answering:
        yield (
            f"{' and '.join(noise.answering)} {'answer' if len(noise.answering) > 1 else 'answers'} the noise, as a "
            "controller does: coloured noise that is taken for white then makes the estimates wrong, not only unsure. "
            "Fit with disturbance='ar' (--disturbance ar)"
        )
    if taken_for_white and noise.change == math.inf:
        yield (
            "coloured noise would pass for the response itself, and the simulation miss the data by far: the structure "
            "leaves out a part of the response, and output error is kept"
        )
    elif taken_for_white and noise.change > 0.0:
        yield (
            f"coloured noise would change an estimate by {noise.change:.0f} standard deviations, which in open loop it "
            "must not: the structure leaves out a part of the response, and output error is kept"
        )
    for one in found.identification:
        if one.wanders:
            yield (
                f"the residual of {one.output} in '{one.record}' wanders, so the standard deviations are too small by "
                "an unknown factor: something pushes the machine itself, as a gust does, or the structure is wrong. "
                "Repeat the experiment and believe the spread of the estimates, or fit a linear structure with the "
                "actuators' lag, which lets the push be a part of the model"
            )
    for one in found.identification:
        for name, test in one.inputs.items():
            # A controller's output answers the residual at once, which is not the structure's lack.
            if not test.later(int(name in noise.answering)).passed:
                yield (
                    f"the residual of {one.output} in '{one.record}' still depends on {name}: "
                    "the structure leaves out a part of the response"
                )
