"""Common parts of all figures: the colours of the design, fonts, axes, files, and inline SVG in the page's colours."""

from __future__ import annotations

import functools
import io
import re
from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import MaxNLocator

from twodof.flightlog.atomic import atomic_write
from twodof.report.content import Figure, FigureBand, LineRole, Panel, ParameterRow, Span, Subject
from twodof.report.plots.flight_view import PICTURES, SUFFIXES, check_place
from twodof.report.wording import fill, text

if TYPE_CHECKING:
    from twodof.identify.validate import Correlation

_BOTH = re.compile(r"--([\w-]+): light-dark\((#\w+), (#\w+)\);")
_ONE = re.compile(r"--([\w-]+): (#\w+);")
_ALONE = MappingProxyType({".png": FigureCanvasAgg, ".svg": FigureCanvasSVG, ".pdf": FigureCanvasPdf})

# Colours of the page. matplotlib draws with a stand-in for each; in an SVG that becomes the CSS variable.
_NAMES = "ink soft rule measured input set-point simple grey-box band paper bad"

Colours = Mapping[str, str]
"""A colour as matplotlib takes it, by its name in tokens.css; "paper" is that of the truth."""

STAND_IN: Colours = MappingProxyType({name: f"#0a0b{i:02x}" for i, name in enumerate(_NAMES.split(), 1)})
"""For figures that `svg` turns into an element of a page."""


class Shades(NamedTuple):
    """A colour on a light page, and on a dark one."""

    light: str
    dark: str


@functools.cache
def design_colours() -> Mapping[str, Shades]:
    """Return every colour of tokens.css, which the page in the browser has too, by its name."""
    tokens = text("tokens.css")
    found = {name: Shades(light, dark) for name, light, dark in _BOTH.findall(tokens)}
    return MappingProxyType(found | {name: Shades(one, one) for name, one in _ONE.findall(tokens)})


@functools.cache
def style() -> str:
    """Return the colours as CSS without `light-dark()`, which tokens.css has and older browsers lack."""

    def rows(dark: bool) -> str:
        return " ".join(f"--{name}: {shades[dark]};" for name, shades in design_colours().items())

    light = f":root {{ color-scheme: light dark; {rows(dark=False)} }}\n"
    return light + f"@media (prefers-color-scheme: dark) {{ :root {{ {rows(dark=True)} }} }}\n"


def page(title: str, lead: str, main: str, findings: str = "") -> str:
    """Return a page without script or network: the title as text, all else as HTML."""
    return fill(
        "page.html", title=escape(title), lead=lead, findings=findings, main=main, style=style() + text("style.css")
    )


def on_paper() -> Colours:
    """Return the light colours, for figures that stand alone."""
    light = {name: shades.light for name, shades in design_colours().items()}
    return light | {"paper": light["truth"]}


def settings(colours: Colours) -> Any:
    """Return the settings for `matplotlib.rc_context`."""
    return {
        "svg.fonttype": "none",
        "text.parse_math": False,  # a name may hold a dollar sign
        "figure.facecolor": "none",
        "axes.facecolor": "none",
        "font.size": 9.5,
        "axes.axisbelow": True,
        "axes.linewidth": 0.6,
        **dict.fromkeys(("axes.spines.top", "axes.spines.right", "axes.spines.left"), False),
        "axes.edgecolor": colours["rule"],
        "axes.labelcolor": colours["soft"],
        **dict.fromkeys(("xtick.color", "ytick.color", "grid.color"), colours["rule"]),
        **dict.fromkeys(("xtick.labelcolor", "ytick.labelcolor", "legend.labelcolor"), colours["soft"]),
        "text.color": colours["ink"],
        "grid.linewidth": 0.5,
        "xtick.major.size": 3.0,
        "ytick.major.size": 0.0,
        "legend.frameon": False,
        "legend.borderaxespad": 0.0,
        "legend.borderpad": 0.15,
        "legend.fontsize": 9,
        "path.simplify": True,
        "path.simplify_threshold": 0.3,
    }


def quiet(ax: Axes) -> None:
    """Give axes a horizontal grid."""
    ax.grid(visible=True, axis="y")
    ax.yaxis.set_major_locator(MaxNLocator(4))


def write_figure(
    path: str | Path,
    overwrite: bool,
    title: str,
    dpi: int,
    draw: Callable[[Colours], Canvas],
    page: Callable[[], str] | None = None,
) -> None:
    """Draw a canvas in the colours of paper into a .png, .svg or .pdf file, or write the `page` as .html file.

    Equal data give equal bytes. Raises LogError for another suffix, and for a file that cannot be written or exists.
    """
    check_place(path, overwrite, PICTURES if page is None else SUFFIXES)
    suffix, out = Path(path).suffix.lower(), io.BytesIO()
    if page is not None and suffix == ".html":
        out.write(page().encode())
    else:
        colours = on_paper()
        ground: Any = dict.fromkeys(("figure.facecolor", "savefig.facecolor"), colours["card"])
        undated: Any = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(suffix)
        with matplotlib.rc_context({**settings(colours), **ground, "svg.hashsalt": title}):
            canvas = draw(colours)
            _ALONE[suffix](canvas)
            canvas.savefig(out, format=suffix[1:], dpi=dpi, metadata=undated)
    with atomic_write(path, "wb") as file:
        file.write(out.getvalue())


def draw_correlation(ax: Axes, test: Correlation, line: str, band: Mapping[str, Any], soft: str, width: float) -> None:
    """Draw a correlation of residuals over its lags, with its bound as a `band`."""
    quiet(ax)
    ax.fill_between(test.lags, -test.bound, test.bound, linewidth=0, **band)
    ax.vlines(test.lags, 0.0, test.value, color=line, linewidth=width)
    ax.axhline(0.0, color=soft, linewidth=0.6)
    ax.set_xlabel("lag [samples]")
    reach = 1.15 * max(float(np.abs(test.value).max()), 2.0 * float(test.bound.max()))
    ax.set_ylim(-reach, reach)


def figure_page(
    title: str, about: str, notes: Sequence[str], draw: Callable[[Colours], Canvas], below: str = ""
) -> str:
    """Return a page, without script or network, with one figure, notes under it, and the HTML `below`."""
    with matplotlib.rc_context(settings(STAND_IN)):
        picture = svg(draw(STAND_IN), escape(title))
    caption = "".join(f"<p>{escape(note)}</p>" for note in notes)
    figure = f'<figure class="wide" style="max-width:72rem">{picture}<figcaption>{caption}</figcaption></figure>'
    return page(title, escape(about), f"<main>{figure}{below}</main>")


def svg(canvas: Canvas, title: str) -> str:
    """Return the canvas, drawn in `STAND_IN`, as an SVG element for inline use: same bytes for the same data."""
    with matplotlib.rc_context({"svg.hashsalt": title}):
        out = io.StringIO()
        FigureCanvasSVG(canvas)
        _settle(canvas)
        canvas.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    drawn = out.getvalue()
    drawn = drawn[drawn.index("<svg") :]
    drawn = re.sub(r"<metadata>.*?</metadata>", "", drawn, flags=re.DOTALL)
    # Groups are numbered alike in every figure; only what is referred to (clip paths, markers) keeps its name.
    drawn = re.sub(r'<g id="[^"]*"', "<g", drawn)
    for name, colour in STAND_IN.items():
        drawn = drawn.replace(colour, f"var(--{name})")
    drawn = re.sub(r"font: ([\d.]+px)[^;\"]*", r"font-size: \1", drawn)
    view = drawn.split('viewBox="', 1)[1].split('"', 1)[0]
    head = f'<svg viewBox="{view}" role="img" aria-label="{title}">'
    return re.sub(r"\s*\n\s*", "\n", re.sub(r"<svg[^>]*>", head, drawn, count=1))


def _settle(canvas: Canvas) -> None:
    """Lay the axes out, to a thousandth of a point: the last bits of the solver's places change from run to run."""
    canvas.draw_without_rendering()
    canvas.set_layout_engine("none")
    for ax in canvas.axes:
        x, y, width, height = (round(part, 6) for part in ax.get_position().bounds)
        ax.set_position((x, y, width, height))


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
