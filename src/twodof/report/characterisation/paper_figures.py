"""The paper's Figures 3 to 8, redrawn from one machine's characterisation."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.diagram import Diagram
from twodof.blocks.library.continuous import Integrator, TransferFunction
from twodof.errors import IdentificationError
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import only
from twodof.identify.record import Record
from twodof.identify.simple_pitch import SETTLED, edges_of
from twodof.identify.simple_pitch import simulated_pair as pitch_pair
from twodof.identify.simple_velocity import simulated_pair as velocity_pair
from twodof.identify.simulate import RecordSimulator
from twodof.identify.validate import Comparison, fit_percent
from twodof.models.structures import rail
from twodof.report.characterisation.characterise import Characterisation
from twodof.report.content import Figure, FigureBand, FigureLine, FigurePoint, Panel, Span
from twodof.report.drawing.diagram_svg import to_inline_svg
from twodof.report.numbers import plain

Array = NDArray[np.float64]

_Q = "q [rad/s]"
_V = "v [m/s]"


def figures(found: Characterisation) -> Iterator[Figure]:
    """Those of the figures for which the experiment was flown, times counted from the excitation's first edge."""
    if found.flights.impulses:
        yield _figure_3(found)
    if found.flights.doublets:
        yield _figure_4(found)
        yield _figure_5(found)
    if "k_v" in found.greybox or found.velocity is not None:
        yield _figure_6(found)
    if found.flights.velocities:
        yield _figure_7(found)
        yield _figure_8(found)


def _figure_3(found: Characterisation) -> Figure:
    record = found.flights.impulses[0]
    zero = _first_edge(record, "M")
    whole = _whole_flight(found, record)
    lines = [_measured(whole, "q", zero)]
    fit = found.dry or found.free
    caption = "M = 0.1 for 0.2 s, then free. "
    if fit is not None:
        lines.append(_simulated(fit.identification[0], zero))
        kind = "with dry friction and a hardening spring" if found.dry else "linear"
        caption += f"The grey-box model ({kind}) reaches a FIT of {fit.identification[0].fit_percent:.1f} %"
        if found.dry and found.free:
            caption += f", the paper’s linear one {found.free.identification[0].fit_percent:.1f} %"
        caption += ". "
    marks: list[Span | FigureBand] = []
    if found.pitch is not None:
        free = found.pitch.free
        first = float(free.crossings[0]) - zero
        marks.append(Span(first, first + free.period, f"T = {free.period:.3f} s"))
        band = SETTLED * abs(float(free.peaks[0]))
        marks.append(FigureBand(-band, band, "1 % of the first peak"))
        late = " (extrapolated)" if free.extrapolated else ""
        caption += (
            f"By hand: period {free.period:.3f} s gives ω<sub>n</sub> = {plain(free.w_n)} rad/s; settled after "
            f"{free.settling_time:.1f} s{late}, which gives ξ = {plain(free.xi, 3)}. The paper read 1.83 s and 16 s."
        )
    return Figure(
        3,
        "response to the impulse-like signal",
        caption,
        [_input_panel(record, whole, zero), Panel(_Q, lines, marks, 1.7)],
    )


def _figure_4(found: Characterisation) -> Figure:
    record = found.flights.doublets[0]
    zero = _first_edge(record, "M")
    whole = _whole_flight(found, record)
    marks, caption = [], "Open loop, rotors on. "
    if found.pitch is not None:
        one = found.pitch.doublet
        marks = [
            FigurePoint(
                one.peak_time - zero, one.rest + math.copysign(one.peak, one.amplitude), f"{one.peak:.2f} rad/s"
            )
        ]
        caption += (
            f"The first peak is {one.peak:.2f} rad/s above the rest and would be {1e3 * one.unit_peak:.2f}·10<sup>−3"
            f"</sup> rad/s with μ = 1: μ = {one.mu:.1f} rad/s² (paper: 2.40, 6.68·10<sup>−3</sup>, 358.5). The "
            f"response lies {one.shift} samples, {1e3 * one.tau:.0f} ms, behind the input."
        )
    panels = [_input_panel(record, whole, zero), Panel(_Q, [_measured(whole, "q", zero)], marks, 1.7)]
    return Figure(4, "doublet, identification data", caption, panels)


def _figure_5(found: Characterisation) -> Figure:
    panels, scores = [], []
    for index, record in enumerate(found.flights.doublets[:3]):
        zero = _first_edge(record, "M")
        lines = [_measured(record, "q", zero)]
        word = "identification" if index == 0 else "validation"
        if found.pitch is not None:
            lines.append(_by_hand(pitch_pair(found.pitch.model, record, found.flights.trim), record, "q", zero))
        comparison = _of_record(found.forced, record)
        if comparison is not None:
            lines.append(_simulated(comparison, zero))
            scores.append(f"{word} {comparison.fit_percent:.1f} %")
        panels.append(Panel(_Q, lines, height=1.3 if index == 0 else 0.9))
    caption = "From the top: the record that identified"
    caption += ", then those that validate. " if len(panels) > 1 else " (flown once, so none validates). "
    if scores:
        caption += f"FIT of the grey-box model: {', '.join(scores)}. "
    if found.pitch is not None:
        hand = [found.pitch.identification, *found.pitch.validation]
        caption += f"By hand: {', '.join(f'{value:.1f} %' for _, value in hand)}."
    return Figure(5, "angular rate model, verification", caption, panels)


def _figure_6(found: Characterisation) -> Figure:
    if "k_v" in found.greybox:
        k_v, p_v, method = found.greybox["k_v"].value, found.greybox["p_v"].value, "of the grey-box fit"
    elif found.velocity is not None:
        k_v, p_v, method = found.velocity.model.k_v, found.velocity.model.p_v, "read by hand"
    gain, pole = (float(f"{value:.4g}") for value in (k_v, p_v))
    attitude = Diagram("attitude", "the closed attitude loop")
    attitude.output("theta", attitude.input("theta_d", unit="rad"))
    model = Diagram("figure_6")
    model.input("theta_d", unit="rad")
    model.add("T_att", attitude, theta_d="theta_d")
    model.add("G_v", TransferFunction([-gain], [1.0, pole], unit="m/s"), u="T_att.theta")
    model.add("G_x", Integrator(unit="m"), u="G_v")
    model.output("theta", "T_att.theta")
    model.output("v", "G_v")
    model.output("x", "G_x")
    caption = (
        "The attitude loop T<sub>att</sub> turns the set-point θ<sub>d</sub> into the pitch θ, which drives the "
        "velocity v and the position x. G<sub>v</sub> = −k<sub>v</sub> / (s + p<sub>v</sub>) with the values "
        f"{method}: k<sub>v</sub> = {plain(k_v)} m/s², p<sub>v</sub> = {plain(p_v)} 1/s."
    )
    title = "cascaded attitude and translation dynamics"
    return Figure(6, title, caption, picture=to_inline_svg(model, title))


def _figure_7(found: Characterisation) -> Figure:
    record = found.flights.velocities[0]
    zero = _first_edge(record, "theta0")
    whole = _whole_flight(found, record)
    time = whole.time - zero
    pitch = [
        FigureLine("set-point", time, np.degrees(whole.inputs["theta0"])),
        FigureLine("measured", time, np.degrees(whole.inputs["theta"])),
    ]
    caption, marks = "Pitch set-point and pitch above, velocity below. ", []
    if found.velocity is not None:
        step = found.velocity.step
        marks = [FigurePoint(step.peak_time - zero, step.rest + step.peak, f"{step.peak:.2f} m/s")]
        caption += (
            f"By hand: the slope of {plain(step.slope, 3)} m/s² at {math.degrees(step.theta_bar):.0f}° gives "
            f"k<sub>v</sub> = {plain(step.k_v)} m/s²; the peak, {step.peak_time - step.start:.2f} s after the start, "
            f"gives p<sub>v</sub> = {plain(step.p_v)} 1/s."
        )
    else:
        caption += "The velocity loop was closed, so there is no doublet of pitch to read by hand."
    panels = [
        Panel("θ [°]", pitch, _used(record, whole, zero), 1.1),
        Panel(_V, [_measured(whole, "v", zero)], marks, 1.3),
    ]
    return Figure(7, "velocity experiment", caption, panels)


def _figure_8(found: Characterisation) -> Figure:
    record = found.flights.velocities[0]
    zero = _first_edge(record, "theta0")
    lines, panels = [_measured(record, "v", zero)], []
    caption = "Above, the velocity as the on-board filter estimates it. "
    if found.velocity is not None:
        lines.append(_by_hand(velocity_pair(found.velocity.model, record), record, "v", zero))
        hand = [found.velocity.identification, *found.velocity.validation]
        flights = f", {len(hand)} flights, the first is drawn" if len(hand) > 1 else ""
        caption += f"FIT of v by hand{flights}: {', '.join(f'{value:.1f} %' for _, value in hand)}. "
    if found.travel is not None:
        velocity = _velocity(found.travel, record)
        lines.append(FigureLine("grey-box", record.output_time("v") - zero, velocity))
        caption += (
            f"FIT of v of the grey-box model: {fit_percent(record.outputs['v'].value, velocity):.1f} % in the flight "
            "drawn. "
            "Below, the position as the range sensor sees it: the grey-box model goes from the gyro to the range, so "
            "that the filter’s errors do not become the model’s. FIT of x: "
        )
        drawn = {"identification": found.travel.identification[:1], "validation": found.travel.validation[:1]}
        caption += ", ".join(f"{one.fit_percent:.1f} % ({word})" for word, ones in drawn.items() for one in ones)
        for one in (*drawn["identification"], *drawn["validation"]):
            other = next(r for r in found.flights.velocities if r.name == one.record)
            start = _first_edge(other, "theta0")
            position = [_measured(other, "x", start), _simulated(one, start)]
            panels.append(Panel("x [m]", position, height=0.9))
    return Figure(8, "velocity model, verification", f"{caption}.", [Panel(_V, lines, height=1.3), *panels])


def _velocity(estimate: Estimate, record: Record) -> Array:
    """v of the fitted model, at the samples of the on-board estimate, in a record that the fit has used."""
    values = dict(estimate.fixed)
    for label in estimate.labels:
        name, _, owner = label.partition("[")
        if owner in ("", f"{record.name}]"):
            values[name] = estimate[label]
    return RecordSimulator(rail(thrust="curve" in values), only(record, "v")).run(values)["v"]


def _whole_flight(found: Characterisation, record: Record) -> Record:
    """The flight around the record, as far as it is known."""
    return found.flights.surroundings.get(record.name, record)


def _used(record: Record, whole: Record, zero: float) -> list[Span]:
    """The stretch of the flight that the model is identified from, where more than that is drawn."""
    if whole is record:
        return []
    return [Span(record.start - zero, float(record.time[-1]) - zero, "identification")]


def _first_edge(record: Record, channel: str) -> float:
    """Time [s] of the excitation's first edge; of one without edges (a sweep) the record's start."""
    try:
        return record.start + edges_of(record, record.inputs[channel], channel)[0] * record.dt
    except IdentificationError:
        return record.start


def _input_panel(record: Record, whole: Record, zero: float) -> Panel:
    """M over the whole flight, to the scale of the excitation: what stops the drone afterwards may be far larger."""
    # Two points a step, so that a held input is drawn held.
    time = np.repeat(whole.time - zero, 2)[1:]
    line = FigureLine("input", time, np.repeat(whole.inputs["M"], 2)[:-1])
    low, high = float(record.inputs["M"].min()), float(record.inputs["M"].max())
    room = 0.15 * (high - low) or 0.01
    return Panel("M [–]", [line], _used(record, whole, zero), 0.6, (low - room, high + room))


def _measured(record: Record, output: str, zero: float) -> FigureLine:
    return FigureLine("measured", record.output_time(output) - zero, record.outputs[output].value)


def _by_hand(pair: tuple[Array, Array], record: Record, output: str, zero: float) -> FigureLine:
    """The simple method's model about the mean of what was measured; `pair` is the output it takes, and its own."""
    shown, model = pair
    rest = float(np.mean(record.outputs[output].value - shown))
    return FigureLine("simple", record.output_time(output) - zero, model + rest)


def _simulated(comparison: Comparison, zero: float) -> FigureLine:
    return FigureLine("grey-box", comparison.time - zero, comparison.simulated)


def _of_record(estimate: Estimate | None, record: Record) -> Comparison | None:
    both = () if estimate is None else (*estimate.identification, *estimate.validation)
    return next((one for one in both if one.record == record.name), None)
