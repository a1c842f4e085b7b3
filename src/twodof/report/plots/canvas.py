"""Common parts of all figures: the colours of the design, fonts, axes, files, and inline SVG in the page's colours."""

import functools
import io
import re
from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import MaxNLocator

from twodof.flightlog.atomic import atomic_write
from twodof.identify.validate import Correlation
from twodof.report.plots.flight_view import PICTURES, SUFFIXES, check_place
from twodof.report.wording import fill, text

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
