"""Composition of the report from characterisations: Table 1, checks, doubts, findings, and errata of the paper."""

import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape

import numpy as np

from twodof.excitation import Doublet, Excitation, Impulse
from twodof.identify.estimate import Estimate
from twodof.identify.record import Record
from twodof.identify.simple_velocity import read_step
from twodof.models.lti import DelayedStateSpace
from twodof.models.plant import PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX, PAPER_VELOCITY_SIMPLE, PitchRate, Velocity
from twodof.report.characterisation.characterise import Characterisation
from twodof.report.characterisation.paper_figures import figures
from twodof.report.content import Content, ParameterRow, ReportTable, Subject, Uncertain
from twodof.report.wording import plain, say, text, with_sigma

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
# A correlation, or a relative error, from here on is told to the reader.
_CORRELATED, _ROUGH = 0.8, 0.1
_STEP_S, _PERIOD_S, _PEAK = 1e-3, 1.83, 2.40  # of the errata: the simulations' step, and what the paper prints
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
    """Return Table 1 for one machine; parameters beyond the paper's are left out if not found."""
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
    """Return the report's content about one machine."""
    return Subject(
        machine.name,
        machine.text,
        rows(machine),
        list(figures(machine.found)),
        machine.found.fits,
        [*machine.remarks, *_doubts(machine.found)],
    )


def _doubts(found: Characterisation) -> list[str]:
    said = [escape(refusal) for refusal in found.refusals]
    if found.forced is not None:
        said.append(say("poles"))
    if found.travel is not None:
        said.append(say("friction"))
    for name, estimate in found.fits.items():
        said.extend(f"{name.capitalize()}: {remark}" for remark in _unsure(estimate))
    for row in _PAPER:
        claimed, spread = found.greybox.get(row.key), found.spreads.get(row.key)
        if claimed is not None and spread is not None and spread.exceeds(claimed.sigma):
            said.append(say("spread", symbol=row.symbol, times=spread.value / claimed.sigma))
    return said


def _unsure(estimate: Estimate) -> Iterator[str]:
    """Yield the pair that is hardest to tell apart, the rough estimates, and the fit's own remarks.

    Remarks about residuals are left to the section about residuals.
    """
    own = [i for i, label in enumerate(estimate.labels) if label not in estimate.local and estimate.sigma(label) > 0.0]
    own = [i for i in own if estimate.labels[i] not in estimate.at_bound]
    pairs = [(abs(estimate.correlation[i, j]), i, j) for i in own for j in own if i < j]
    strongest, i, j = max(pairs, default=(0.0, 0, 0))
    if strongest > _CORRELATED:
        sense = "more" if estimate.correlation[i, j] > 0.0 else "less"
        one, other = (_symbol(estimate.labels[k]) for k in (i, j))
        yield say("apart", one=one, other=other, correlation=plain(estimate.correlation[i, j], 2), sense=sense)
    shares = {estimate.labels[k]: estimate.sigma(estimate.labels[k]) / abs(estimate.values[k]) for k in own}
    if rough := [f"{_symbol(label)} ± {100.0 * share:.0f} %" for label, share in shares.items() if share > _ROUGH]:
        yield f"Rough (standard deviation): {', '.join(rough)}."
    for remark in estimate.remarks:
        if "residual" not in remark and "told apart" not in remark:
            yield f"{_in_symbols(remark, estimate.labels)}."


def _symbol(label: str) -> str:
    """Return an estimate's label as HTML: Table 1's symbol, else a letter with what follows `_` as its subscript."""
    known = {row.key: row.symbol for row in (*_PAPER, *_DRY)}
    if label in known:
        return known[label]
    stem, below, index = label.partition("_")
    letter = _GREEK.get(stem, stem)
    return f"{escape(letter)}<sub>{escape(index)}</sub>" if below and len(letter) == 1 else escape(label)


def _in_symbols(remark: str, labels: Sequence[str]) -> str:
    """Return a fit's remark as HTML, with symbols for labels and printed signs."""
    names = "|".join(re.escape(label) for label in sorted(labels, key=len, reverse=True))
    parts = re.split(rf"(?<!\w)({names})(?!\w)", remark.replace("+-", "±"))
    signed = [re.sub(r"(?<!\w)-(?=\d)|(?<=\de)-(?=\d)", "−", part) for part in parts]
    return "".join(_symbol(part) if i % 2 else escape(part) for i, part in enumerate(signed))


def content(
    machines: Sequence[CharacterisedMachine], provenance: Mapping[str, str], tables: Sequence[ReportTable] = ()
) -> Content:
    """Return the whole report about several machines; `tables` are sections of their own."""
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
    """Return a sentence about a machine: the worst deviation from the truth or, if that is unknown, the estimates."""
    table, name = rows(machine), escape(machine.name)
    measured = [row for row in table if row.greybox is not None and row.greybox.sigma > 0.0]
    known = [row for row in measured if row.truth is not None]
    if known:
        worst = max(known, key=lambda row: row.greybox_sigmas)
        repeated = any(row.greybox_spread is not None for row in known)
        finding = say(
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
        return [finding + (say("coarse", listed=", ".join(coarse)) if coarse else "")]
    found = [(row, row.greybox) for row in table if row.greybox is not None]
    shown = [f"<i>{row.symbol}</i> = {with_sigma(value)} {row.unit}".strip() for row, value in found]
    return [f"<b>{name}</b>: {', '.join(shown[:6])}."] if shown else []


def unit_peak() -> float:
    """Return the first peak of q [rad/s] after the paper's doublet (0.03, period 0.6 s) with mu = 1 and no delay."""
    model = PitchRate(PAPER_PITCH_RATE.w_n, PAPER_PITCH_RATE.xi, 1.0, 0.0)
    return float(_response(model.state_space(), Doublet(0.03, 0.6), 1.0)[:, 1].max())


def impulse_angle_deg() -> float:
    """Return the largest pitch [deg] of the paper's model after the paper's impulse (0.1 for 0.2 s)."""
    pitch = _response(PAPER_PITCH_RATE.state_space(), Impulse(0.1, 0.2), 4.0)[:, 0]
    return float(np.degrees(np.abs(pitch).max()))


def doublet_travel(model: Velocity, amplitude_deg: float, half_period_s: float) -> float:
    """Return the travel [m] of the cart during a doublet of pitch from rest, without attitude dynamics."""
    excitation = Doublet(math.radians(amplitude_deg), 2.0 * half_period_s)
    position = _response(model.state_space(), excitation, 2.0 * half_period_s)[:, 0]
    return float(np.ptp(position))


def read_by_hand() -> tuple[float, float]:
    """Read k_v and p_v by the paper's method by hand from its own grey-box model (15 deg, half-period 0.8 s)."""
    lead = 1.0
    pitch = Doublet(math.radians(15.0), 1.6, lead=lead)
    time = np.arange(0.0, lead + 1.6, _STEP_S)
    theta = pitch.at(time)
    v = PAPER_VELOCITY_GREYBOX.state_space().zero_order_hold(_STEP_S).simulate(theta)[:, 1]
    step = read_step(Record.from_columns(time, {"theta0": theta, "v": v}, ["theta0"], ["v"]))
    return step.k_v, step.p_v


def _response(plant: DelayedStateSpace, excitation: Excitation, duration: float) -> np.ndarray:
    time = np.arange(0.0, duration, _STEP_S)
    return plant.zero_order_hold(_STEP_S).simulate(excitation.at(time))


def errata() -> list[tuple[str, str, str]]:
    """Return place, printed text and finding of each of the paper's errors, in the order of its pages."""
    pitch, simple, greybox = PAPER_PITCH_RATE, PAPER_VELOCITY_SIMPLE, PAPER_VELOCITY_GREYBOX
    peak = unit_peak()
    rows = text("errata.toml").format(
        pitch=pitch,
        simple=simple,
        greybox=greybox,
        w_n=2.0 * math.pi / _PERIOD_S,
        period_of_w_n=2.0 * math.pi / pitch.w_n,
        damped=100.0 * (1.0 / math.sqrt(1.0 - pitch.xi**2) - 1.0),
        angle=impulse_angle_deg(),
        unit_peak=1e3 * peak,
        mu=_PEAK / peak,
        travels=[doublet_travel(model, 20.0, 1.0) for model in (simple, greybox)],
        read=read_by_hand(),
    )
    return [(row["place"], row["printed"], row["shown"]) for row in tomllib.loads(rows)["errata"]]
