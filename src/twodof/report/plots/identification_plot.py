"""Picture of a fit: data and model, residuals and their tests, Bode plot with bands, ellipses of the unknowns."""

import math
import textwrap
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.figure import SubFigure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from twodof.compile.program.lower import lower
from twodof.errors import DiagramError, IdentificationError, printable
from twodof.identify.estimate import Estimate
from twodof.identify.frequency_response import FrequencyResponse, frequency_response
from twodof.identify.record import Record
from twodof.identify.simulation import ModelResponse, model_response
from twodof.identify.validate import Comparison, Correlation
from twodof.models.polynomial import PolynomialModel
from twodof.models.structure import Structure
from twodof.report.plots.canvas import Colours, draw_correlation, figure_page, quiet, write_figure
from twodof.report.plots.flight_view import check_place
from twodof.signals import unit_of

Array = NDArray[np.float64]

_WIDTH_IN, _DPI = 10.0, 150
_PANEL_IN, _TEST_IN, _BODE_IN, _ELLIPSE_IN = 1.7, 1.9, 3.3, 2.5
_LINE_IN, _COLUMNS, _TITLE = 0.17, 125, 80
_MOST_RECORDS, _MOST_UNKNOWNS, _ACROSS = 3, 4, 3
_POINTS, _FEWEST_POINTS = 200, 8
_NYQUIST_SHARE = 0.9
_UNTOLD = 30.0
"""Widest band of a gain that is drawn, as a factor."""
_LEVEL = 0.95
_LEVEL_RADIUS = {0.68: math.sqrt(-2.0 * math.log(0.32)), _LEVEL: math.sqrt(-2.0 * math.log(0.05))}
"""Radius of the region of two normal variables with that probability, in standard deviations."""

_Bode = tuple[str, str, ModelResponse | None, FrequencyResponse | None]


def write_identification_plot(
    found: Estimate,
    structure: Structure | PolynomialModel,
    records: Sequence[Record],
    path: str | Path,
    overwrite: bool = False,
    title: str = "",
    reference: str = "",
) -> None:
    """Draw a fit into a .png, .svg, .pdf or .html file, whole or not at all.

    `records` are those of the fit and of the validation; the first three are shown. `reference` names an input of the
    first record, from which `frequency_response` measures in closed loop. The structure then has one input beside the
    measured ones. Raises IdentificationError if the record lacks it, LogError for a file that
    cannot be written or exists.
    """
    check_place(path, overwrite)  # before the fit is looked at
    named = f"{structure.name}: {', '.join(record.name for record in records[:_MOST_RECORDS])}"
    title = printable(title or textwrap.shorten(named, _TITLE, placeholder=" ..."))
    drawing = _Drawing(found, structure, records[:_MOST_RECORDS], reference)
    table = f"<pre>{escape(found.table())}</pre>"

    def page() -> str:
        return figure_page(title, drawing.about, drawing.notes, lambda colours: drawing.canvas(colours, ""), table)

    write_figure(path, overwrite, title, _DPI, lambda colours: drawing.canvas(colours, title), page)


class _Drawing:
    """Drawing of a fit, with its content computed once."""

    def __init__(
        self, found: Estimate, structure: Structure | PolynomialModel, records: Sequence[Record], reference: str = ""
    ) -> None:
        self.found, self.structure, self.reference = found, structure, reference
        names = [record.name for record in records]
        shown = [one for one in (*found.identification, *found.validation) if one.record in names]
        self.columns = [
            (record, [one for one in shown if one.record == record.name])
            for record in records
            if any(one.record == record.name for one in shown)
        ]
        self.outputs = list(dict.fromkeys(one.output for one in shown))
        self.tested = any(one.whiteness is not None for one in self.columns[0][1])
        self.units = _units(structure, records[0].dt)
        self.bodes, self.notes = self._bodes()
        if self.columns[0][1][0].whiteness is None:
            self.notes.append("the record is too short for tests of the residual")
        known = [i for i in self._own() if math.isfinite(found.quoted[i, i])]
        self.pairs = list(combinations(known[:_MOST_UNKNOWNS], 2))
        self.about = ", ".join(map(self._estimate, self._own()))
        self.heading = [line for text in (self.about, "; ".join(self.notes)) for line in textwrap.wrap(text, _COLUMNS)]

    def _own(self) -> list[int]:
        """Return the places of the machine's unknowns, without those of single records."""
        return [i for i, label in enumerate(self.found.labels) if label not in self.found.local]

    def _estimate(self, place: int) -> str:
        label, unit = self.found.labels[place], self.found.units[place]
        return f"{label} = {self.found.values[place]:.4g} ± {self.found.sigma(label):.2g}{unit and ' ' + unit}"

    def canvas(self, colours: Colours, heading: str) -> Canvas:
        sections: list[tuple[float, Callable[[SubFigure, Colours], None]]] = []
        if heading:
            sections.append((0.55 + _LINE_IN * len(self.heading), partial(self._head, heading)))
        curves = 0.75 * len(self.structure.inputs) + 1.75 * len(self.outputs)
        sections.append((_PANEL_IN * curves + 0.6, self._draw_time))
        if self.tested:
            lines, _ = _grid_of_tests(self.columns[0][1])
            sections.append((_TEST_IN * len(self.columns[0][1]) * lines, self._draw_tests))
        if self.bodes:
            sections.append((_BODE_IN * -(-len(self.bodes) // 2), self._draw_bodes))
        if self.pairs:
            sections.append((_ELLIPSE_IN * -(-len(self.pairs) // _ACROSS), self._draw_ellipses))
        heights = [height for height, _ in sections]
        canvas = Canvas(figsize=(_WIDTH_IN, sum(heights)), layout="constrained")
        rows = canvas.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        for row, (_, draw) in zip(rows, sections, strict=True):
            draw(row, colours)
        return canvas

    def _head(self, title: str, row: SubFigure, colours: Colours) -> None:
        height = 0.55 + _LINE_IN * len(self.heading)
        bold: Any = {"fontsize": 12.5, "fontweight": "bold", "color": colours["ink"]}
        row.text(0.012, 1.0 - 0.12 / height, title, va="top", **bold)
        row.text(0.012, 1.0 - 0.42 / height, "\n".join(self.heading), va="top", fontsize=9.5, color=colours["soft"])

    def _bodes(self) -> tuple[list[_Bode], list[str]]:
        """Return the model's and the measured response of each input and output, and notes about them."""
        found: list[_Bode] = []
        notes: list[str] = []
        record = self.columns[0][0]
        steady = all(record.hold_of(name) == "zoh" for name in self.structure.inputs)
        driving = [name for name in self.structure.inputs if name not in self.structure.measured]
        slowest = max(2.0 * math.pi / (record.steps * record.dt), 1e-3)
        omega = np.geomspace(slowest, _NYQUIST_SHARE * math.pi / record.dt, _POINTS)
        for input, output in product(driving, self.outputs):
            others = [name for name in driving if name != input]
            measured = _measured(record, input, output, others, self.reference)
            if measured is not None and not self.reference and input in self.found.disturbance.answering:
                notes.append(f"{input} answers the noise (closed loop): its measured response is biased")
            model = None
            try:
                model = model_response(self.structure, self.found, input, output, omega, record.dt, record.name)
            except IdentificationError:
                continue  # it moves nothing
            except DiagramError:
                notes.append("no Bode plot of the model: at rest it is not smooth (friction, a limit or a switch)")
            if model is not None or (steady and measured is not None):
                found.append((input, output, model, measured if steady else None))
        return found, list(dict.fromkeys(notes))

    def _draw_time(self, row: SubFigure, colours: Colours) -> None:
        inputs = list(self.structure.inputs)
        ratios = [0.75] * len(inputs) + [1.1, 0.65] * len(self.outputs)
        axes = row.subplots(
            len(ratios), len(self.columns), sharex="col", sharey="row", height_ratios=ratios, squeeze=False
        )
        for column, (record, comparisons) in enumerate(self.columns):
            kind = "validation" if any(one.record == record.name for one in self.found.validation) else "identification"
            for ax, name in zip(axes[:, column], inputs, strict=False):
                quiet(ax)
                ax.plot(record.time, record.inputs[name], color=colours["input"], linewidth=1.2, drawstyle="steps-post")
                if column == 0:
                    ax.set_ylabel(_label(name, self.units.get(name, "")))
            says = f"{kind}: {record.name}"[-_TITLE // len(self.columns) :]
            axes[0, column].set_title(says, loc="left", fontsize=9.5, color=colours["soft"])
            for one in comparisons:
                place = len(inputs) + 2 * self.outputs.index(one.output)
                self._draw_fit(axes[place, column], axes[place + 1, column], one, column == 0, colours)
            axes[-1, column].set_xlabel("time [s]")
            axes[-1, column].set_xlim(record.time[0], record.time[-1])
        row.align_ylabels()

    def _draw_fit(self, top: Axes, below: Axes, one: Comparison, first: bool, colours: Colours) -> None:
        unit = self.units.get(one.output, "")
        quiet(top)
        quiet(below)
        wide = len(self.columns) < 3
        behind: Any = {"color": colours["measured"], "alpha": 0.55, "label": "measured" if wide else None}
        top.plot(one.time, one.measured, linewidth=2.6, **behind)
        says = f"{'model, ' if wide else ''}FIT {one.fit_percent:.1f} %{self._ahead(one)}"
        top.plot(one.time, one.simulated, color=colours["grey-box"], linewidth=1.5, label=says)
        top.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        below.plot(one.time, one.residual, color=colours["simple"], linewidth=0.8)
        below.axhline(0.0, color=colours["soft"], linewidth=0.6)
        if first:
            top.set_ylabel(_label(one.output, unit))
            below.set_ylabel("residual" + (f" [{unit}]" if unit else ""))

    def _ahead(self, one: Comparison) -> str:
        """Return the FIT of the one-step prediction for a closed loop, where gusts change the flight."""
        if self.found.disturbance.kind == "innovation":
            return " one sample ahead"
        if one.ahead is None or not self.found.disturbance.predicts:
            return ""
        # Of several records each has a third of the width.
        return f" without the gusts, {one.ahead:.1f} % one sample ahead" if len(self.columns) == 1 else " without gusts"

    def _draw_tests(self, row: SubFigure, colours: Colours) -> None:
        comparisons = self.columns[0][1]
        lines, across = _grid_of_tests(comparisons)
        axes = row.subplots(lines * len(comparisons), across, squeeze=False)
        for one, own in zip(comparisons, axes.reshape(len(comparisons), -1), strict=True):
            tests: list[tuple[str, Correlation | None]] = [(f"residual of {one.output} with itself", one.whiteness)]
            tests += [(f"with {name}", test) for name, test in one.inputs.items()]
            for ax, (name, test) in zip(own, tests, strict=False):
                _draw_test(ax, name, test, colours)
            for ax in own[len(tests) :]:
                ax.set_axis_off()
        for ax in axes[:, 0]:
            ax.set_ylabel("correlation")

    def _draw_bodes(self, row: SubFigure, colours: Colours) -> None:
        across = min(2, len(self.bodes))
        axes = row.subplots(2 * -(-len(self.bodes) // across), across, sharex=True, squeeze=False)
        for ax in axes.flat[:]:
            ax.set_visible(False)
        for number, bode in enumerate(self.bodes):
            line, column = 2 * (number // across), number % across
            units = (self.units.get(bode[0], ""), self.units.get(bode[1], ""))
            _draw_bode(axes[line, column], axes[line + 1, column], bode, units, colours)
        row.align_ylabels()

    def _draw_ellipses(self, row: SubFigure, colours: Colours) -> None:
        axes = row.subplots(-(-len(self.pairs) // _ACROSS), _ACROSS, squeeze=False)
        for ax, (i, j) in zip(axes.flat, self.pairs, strict=False):
            _draw_ellipse(ax, self.found, i, j, colours)
        for ax in axes.flat[len(self.pairs) :]:
            ax.set_axis_off()


def _grid_of_tests(comparisons: Sequence[Comparison]) -> tuple[int, int]:
    """Return the lines for each output and the tests in a line, so that titles have room."""
    width = 1 + max((len(one.inputs) for one in comparisons), default=0)
    lines = -(-width // _ACROSS)
    return lines, -(-width // lines)


def _units(structure: Structure | PolynomialModel, dt: float) -> dict[str, str]:
    """Return the units of inputs and outputs, as the diagram declares them."""
    if isinstance(structure, PolynomialModel):
        return {name: unit for name in (*structure.inputs, *structure.outputs) if (unit := unit_of(name)) != "-"}
    program = lower(structure.diagram, dt)
    declared = {name: one.unit or unit_of(name) for name, one in {**program.inputs, **program.outputs}.items()}
    return {name: unit for name, unit in declared.items() if unit != "-"}


def _measured(
    record: Record, input: str, output: str, others: Sequence[str], reference: str
) -> FrequencyResponse | None:
    """Return the averaged response, or None if the record is too short or too few points are known."""
    try:
        found = frequency_response(record, input, output, given=others, reference=[reference] if reference else [])
    except IdentificationError:
        if reference and (reference not in record.inputs or others):
            raise
        return None
    return found if np.count_nonzero(_clear(found)) >= _FEWEST_POINTS else None


def _clear(measured: FrequencyResponse) -> NDArray[np.bool_]:
    """Return True for the points known to half of their size, below the Nyquist frequency.

    Leakage into the gaps of the input's spectrum mostly has larger errors.
    """
    size = abs(measured.response)
    known = measured.trusted() & (measured.radius(_LEVEL) < 0.5 * size)
    return np.asarray(known & (measured.omega < _NYQUIST_SHARE * math.pi / measured.dt))


def _label(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _draw_test(ax: Axes, name: str, test: Correlation | None, colours: Colours) -> None:
    soft = colours["soft"]
    ax.set_title(name, fontsize=9.5, color=soft, loc="left")
    if test is None:
        quiet(ax)
        ax.text(0.5, 0.5, "the record is too short", ha="center", va="center", transform=ax.transAxes, color=soft)
        ax.set_xticks([])
        ax.set_yticks([])
        return
    line, title, word = ("grey-box", "soft", "within") if test.passed else ("bad", "bad", "outside")
    draw_correlation(ax, test, colours[line], {"color": colours["grey-box"], "alpha": 0.12}, soft, 1.6)
    ax.set_title(f"{word} the 99 % band", fontsize=9, color=colours[title], loc="right")


def _phase_deg(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return the unwrapped phase, on the branch that lies below 180 degrees at the highest frequency.

    A damping that is estimated below 0 raises the phase at the resonance instead of lowering it.
    """
    phase = np.degrees(np.unwrap(np.angle(response)))
    return np.asarray(phase - 360.0 * max(0.0, np.ceil((phase[-1] - 180.0) / 360.0)))


def _draw_bode(top: Axes, below: Axes, bode: _Bode, units: tuple[str, str], colours: Colours) -> None:
    input, output, model, measured = bode
    for ax in (top, below):
        ax.set_visible(True)
        ax.grid(visible=True)
        ax.set_xscale("log")
    if measured is not None:
        use = _clear(measured)
        omega, response = measured.omega[use], measured.response[use]
        share = measured.radius(_LEVEL)[use] / np.maximum(abs(response), 1e-300)
        look: Any = {"fmt": "o", "ms": 2.6, "color": colours["measured"], "elinewidth": 0.8}
        low = np.minimum(share, 0.9)
        top.errorbar(omega, abs(response), yerr=abs(response) * np.array([low, share]), label="measured, 95 %", **look)
        phase = np.degrees(np.unwrap(np.angle(response)))
        if model is not None:  # on the model's branch
            near = np.interp(omega, model.omega, _phase_deg(model.response))
            phase += 360.0 * np.round((near - phase) / 360.0)
        below.errorbar(omega, phase, yerr=np.degrees(np.minimum(share, math.pi)), **look)
    if model is not None:
        low, high = model.gain_band(_LEVEL)
        # Where the damping may be 0 the band at the resonance has no end: drawn whole it would flatten all else.
        gain = abs(model.response)
        low, high = np.maximum(low, gain / _UNTOLD), np.minimum(high, gain * _UNTOLD)
        phase = _phase_deg(model.response)
        half = np.minimum(np.degrees(1.96 * model.phase_sigma), 180.0)
        line: Any = {"color": colours["grey-box"], "linewidth": 1.4}
        for ax, lower, upper in ((top, low, high), (below, phase - half, phase + half)):
            ax.fill_between(model.omega, lower, upper, color=colours["grey-box"], alpha=0.22, linewidth=0)
        top.plot(model.omega, gain, label="model, 95 %", **line)
        below.plot(model.omega, phase, **line)
    top.set_title(f"from {input} to {output}", fontsize=9.5, color=colours["soft"], loc="left")
    top.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    above = f"({units[1]})" if "/" in units[1] and units[0] else units[1] or "1"
    top.set(yscale="log", ylabel=_label("gain", f"{above}/{units[0]}" if units[0] else units[1]))
    below.set(ylabel="phase [deg]", xlabel="frequency [rad/s]")
    below.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 1.5, 3, 4.5, 6, 9, 10]))
    top.yaxis.set_major_locator(LogLocator(10, numticks=6))
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    for axis in (below.xaxis, top.yaxis):
        axis.set_major_formatter(plain)
        axis.set_minor_formatter(NullFormatter())
    top.tick_params(axis="x", labelbottom=False)


def _draw_ellipse(ax: Axes, found: Estimate, i: int, j: int, colours: Colours) -> None:
    ax.grid(visible=True)
    ax.tick_params(length=0)
    part = found.quoted[np.ix_([i, j], [i, j])]
    values, vectors = np.linalg.eigh(part)
    half = vectors * np.sqrt(np.maximum(values, 0.0))
    angle = np.linspace(0.0, 2.0 * math.pi, 181)
    circle = np.array([np.cos(angle), np.sin(angle)])
    for level, alpha in ((_LEVEL, 0.14), (0.68, 0.24)):
        x, y = found.values[[i, j]][:, None] + _LEVEL_RADIUS[level] * (half @ circle)
        ax.fill(x, y, color=colours["grey-box"], alpha=alpha, linewidth=0)
        ax.plot(x, y, color=colours["grey-box"], linewidth=1.0)
    ax.plot([found.values[i]], [found.values[j]], "+", color=colours["ink"], ms=7)
    xlabel, ylabel = (_label(found.labels[k], found.units[k]) for k in (i, j))
    ax.set(xlabel=xlabel, ylabel=ylabel)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(4))
    rho = part[0, 1] / math.sqrt(part[0, 0] * part[1, 1])
    ax.set_title(f"correlation {rho:+.2f}", fontsize=9, color=colours["soft"], loc="right")
