"""Figures as inline SVG whose colours and fonts are the page's, so that they follow light and dark."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import MaxNLocator

from twodof.identify.validate import Correlation
from twodof.report.content import Figure, FigureBand, LineRole, Panel, ParameterRow, Span, Subject
from twodof.report.plots.canvas import STAND_IN, draw_correlation, quiet, settings, svg

_STROKE: dict[LineRole, dict[str, Any]] = {
    "measured": {"linewidth": 1.1},
    "input": {"linewidth": 1.3},
    "set-point": {"linewidth": 1.2, "dashes": (5, 2.5)},
    "simple": {"linewidth": 1.6, "dashes": (4, 2)},
    "grey-box": {"linewidth": 1.6},
}
_WIDTH_IN = 5.0


def time_figure(figure: Figure, title: str) -> str:
    """Return the figure's panels above one another over a common time axis, as an `<svg>` element."""
    heights = [panel.height for panel in figure.panels]
    with matplotlib.rc_context(settings(STAND_IN)):
        canvas = Canvas(figsize=(_WIDTH_IN, 0.75 + 1.45 * sum(heights)), layout="constrained")
        axes = canvas.subplots(len(heights), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
        for ax, panel in zip(axes, figure.panels, strict=True):
            _draw_panel(ax, panel)
        axes[-1].set_xlabel("time [s]")
        axes[-1].margins(x=0.01)
        canvas.align_ylabels()
        return svg(canvas, title)


def _draw_panel(ax: Axes, panel: Panel) -> None:
    quiet(ax)
    ax.set_ylabel(panel.label)
    for line in panel.lines:
        ax.plot(line.time, line.value, color=STAND_IN[line.role], **_STROKE[line.role])
    if panel.limits is not None:
        ax.set_ylim(*panel.limits)
    low, high = ax.get_ylim()
    for mark in panel.marks:
        if isinstance(mark, FigureBand):
            ax.axhspan(mark.low, mark.high, color=STAND_IN["band"], linewidth=0.8)
            edge = ("axes fraction", "data")
            _note(ax, mark.label, (1.0, mark.high), (-4, 3), xycoords=edge, ha="right", color=STAND_IN["soft"])
        elif isinstance(mark, Span):
            _draw_span(ax, mark, high)
        else:
            ax.plot([mark.time], [mark.value], "o", ms=4.5, mfc="none", mec=STAND_IN["ink"], mew=1.1)
            up = mark.value >= 0.5 * (low + high)
            _note(ax, mark.label, (mark.time, mark.value), (7, 2 if up else -2), va="bottom" if up else "top")


def _note(ax: Axes, text: str, at: tuple[float, float], points: tuple[float, float], **look: Any) -> None:
    """Write a text at the distance `points` from the place `at`."""
    ax.annotate(text, at, points, textcoords="offset points", fontsize=8.5, **look)


def _draw_span(ax: Axes, span: Span, high: float) -> None:
    """Draw an arrow from start to stop at the top of the panel with the label above its middle."""
    arrow = {"arrowstyle": "<->", "color": STAND_IN["ink"], "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", (span.stop, high), (span.start, high), arrowprops=arrow)
    for edge in (span.start, span.stop):
        ax.axvline(edge, color=STAND_IN["ink"], linewidth=0.5, dashes=(2, 2))
    _note(ax, span.label, (0.5 * (span.start + span.stop), high), (0, 3), ha="center")
    ax.set_ylim(top=high + 0.18 * (high - ax.get_ylim()[0]))


def correlation_figure(tests: Mapping[str, Correlation], title: str) -> str:
    """Return the correlations of residuals with their bounds, one panel each under its name."""
    with matplotlib.rc_context(settings(STAND_IN)):
        canvas = Canvas(figsize=(_WIDTH_IN, 1.9), layout="constrained")
        axes = canvas.subplots(1, len(tests), squeeze=False)[0]
        for ax, (name, test) in zip(axes, tests.items(), strict=True):
            draw_correlation(ax, test, STAND_IN["grey-box"], {"color": STAND_IN["band"]}, STAND_IN["soft"], 1.4)
            ax.set_title(name, fontsize=9, color=STAND_IN["soft"], loc="left")
        return svg(canvas, title)


def estimates_figure(subjects: Sequence[Subject], title: str) -> str:
    """Return a panel for each parameter of the paper, with each machine's estimates and truth."""
    keys = list(dict.fromkeys(row.key for one in subjects for row in one.rows if row.paper is not None))
    with matplotlib.rc_context(settings(STAND_IN)):
        columns = 3
        canvas = Canvas(figsize=(9.6, 0.3 + (0.85 + 0.3 * len(subjects)) * -(-len(keys) // columns)))
        canvas.set_layout_engine("constrained", w_pad=0.12, h_pad=0.08)
        axes = canvas.subplots(-(-len(keys) // columns), columns, squeeze=False)
        for ax in axes.flat[len(keys) :]:
            ax.set_axis_off()
        for index, (ax, key) in enumerate(zip(axes.flat, keys, strict=False)):
            rows = [{row.key: row for row in subject.rows}.get(key) for subject in subjects]
            _draw_estimates(ax, rows)
            first = index % columns == 0
            ax.set_yticks(range(len(subjects)), [subject.name if first else "" for subject in subjects])
        return svg(canvas, title)


def _draw_estimates(ax: Axes, rows: Sequence[ParameterRow | None]) -> None:
    ax.grid(visible=True, axis="x")
    ax.tick_params(length=0)
    ax.xaxis.set_major_locator(MaxNLocator(5))
    shown = [row for row in rows if row is not None]
    if shown:
        unit = f" [{shown[0].unit}]" if shown[0].unit else ""
        ax.set_title(f"{_plain(shown[0].symbol)}{unit}", fontsize=10.5, color=STAND_IN["ink"], loc="left")
        for paper in (shown[0].paper, shown[0].paper_greybox):
            if paper is not None:
                ax.axvline(paper, color=STAND_IN["paper"], linewidth=1.0, dashes=(4, 2))
    for height, row in enumerate(rows):
        if row is None:
            continue
        if row.truth is not None:
            ax.plot([row.truth], [height], "|", ms=17, mew=1.6, color=STAND_IN["ink"])
        for estimate, role, offset, shape in ((row.simple, "simple", -0.14, "s"), (row.greybox, "grey-box", 0.14, "o")):
            if estimate is not None:
                sigma = estimate.sigma if np.isfinite(estimate.sigma) else 0.0
                look: Any = {"fmt": shape, "ms": 4.5, "color": STAND_IN[role], "elinewidth": 1.3}
                ax.errorbar(estimate.value, height + offset, xerr=sigma, **look)
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.margins(x=0.12)


# An SVG text has no subscript of its own; Unicode has none of "p" in all fonts, so letters follow plainly.
_SUBSCRIPTS = str.maketrans({"n": "ₙ", "v": "ᵥ"})


def _plain(symbol: str) -> str:
    return re.sub(r"<sub>(.*?)</sub>", lambda match: match[1].translate(_SUBSCRIPTS), symbol)
