"""Remarks on an estimate: one row a remark, with the condition under which it is made and its sentence.

A remark says what a reader should know before using the figures, and what to do about it.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from twodof.identify.estimate import Estimate

_CONTRADICTED = 3.0
"""Standard deviations between an estimate and its prior that are not put down to chance."""

_UNTOLD = 0.9
"""Share of the prior's standard deviation that is left if the data hardly tell an unknown."""

_TOGETHER = 0.2
"""A sum is known this much better than its parts if the data tell the parts only together."""

_ALIKE = 0.98
"""Correlation from which on two unknowns are hardly told apart."""


@dataclass(frozen=True)
class Remark:
    """A row: `when` yields the words to fill into `sentence`, once for each time that the remark is made."""

    sentence: str
    when: Callable[["Estimate"], Iterator[dict[str, object]]]


def remarks(found: "Estimate") -> tuple[str, ...]:
    """Return the sentences of all rows whose condition holds, in the order of the table."""
    return tuple(row.sentence.format(**words) for row in REMARKS for words in row.when(found))


def only_together(found: "Estimate") -> list[str]:
    """Return the sums of estimates that are known five times better than their worst known part."""
    names = []
    for name in found.summed:
        parts = [part for part in found.sums[name] if part in found.labels]
        known = [found.sigma(part) for part in parts if not math.isnan(found.sigma(part))]
        if len(parts) > 1 and known and found.sigma(name) < _TOGETHER * max(known):
            names.append(name)
    return names


def _parts_of_sums(found: "Estimate") -> set[str]:
    return {part for name in only_together(found) for part in found.sums[name]}


def _not_converged(found: "Estimate") -> Iterator[dict[str, object]]:
    if not found.converged:
        yield {}


def _gap(found: "Estimate") -> Iterator[dict[str, object]]:
    for gap in found.gaps:
        yield {"gap": gap}


def _at_bound(found: "Estimate") -> Iterator[dict[str, object]]:
    for label in found.at_bound:
        yield {"label": label}


def _at_rest(found: "Estimate") -> Iterator[dict[str, object]]:
    for name in found.at_rest:
        yield {"name": name}


def _negative_damping(found: "Estimate") -> Iterator[dict[str, object]]:
    if "xi" in found.labels and "xi" not in found.prior and found["xi"] < -found.sigma("xi"):
        yield {}


def _priors(found: "Estimate") -> Iterator[tuple[str, dict[str, object]]]:
    for label in found.labels:
        mean, width = found.prior.get(label.partition("[")[0], (0.0, math.inf))
        words = {"label": label, "mean": mean, "width": width}
        if abs(found[label] - mean) > _CONTRADICTED * width:
            yield "contradicted", words
        elif found.sigma(label) > _UNTOLD * width:
            yield "repeated", words


def _prior_contradicted(found: "Estimate") -> Iterator[dict[str, object]]:
    return (words for kind, words in _priors(found) if kind == "contradicted")


def _prior_repeated(found: "Estimate") -> Iterator[dict[str, object]]:
    return (words for kind, words in _priors(found) if kind == "repeated")


def _sum_only(found: "Estimate") -> Iterator[dict[str, object]]:
    for name in only_together(found):
        yield {"parts": " and ".join(found.sums[name]), "name": name}


def _hardly_told(found: "Estimate") -> Iterator[dict[str, object]]:
    explained = {*found.local, *_parts_of_sums(found), *found.prior}
    for label, value in zip(found.labels, found.values.tolist(), strict=True):
        if label not in explained and found.sigma(label) > abs(value):
            yield {"label": label, "value": value, "sigma": found.sigma(label)}


def _alike(found: "Estimate") -> Iterator[dict[str, object]]:
    correlation, together = found.correlation, _parts_of_sums(found)
    for i, label in enumerate(found.labels):
        for j, other in enumerate(found.labels[:i]):
            if abs(correlation[i, j]) > _ALIKE and not {label, other} <= together:
                yield {"one": other, "other": label, "correlation": float(correlation[i, j])}


def _coloured(found: "Estimate") -> Iterator[dict[str, object]]:
    if not found.white:
        yield {}


def _feedback(found: "Estimate") -> Iterator[dict[str, object]]:
    names = found.disturbance.answering
    if not found.white and found.disturbance.kind == "white" and names:
        yield {"names": " and ".join(names), "answer": "answer" if len(names) > 1 else "answers"}


def _noise_model_refused(found: "Estimate") -> Iterator[dict[str, object]]:
    if not found.white and found.disturbance.kind == "white" and found.disturbance.change > 0.0:
        yield {"change": found.disturbance.change}


def _wanders(found: "Estimate") -> Iterator[dict[str, object]]:
    for one in found.identification:
        if one.wanders:
            yield {"output": one.output, "record": one.record}


def _unexplained_response(found: "Estimate") -> Iterator[dict[str, object]]:
    for one in found.identification:
        for name, test in one.inputs.items():
            if not test.causal.passed:
                yield {"output": one.output, "record": one.record, "input": name}


REMARKS = (
    Remark("the search did not converge: give better first guesses or fix unknowns", _not_converged),
    Remark("{gap}: fit the pieces between (Record.pieces)", _gap),
    Remark("{label} is held by its bound: widen the bound or fix it", _at_bound),
    Remark("{name} is held at 0: dry friction holds the drone at the start, where no speed can be told", _at_rest),
    Remark(
        "xi is negative, a swing that grows by itself: the record does not show the damping. "
        "Hold w_n and xi at those of a free response",
        _negative_damping,
    ),
    Remark(
        "the data contradict what was known of {label}, {mean:.3g} +- {width:.2g}: "
        "give another `prior`, or look for what the structure leaves out",
        _prior_contradicted,
    ),
    Remark(
        "{label} is mostly what was known before, {mean:.3g} +- {width:.2g}: the data hardly tell it",
        _prior_repeated,
    ),
    Remark("the data tell {parts} only together: use {name}, or hold one of them", _sum_only),
    Remark("the data hardly tell {label}: {value:.3g} +- {sigma:.2g}", _hardly_told),
    Remark(
        "{one} and {other} are hardly told apart (correlation {correlation:.3f}): fix one or add an experiment",
        _alike,
    ),
    Remark(
        "the residuals are not white, so the robust standard deviations are quoted: "
        "the structure or the noise model leaves something out",
        _coloured,
    ),
    Remark(
        "{names} {answer} the noise, as a controller does: coloured noise that is taken for white then makes the "
        "estimates wrong, not only unsure. Fit with disturbance='ar' (--disturbance ar)",
        _feedback,
    ),
    Remark(
        "coloured noise would change an estimate by {change:.0f} standard deviations, which in open loop it must not: "
        "the structure leaves out a part of the response, and output error is kept",
        _noise_model_refused,
    ),
    Remark(
        "the residual of {output} in '{record}' wanders, so the standard deviations are too small by an unknown "
        "factor: something pushes the machine itself, as a gust does, or the structure is wrong. Repeat the experiment "
        "and believe the spread of the estimates, or fit a linear structure with the actuators' lag, which lets the "
        "push be a part of the model",
        _wanders,
    ),
    Remark(
        "the residual of {output} in '{record}' still depends on {input}: the structure leaves out a part of the "
        "response",
        _unexplained_response,
    ),
)
"""All remarks, in the order in which a reader needs them."""
