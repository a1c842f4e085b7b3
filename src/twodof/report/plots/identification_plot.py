"""Picture of a fit: data and model, residuals and their tests, Bode plot with bands, ellipses of the unknowns."""

import math
import textwrap
from collections.abc import Sequence
from html import escape
from itertools import combinations
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
from twodof.flightlog.atomic import atomic_write
from twodof.identify.estimate import Estimate
from twodof.identify.frequency_response import FrequencyResponse, frequency_response
from twodof.identify.model_response import ModelResponse, model_response
from twodof.identify.record import Record
from twodof.identify.validate import Comparison, Correlation
from twodof.models.structure import Structure
from twodof.report.plots.canvas import Colours, figure_page, picture_bytes, quiet
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
    structure: Structure,
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
    check_place(path, overwrite)
    suffix = Path(path).suffix.lower()
    named = f"{structure.name}: {', '.join(record.name for record in records[:_MOST_RECORDS])}"
    title = printable(title or textwrap.shorten(named, _TITLE, placeholder=" ..."))
    drawing = _Drawing(found, structure, records[:_MOST_RECORDS], reference)
    if suffix == ".html":
        table = f"<pre>{escape(found.table())}</pre>"
        shown = figure_page(title, drawing.about, drawing.notes, lambda colours: drawing.canvas(colours, ""), table)
        content = shown.encode()
    else:
        content = picture_bytes(suffix, title, _DPI, lambda colours: drawing.canvas(colours, title))
    with atomic_write(path, "wb") as file:
        file.write(content)


class _Drawing:
    """Drawing of a fit, with its content computed once."""

    def __init__(self, found: Estimate, structure: Structure, records: Sequence[Record], reference: str = "") -> None:
        self.found, self.structure, self.reference = found, structure, reference
        names = [record.name for record in records]
        shown = [one for one in (*found.identification, *found.validation) if one.record in names]
        self.columns = [
            (record, [one for one in shown if one.record == record.name])
            for record in records
            if any(one.record == record.name for one in shown)
        ]
        self.outputs = list(dict.fromkeys(one.output for one in shown))
        self.units = _units(structure, records[0].dt)
        self.bodes, self.notes = self._bodes()
        if self.columns[0][1][0].whiteness is None:
            self.notes.append("the record is too short for tests of the residual")
        self.pairs = self._pairs()
        said = [self.about, "; ".join(self.notes)]
        self.heading = [line for text in said for line in textwrap.wrap(text, _COLUMNS)]

    @property
    def about(self) -> str:
        """Return the estimates in a line."""
        parts = []
        for i, label in enumerate(self.found.labels):
            if label not in self.found.local:
                unit = self.found.units[i]
                parts.append(
                    f"{label} = {self.found.values[i]:.4g} ± {self.found.sigma(label):.2g}{unit and ' ' + unit}"
                )
        return ", ".join(parts)

    @property
    def _head_in(self) -> float:
        """Return the height of the title and of the lines below it."""
        return 0.55 + _LINE_IN * len(self.heading)

    def canvas(self, colours: Colours, heading: str) -> Canvas:
        inputs, outputs = list(self.structure.inputs), self.outputs
        bodes = [one for one in self.bodes if one[2] is not None or one[3] is not None]
        time_in = 0.75 * _PANEL_IN * len(inputs) + 1.75 * _PANEL_IN * len(outputs) + 0.6
        tested = any(one.whiteness is not None for one in self.columns[0][1])
        heights = [
            time_in,
            *([_TEST_IN * len(self.columns[0][1]) * _grid_of_tests(self.columns[0][1])[0]] if tested else []),
        ]
        heights += [_BODE_IN * -(-len(bodes) // 2)] if bodes else []
        heights += [_ELLIPSE_IN * -(-len(self.pairs) // _ACROSS)] if self.pairs else []
        head = self._head_in if heading else 0.0
        canvas = Canvas(figsize=(_WIDTH_IN, head + sum(heights)), layout="constrained")
        rows = iter(
            canvas.subfigures(
                len(heights) + bool(heading), 1, height_ratios=[*[head] * bool(heading), *heights], squeeze=False
            )[:, 0]
        )
        if heading:
            self._head(next(rows), heading, colours)
        self._draw_time(next(rows), colours)
        if tested:
            self._draw_tests(next(rows), colours)
        if bodes:
            self._draw_bodes(next(rows), bodes, colours)
        if self.pairs:
            self._draw_ellipses(next(rows), colours)
        return canvas

    def _head(self, row: SubFigure, title: str, colours: Colours) -> None:
        row.text(
            0.012, 1.0 - 0.12 / self._head_in, title, fontsize=12.5, fontweight="bold", va="top", color=colours["ink"]
        )
        row.text(
            0.012, 1.0 - 0.42 / self._head_in, "\n".join(self.heading), fontsize=9.5, va="top", color=colours["soft"]
        )

    def _bodes(self) -> tuple[list[_Bode], list[str]]:
        """Return the model's and the measured response of each input and output, and notes about them."""
        found: list[_Bode] = []
        notes: list[str] = []
        record = self.columns[0][0]
        steady = not any(kind != "zoh" for kind in (record.hold_of(name) for name in self.structure.inputs))
        driving = [name for name in self.structure.inputs if name not in self.structure.measured]
        for input in driving:
            for output in self.outputs:
                others = [name for name in driving if name != input]
                measured = _measured(record, input, output, others, self.reference)
                if measured is not None and not self.reference and input in self.found.disturbance.answering:
                    notes.append(f"{input} answers the noise (closed loop): its measured response is biased")
                omega = np.geomspace(
                    max(2.0 * math.pi / (record.steps * record.dt), 1e-3), _NYQUIST_SHARE * math.pi / record.dt, _POINTS
                )
                model = None
                try:
                    model = model_response(self.structure, self.found, input, output, omega, record.dt, record.name)
                except IdentificationError:
                    continue  # it moves nothing
                except DiagramError:
                    notes.append("no Bode plot of the model: at rest it is not smooth (friction, a limit or a switch)")
                found.append((input, output, model, measured if steady else None))
        return found, list(dict.fromkeys(notes))

    def _pairs(self) -> list[tuple[int, int]]:
        """Return the pairs of unknowns of the machine whose uncertainty is known."""
        known = [
            i
            for i, label in enumerate(self.found.labels)
            if label not in self.found.local and math.isfinite(self.found.quoted[i, i])
        ]
        return list(combinations(known[:_MOST_UNKNOWNS], 2))

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
        top.plot(
            one.time,
            one.measured,
            color=colours["measured"],
            linewidth=2.6,
            alpha=0.55,
            label="measured" if len(self.columns) < 3 else None,
        )
        top.plot(
            one.time,
            one.simulated,
            color=colours["grey-box"],
            linewidth=1.5,
            label=f"{'model, ' if len(self.columns) < 3 else ''}FIT {one.fit_percent:.1f} %{self._ahead(one)}",
        )
        top.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        below.plot(one.time, one.residual, color=colours["simple"], linewidth=0.8)
        below.axhline(0.0, color=colours["soft"], linewidth=0.6)
        if first:
            top.set_ylabel(_label(one.output, unit))
            below.set_ylabel("residual" + (f" [{unit}]" if unit else ""))

    def _ahead(self, one: Comparison) -> str:
        """Return the FIT of the one-step prediction for a closed loop, where gusts change the flight."""
        if one.ahead is None or not self.found.disturbance.answering:
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
                _draw_correlation(ax, name, test, colours)
            for ax in own[len(tests) :]:
                ax.set_axis_off()
        for ax in axes[:, 0]:
            ax.set_ylabel("correlation")

    def _draw_bodes(self, row: SubFigure, bodes: Sequence[_Bode], colours: Colours) -> None:
        across = min(2, len(bodes))
        axes = row.subplots(2 * -(-len(bodes) // across), across, sharex=True, squeeze=False)
        for ax in axes.flat[:]:
            ax.set_visible(False)
        for number, bode in enumerate(bodes):
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


def _units(structure: Structure, dt: float) -> dict[str, str]:
    """Return the units of inputs and outputs, as the diagram declares them."""
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


def _draw_correlation(ax: Axes, name: str, test: Correlation | None, colours: Colours) -> None:
    quiet(ax)
    ax.set_title(name, fontsize=9.5, color=colours["soft"], loc="left")
    if test is None:
        ax.text(
            0.5, 0.5, "the record is too short", ha="center", va="center", transform=ax.transAxes, color=colours["soft"]
        )
        ax.set_xticks([])
        ax.set_yticks([])
        return
    ax.fill_between(test.lags, -test.bound, test.bound, color=colours["grey-box"], alpha=0.12, linewidth=0)
    ax.vlines(test.lags, 0.0, test.value, color=colours["grey-box" if test.passed else "bad"], linewidth=1.6)
    ax.axhline(0.0, color=colours["soft"], linewidth=0.6)
    ax.set_xlabel("lag [samples]")
    reach = 1.15 * max(float(np.abs(test.value).max()), 2.0 * float(test.bound.max()))
    ax.set_ylim(-reach, reach)
    says = "within the 99 % band" if test.passed else "outside the 99 % band"
    ax.set_title(says, fontsize=9, color=colours["soft" if test.passed else "bad"], loc="right")


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
        phase = np.degrees(np.angle(response))
        if model is not None:  # on the model's branch
            near = np.interp(omega, model.omega, np.degrees(np.unwrap(np.angle(model.response))))
            phase += 360.0 * np.round((near - phase) / 360.0)
        else:
            phase = np.degrees(np.unwrap(np.angle(response)))
        below.errorbar(omega, phase, yerr=np.degrees(np.minimum(share, math.pi)), **look)
    if model is not None:
        low, high = model.gain_band(_LEVEL)
        # Where the damping may be 0 the band at the resonance has no end: drawn whole it would flatten all else.
        gain = abs(model.response)
        low, high = np.maximum(low, gain / _UNTOLD), np.minimum(high, gain * _UNTOLD)
        phase = np.degrees(np.unwrap(np.angle(model.response)))
        half = np.minimum(np.degrees(1.96 * model.phase_sigma), 180.0)
        top.fill_between(model.omega, low, high, color=colours["grey-box"], alpha=0.22, linewidth=0)
        below.fill_between(model.omega, phase - half, phase + half, color=colours["grey-box"], alpha=0.22, linewidth=0)
        top.plot(model.omega, abs(model.response), color=colours["grey-box"], linewidth=1.4, label="model, 95 %")
        below.plot(model.omega, phase, color=colours["grey-box"], linewidth=1.4)
    top.set_yscale("log")
    top.set_title(f"from {input} to {output}", fontsize=9.5, color=colours["soft"], loc="left")
    top.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    above = f"({units[1]})" if "/" in units[1] and units[0] else units[1] or "1"
    both = f"{above}/{units[0]}" if units[0] else units[1]
    top.set_ylabel(_label("gain", both))
    below.set_ylabel("phase [deg]")
    below.set_xlabel("frequency [rad/s]")
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
    ax.set_xlabel(_label(found.labels[i], found.units[i]))
    ax.set_ylabel(_label(found.labels[j], found.units[j]))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(4))
    rho = part[0, 1] / math.sqrt(part[0, 0] * part[1, 1])
    ax.set_title(f"correlation {rho:+.2f}", fontsize=9, color=colours["soft"], loc="right")
