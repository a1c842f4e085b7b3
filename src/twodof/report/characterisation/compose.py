"""From characterisations to the report: Table 1's rows, the checks, what the data could not tell, the findings."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape

from twodof.identify.estimate import Estimate
from twodof.models.plant import PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX, PAPER_VELOCITY_SIMPLE
from twodof.report.characterisation.characterise import Characterisation
from twodof.report.characterisation.errata import errata
from twodof.report.characterisation.paper_figures import figures
from twodof.report.content import Content, FitCheck, ParameterRow, ReportTable, Subject, Uncertain
from twodof.report.numbers import plain, with_sigma
from twodof.report.template_texts import say

_PAPER = (
    ParameterRow("w_n", "ω<sub>n</sub>", "natural frequency", "rad/s", PAPER_PITCH_RATE.w_n),
    ParameterRow("xi", "ξ", "damping ratio", "", PAPER_PITCH_RATE.xi),
    ParameterRow("mu", "μ", "gain, moment to angular acceleration", "rad/s²", PAPER_PITCH_RATE.mu),
    ParameterRow("tau", "τ", "delay", "ms", 1e3 * PAPER_PITCH_RATE.tau),
    ParameterRow(
        "k_v", "k<sub>v</sub>", "gain, pitch to deceleration", "m/s²",
        PAPER_VELOCITY_SIMPLE.k_v, PAPER_VELOCITY_GREYBOX.k_v,
    ),
    ParameterRow(
        "p_v", "p<sub>v</sub>", "pole of the velocity", "1/s",
        PAPER_VELOCITY_SIMPLE.p_v, PAPER_VELOCITY_GREYBOX.p_v,
    ),
)  # fmt: skip
_DRY = (
    ParameterRow("coulomb", "f<sub>c</sub>", "dry friction over inertia", "rad/s²"),
    ParameterRow("hardening", "k<sub>3</sub>", "hardening of the spring", "1/s²"),
)
# From here on two errors go together, or one is large, to a degree that a reader should know.
_CORRELATED, _ROUGH = 0.8, 0.1
_GREEK: Mapping[str, str] = {"theta": "θ"}
# A table in milliseconds reads better than one in hundredths of a second.
_SHOWN_TIMES: Mapping[str, float] = {"tau": 1e3}


@dataclass(frozen=True, eq=False)
class CharacterisedMachine:
    """One machine of the report: its name, a paragraph about it (HTML), what was found, and the truth if known (SI)."""

    name: str
    text: str
    found: Characterisation
    truth: Mapping[str, float]
    remarks: Sequence[str] = ()


def rows(machine: CharacterisedMachine) -> list[ParameterRow]:
    """Table 1 for one machine; parameters that neither method found and nobody knows are left out."""
    found, made = machine.found, []
    for row in (*_PAPER, *_DRY):
        scale = _SHOWN_TIMES.get(row.key, 1.0)
        truth = machine.truth.get(row.key)
        full = replace(
            row,
            truth=None if truth is None else scale * truth,
            simple=_scaled(found.simple.get(row.key), scale),
            greybox=_scaled(found.greybox.get(row.key), scale),
            greybox_spread=scale * found.spreads[row.key].value if row.key in found.spreads else None,
        )
        if row in _PAPER or full.greybox is not None:
            made.append(full)
    return made


def _scaled(value: Uncertain | None, scale: float) -> Uncertain | None:
    return None if value is None else Uncertain(scale * value.value, scale * value.sigma)


def subject(machine: CharacterisedMachine) -> Subject:
    """Everything the report shows of one machine."""
    return Subject(
        machine.name,
        machine.text,
        rows(machine),
        list(figures(machine.found)),
        list(_checks(machine.found)),
        [*machine.remarks, *_doubts(machine.found)],
    )


def _checks(found: Characterisation) -> list[FitCheck]:
    units = {"velocity": "m"}
    return [
        FitCheck(name, units.get(name, "rad/s"), estimate.identification[0], estimate.validation, _note(estimate))
        for name, estimate in found.fits.items()
    ]


def _note(estimate: Estimate) -> str:
    if estimate.white:
        return say("white")
    shared = [label for label in estimate.labels if label not in estimate.local]
    wider = max(estimate.sigma(label) / estimate.cramer_rao(label) for label in shared)
    return say("coloured", wider=wider)


def _doubts(found: Characterisation) -> list[str]:
    said = [escape(text) for text in found.refusals]
    if found.forced is not None:
        said.append(say("poles"))
    if found.travel is not None:
        said.append(say("friction"))
    for name, estimate in found.fits.items():
        said.extend(f"{name.capitalize()}: {text}" for text in _unsure(estimate))
    for row in _PAPER:
        claimed, spread = found.greybox.get(row.key), found.spreads.get(row.key)
        if claimed is not None and spread is not None and spread.exceeds(claimed.sigma):
            said.append(say("spread", symbol=row.symbol, times=spread.value / claimed.sigma))
    return said


def _unsure(estimate: Estimate) -> Iterator[str]:
    """The pair that is hardest to tell apart, what is known only roughly, and the fit's own remarks.

    Those on residuals are left to the section about residuals.
    """
    own = [i for i, label in enumerate(estimate.labels) if label not in estimate.local and estimate.sigma(label) > 0.0]
    pairs = [(abs(estimate.correlation[i, j]), i, j) for i in own for j in own if i < j]
    strongest, i, j = max(pairs, default=(0.0, 0, 0))
    if strongest > _CORRELATED:
        sense = "more" if estimate.correlation[i, j] > 0.0 else "less"
        one, other = (_symbol(estimate.labels[k]) for k in (i, j))
        yield say("apart", one=one, other=other, correlation=plain(estimate.correlation[i, j], 2), sense=sense)
    for k in own:
        label = estimate.labels[k]
        share = estimate.sigma(label) / abs(estimate.values[k])
        if share > _ROUGH:
            yield f"{_symbol(label)} is known to {100.0 * share:.0f} % only."
    for remark in estimate.remarks:
        if "residual" not in remark and "told apart" not in remark:
            yield f"{_in_symbols(remark, estimate.labels)}."


def _symbol(label: str) -> str:
    """An estimate's label as HTML: Table 1's symbol, else what stands behind `_` as a subscript."""
    known = {row.key: row.symbol for row in (*_PAPER, *_DRY)}
    if label in known:
        return known[label]
    stem, below, index = label.partition("_")
    return f"{escape(_GREEK.get(stem, stem))}<sub>{escape(index)}</sub>" if below else escape(stem)


def _in_symbols(text: str, labels: Sequence[str]) -> str:
    """A fit's remark as HTML, its labels as symbols, its signs as they are set in print."""
    names = "|".join(re.escape(label) for label in sorted(labels, key=len, reverse=True))
    parts = re.split(rf"(?<!\w)({names})(?!\w)", text.replace("+-", "±"))
    signed = [re.sub(r"(?<!\w)-(?=\d)|(?<=\de)-(?=\d)", "−", part) for part in parts]
    return "".join(_symbol(part) if i % 2 else escape(part) for i, part in enumerate(signed))


def content(
    machines: Sequence[CharacterisedMachine], provenance: Mapping[str, str], tables: Sequence[ReportTable] = ()
) -> Content:
    """The whole report about several machines; `tables` are sections of their own."""
    return Content(
        "The 2DoF Drone, characterised",
        say("lead"),
        [finding for machine in machines for finding in _findings(machine)],
        [subject(machine) for machine in machines],
        errata(),
        tables,
        provenance,
    )


def _findings(machine: CharacterisedMachine) -> list[str]:
    """One sentence about a machine: the gain and the worst deviation from the truth, or what stands for it."""
    table, name = rows(machine), escape(machine.name)
    measured = [row for row in table if row.greybox is not None and row.greybox.sigma > 0.0]
    known = [row for row in measured if row.truth is not None]
    if known:
        worst = max(known, key=lambda row: row.greybox_sigmas)
        repeated = any(row.greybox_spread is not None for row in known)
        text = say(
            "farthest",
            name=name,
            inside=sum(row.greybox_sigmas <= 3.0 for row in known),
            count=len(known),
            worst=worst,
            value=with_sigma(worst.greybox or Uncertain(0.0)),
            unit=f" {worst.unit}" if worst.unit else "",
            truth=plain(worst.truth or 0.0),
            measure=say("measure") if repeated else "",
        )
        coarse = [
            f"<i>{row.symbol}</i> {100.0 * row.greybox_error:.0f} %" for row in known if row.greybox_error > _ROUGH
        ]
        return [text + (say("coarse", listed=", ".join(coarse)) if coarse else "")]
    found = [(row, row.greybox) for row in table if row.greybox is not None]
    shown = [f"<i>{row.symbol}</i> = {with_sigma(value)} {row.unit}".strip() for row, value in found]
    return [f"<b>{name}</b>: {', '.join(shown[:6])}."] if shown else []
