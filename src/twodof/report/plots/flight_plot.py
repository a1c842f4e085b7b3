"""Picture of a flight: PNG, SVG or PDF to put into a text, or a page that follows light and dark."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from textwrap import wrap
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from twodof.flight.failsafe.causes_and_actions import ACTIONS
from twodof.report.content import Span
from twodof.report.plots.canvas import Colours, figure_page, quiet, write_figure
from twodof.report.plots.flight_view import Curve, FlightView, View

_WIDTH_IN, _PANEL_IN, _STRIP_IN = 10.0, 1.75, 0.27
_DPI = 150
_LETTER_IN = 0.082
"""Width of a letter at the size of the bands' names."""

_LEGEND_PT = 16.0

_LINE = 120
"""Letters in a line of the heading."""
_LOOK: MappingProxyType[str, dict[str, Any]] = MappingProxyType(
    {
        "true": {"color": "measured", "linewidth": 3.0, "alpha": 0.55, "zorder": 1.8},
        "estimated": {"color": "grey-box", "linewidth": 1.2, "zorder": 2.2},
        "set-point": {"color": "paper", "linewidth": 1.3, "dashes": (4, 1.5), "zorder": 2.0},
        "expected": {"color": "ink", "linewidth": 1.3, "zorder": 2.4},
        "moment M": {"color": "input", "linewidth": 1.2},
        "thrust T": {"color": "simple", "linewidth": 1.4},
    }
)
_OTHERS = ("grey-box", "simple", "input", "set-point", "paper", "measured")
_TINT = MappingProxyType(
    {
        "off": "rule",
        "open-loop": "input",
        "rate": "set-point",
        "attitude": "grey-box",
        "velocity": "simple",
        "position": "paper",
    }
)


def write_plot(view: FlightView, path: str | Path, overwrite: bool = False) -> None:
    """Draw the view into a .png, .svg, .pdf or .html file, whole or not at all. Raises LogError as `write_figure`."""
    drawing = partial(_drawn, view, heading=True)
    write_figure(path, overwrite, view.title, _DPI, drawing, lambda: to_html(view))


def to_html(view: FlightView) -> str:
    """Return a page of its own, without script or network."""
    return figure_page(view.title, view.about, view.notes, partial(_drawn, view, heading=False))


def _drawn(view: FlightView, colours: Colours, heading: bool) -> Canvas:
    kinds = (("mode", view.modes), ("failsafe", view.failsafe), ("excitation", view.excitations))
    strips = [(name, bands) for name, bands in kinds if bands]
    heights = [_STRIP_IN * len(strips)] * bool(strips) + [_PANEL_IN] * len(view.views)
    canvas = Canvas(figsize=(_WIDTH_IN, 0.5 + 0.6 * heading + sum(heights)), layout="constrained")
    axes = list(canvas.subplots(len(heights), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0])
    axes[0].set_xlim(*view.span)
    if strips:
        _draw_strips(axes[0], strips, view.span, colours)
    explained: set[tuple[str, Any]] = set()
    for ax, one in zip(axes[bool(strips) :], view.views, strict=True):
        _draw_view(ax, one, colours, explained)
        _draw_background(ax, view, colours)
    axes[-1].set_xlabel(f"{view.clock} [s]")
    canvas.align_ylabels()
    if heading:
        _head(axes[0], view, colours, _LEGEND_PT * (not strips))
    return canvas


def _head(ax: Axes, view: FlightView, colours: Colours, legend: float) -> None:
    """Write title and notes above the uppermost axes, and above their legend of this height [points]."""
    lines = [line for part in (view.about, *view.notes) for line in wrap(part, _LINE)]
    under = 7.0 + 13.0 * len(lines) + legend
    ax.set_title(view.title, loc="left", fontsize=12.5, fontweight="bold", pad=under)
    above: Any = {"xycoords": "axes fraction", "textcoords": "offset points", "va": "bottom"}
    ax.annotate("\n".join(lines), (0.0, 1.0), (0.0, 6.0 + legend), **above, fontsize=9.5, color=colours["soft"])


def _draw_strips(
    ax: Axes, strips: Sequence[tuple[str, tuple[Span, ...]]], span: tuple[float, float], colours: Colours
) -> None:
    """Draw bands with their names, a row for each kind; names too long for all their bands stand in a key below."""
    named: set[str] = set()
    keys: dict[str, Patch] = {}
    inch = (span[1] - span[0]) / (0.87 * _WIDTH_IN)
    ax.set_ylim(len(strips) - 0.5, -0.5)
    ax.set_yticks(range(len(strips)), [name for name, _ in strips])
    ax.tick_params(axis="x", length=0, labelbottom=False)
    ax.tick_params(axis="y", labelcolor=colours["soft"])
    ax.spines["bottom"].set_visible(False)
    for row, (name, bands) in enumerate(strips):
        for band in bands:
            colour, alpha = _paint(name, band.label, colours)
            ax.broken_barh([(band.start, band.stop - band.start)], (row - 0.42, 0.84), color=colour, alpha=alpha, lw=0)
            ax.vlines([band.start, band.stop], row - 0.42, row + 0.42, color=colour, linewidth=0.8)
            # Of what the failsafe does and why, what it does may fit.
            for text in dict.fromkeys((band.label, band.label.partition(":")[0])):
                if _LETTER_IN * (len(text) + 1) * inch < band.stop - band.start:
                    middle = 0.5 * (band.start + band.stop)
                    ax.text(middle, row, text, ha="center", va="center_baseline", fontsize=9, color=colours["ink"])
                    named.add(text)
                    break
            if band.label not in named:
                keys.setdefault(band.label, Patch(color=colour, alpha=alpha, linewidth=0))
    keys = {label: patch for label, patch in keys.items() if label not in named}
    if keys:
        ax.legend(keys.values(), keys.keys(), loc="upper right", bbox_to_anchor=(1.0, 0.0), ncols=len(keys))


def _paint(strip: str, label: str, colours: Colours) -> tuple[str, float]:
    """Return colour and opacity of a band; a stronger act of the failsafe is darker."""
    if strip == "failsafe":
        return colours["bad"], 0.15 * (1 + ACTIONS.index(label.partition(":")[0]))
    return (colours["ink"], 0.18) if strip == "excitation" else (colours[_TINT.get(label, "rule")], 0.38)


def _draw_view(ax: Axes, view: View, colours: Colours, explained: set[tuple[str, Any]]) -> None:
    """Draw curves and band, and their legend where the axes above, in `explained`, leave a name or a colour open."""
    quiet(ax)
    ax.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    ax.set_ylabel(view.label)
    others = [curve for curve in view.curves if curve.label not in _LOOK]
    if view.band is not None:
        band = view.band
        ax.fill_between(
            band.time, band.low, band.high, color=colours["set-point"], alpha=0.2, linewidth=0, label=band.label
        )
    for curve in view.curves:
        number = others.index(curve) if curve in others else 0
        _draw_curve(ax, curve, _OTHERS[number % len(_OTHERS)], colours)
    if not any(np.isfinite(curve.value).any() for curve in view.curves):
        ax.text(0.5, 0.5, "no sample", ha="center", va="center", transform=ax.transAxes, color=colours["soft"])
        ax.set_yticks([])
    elif named := {(str(line.get_label()), line.get_color()) for line in ax.lines if _has_name(line)} - explained:
        explained |= named
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(view.curves) + (view.band is not None))


def _has_name(line: Line2D) -> bool:
    """Return True if a legend explains the line: matplotlib leaves out what begins with an underscore."""
    return not str(line.get_label() or "_").startswith("_")


def _draw_curve(ax: Axes, curve: Curve, other: str, colours: Colours) -> None:
    look = dict(_LOOK.get(curve.label, {"color": other, "linewidth": 1.2}))
    look["color"] = colours[look["color"]]
    look["drawstyle"] = "steps-post" if curve.held else "default"
    if np.isfinite(curve.value).sum() == 1:
        look["marker"] = "."  # a line of no length
    ax.plot(curve.time, curve.value, label=curve.label, **look)


def _draw_background(ax: Axes, view: FlightView, colours: Colours) -> None:
    """Draw the bands of the strips faintly behind the curves."""
    for band in view.modes[1:]:
        ax.axvline(band.start, color=colours["rule"], linewidth=0.8, zorder=0)
    for band in view.excitations:
        ax.axvspan(band.start, band.stop, color=colours["ink"], alpha=0.045, linewidth=0, zorder=0)
    for band in view.failsafe:
        ax.axvspan(band.start, band.stop, color=colours["bad"], alpha=0.10, linewidth=0, zorder=0)
