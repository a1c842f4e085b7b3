"""The paper's Figures 3 to 8, redrawn from one machine's characterisation."""

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
from twodof.identify.record_simulator import RecordSimulator
from twodof.identify.simple_pitch import SETTLED, edges_of
from twodof.identify.simple_pitch import simulated_pair as pitch_pair
from twodof.identify.simple_velocity import simulated_pair as velocity_pair
from twodof.identify.validate import Comparison, fit_percent
from twodof.models.structures import rail
from twodof.report.characterisation.characterise import Characterisation
from twodof.report.content import Figure, FigureBand, FigureLine, FigurePoint, Panel, Span
from twodof.report.diagram_svg import to_inline_svg
from twodof.report.wording import plain, say

Array = NDArray[np.float64]

_Q = "q [rad/s]"
_V = "v [m/s]"


def figures(found: Characterisation) -> Iterator[Figure]:
    """Yield the figures of the experiments that were flown, with times from the excitation's first edge."""
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
    caption = say("impulse")
    if found.pulse is not None:
        lines.append(_simulated(found.pulse.identification[0], zero))
        caption += say("impulse_fit", fit=found.pulse.identification[0].fit_percent)
    marks: list[Span | FigureBand] = []
    if found.pitch is not None:
        free = found.pitch.free
        first = float(free.crossings[0]) - zero
        marks.append(Span(first, first + free.period, f"T = {free.period:.3f} s"))
        band = SETTLED * abs(float(free.peaks[0]))
        marks.append(FigureBand(-band, band, "1 % of the first peak"))
        late = " (extrapolated)" if free.extrapolated else ""
        caption += say("impulse_hand", free=free, w_n=plain(free.w_n), late=late, xi=plain(free.xi, 3))
    panels = [_input_panel(record, whole, zero), Panel(_Q, lines, marks, 1.7)]
    return Figure(3, "response to the impulse-like signal", caption, panels)


def _figure_4(found: Characterisation) -> Figure:
    record = found.flights.doublets[0]
    zero = _first_edge(record, "M")
    whole = _whole_flight(found, record)
    marks, caption = [], say("doublet")
    if found.pitch is not None:
        one = found.pitch.doublet
        top = one.rest + math.copysign(one.peak, one.amplitude)
        marks = [FigurePoint(one.peak_time - zero, top, f"{one.peak:.2f} rad/s")]
        caption += say("doublet_hand", one=one, unit_peak=1e3 * one.unit_peak, tau=1e3 * one.tau)
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
    caption = say("cascade", method=method, k_v=plain(k_v), p_v=plain(p_v))
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
    caption, marks = say("velocity"), []
    if found.velocity is not None:
        step = found.velocity.step
        marks = [FigurePoint(step.peak_time - zero, step.rest + step.peak, f"{step.peak:.2f} m/s")]
        caption += say(
            "velocity_hand",
            slope=plain(step.slope, 3),
            theta=math.degrees(step.theta_bar),
            after=step.peak_time - step.start,
            k_v=plain(step.k_v),
            p_v=plain(step.p_v),
        )
    else:
        caption += say("velocity_closed")
    panels = [
        Panel("θ [°]", pitch, _used(record, whole, zero), 1.1),
        Panel(_V, [_measured(whole, "v", zero)], marks, 1.3),
    ]
    return Figure(7, "velocity experiment", caption, panels)


def _figure_8(found: Characterisation) -> Figure:
    record = found.flights.velocities[0]
    zero = _first_edge(record, "theta0")
    lines, panels = [_measured(record, "v", zero)], []
    caption = say("travel")
    if found.velocity is not None:
        lines.append(_by_hand(velocity_pair(found.velocity.model, record), record, "v", zero))
        hand = [found.velocity.identification, *found.velocity.validation]
        flights = f", {len(hand)} flights, the first is drawn" if len(hand) > 1 else ""
        caption += say("travel_hand", flights=flights, fits=", ".join(f"{value:.1f} %" for _, value in hand))
    if found.travel is not None:
        velocity = _velocity(found.travel, record)
        lines.append(FigureLine("grey-box", record.output_time("v") - zero, velocity))
        caption += say("travel_fit", fit=fit_percent(record.outputs["v"].value, velocity))
        drawn = {"identification": found.travel.identification[:1], "validation": found.travel.validation[:1]}
        caption += ", ".join(f"{one.fit_percent:.1f} % ({word})" for word, ones in drawn.items() for one in ones)
        for one in (*drawn["identification"], *drawn["validation"]):
            other = next(r for r in found.flights.velocities if r.name == one.record)
            start = _first_edge(other, "theta0")
            position = [_measured(other, "x", start), _simulated(one, start)]
            panels.append(Panel("x [m]", position, height=0.9))
    return Figure(8, "velocity model, verification", f"{caption}.", [Panel(_V, lines, height=1.3), *panels])


def _velocity(estimate: Estimate, record: Record) -> Array:
    """Return v of the fitted model, at the samples of the on-board estimate, in a record that the fit has used."""
    values = dict(estimate.fixed)
    for label in estimate.labels:
        name, _, owner = label.partition("[")
        if owner in ("", f"{record.name}]"):
            values[name] = estimate[label]
    return RecordSimulator(rail(thrust="curve" in values), only(record, "v")).run(values)["v"]


def _whole_flight(found: Characterisation, record: Record) -> Record:
    """Return the flight around the record, as far as it is known."""
    return found.flights.surroundings.get(record.name, record)


def _used(record: Record, whole: Record, zero: float) -> list[Span]:
    """Return a mark on the stretch that identifies the model, if more than that is drawn."""
    if whole is record:
        return []
    return [Span(record.start - zero, float(record.time[-1]) - zero, "identification")]


def _first_edge(record: Record, channel: str) -> float:
    """Return the time [s] of the excitation's first edge; without edges (a sweep), the record's start."""
    try:
        return record.start + edges_of(record, record.inputs[channel], channel)[0] * record.dt
    except IdentificationError:
        return record.start


def _input_panel(record: Record, whole: Record, zero: float) -> Panel:
    """Return the panel of M over the whole flight, to the scale of the excitation, not of the larger M afterwards."""
    # Two points a step, so that a held input is drawn held.
    time = np.repeat(whole.time - zero, 2)[1:]
    line = FigureLine("input", time, np.repeat(whole.inputs["M"], 2)[:-1])
    low, high = float(record.inputs["M"].min()), float(record.inputs["M"].max())
    room = 0.15 * (high - low) or 0.01
    return Panel("M [–]", [line], _used(record, whole, zero), 0.6, (low - room, high + room))


def _measured(record: Record, output: str, zero: float) -> FigureLine:
    return FigureLine("measured", record.output_time(output) - zero, record.outputs[output].value)


def _by_hand(pair: tuple[Array, Array], record: Record, output: str, zero: float) -> FigureLine:
    """Return the line of the simple method about the measured mean; `pair` is its measured and simulated output."""
    shown, model = pair
    rest = float(np.mean(record.outputs[output].value - shown))
    return FigureLine("simple", record.output_time(output) - zero, model + rest)


def _simulated(comparison: Comparison, zero: float) -> FigureLine:
    return FigureLine("grey-box", comparison.time - zero, comparison.simulated)


def _of_record(estimate: Estimate | None, record: Record) -> Comparison | None:
    both = () if estimate is None else (*estimate.identification, *estimate.validation)
    return next((one for one in both if one.record == record.name), None)
