"""What all figures share: colours by name, fonts, axes without a box, and the SVG that follows the page."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import MaxNLocator

# Stand-in colours that matplotlib draws with; in an SVG each becomes the CSS variable of the page.
_TOKENS = MappingProxyType(
    {
        "#0a0b01": "ink",
        "#0a0b02": "soft",
        "#0a0b03": "rule",
        "#0a0b04": "measured",
        "#0a0b05": "input",
        "#0a0b06": "set-point",
        "#0a0b07": "simple",
        "#0a0b08": "grey-box",
        "#0a0b09": "band",
        "#0a0b0a": "paper",
        "#0a0b0b": "bad",
    }
)

Colours = Mapping[str, str]
"""A colour as matplotlib takes it, by its name in style.css."""

STAND_IN: Colours = MappingProxyType({token: colour for colour, token in _TOKENS.items()})
"""For figures that `svg` turns into an element of a page."""


def style() -> str:
    """The style sheet of all pages."""
    return (files("twodof.report") / "style.css").read_text(encoding="utf-8")


def on_paper() -> Colours:
    """The light colours of the style sheet, for figures that stand alone."""
    light = style().split("}", 1)[0]
    return dict(re.findall(r"--([\w-]+): (#\w+);", light))


def settings(colours: Colours) -> Any:
    """For `matplotlib.rc_context`."""
    return {
        "svg.fonttype": "none",
        "text.parse_math": False,  # a name may hold a dollar sign
        "figure.facecolor": "none",
        "axes.facecolor": "none",
        "font.size": 9.5,
        "axes.linewidth": 0.6,
        "axes.edgecolor": colours["rule"],
        "axes.labelcolor": colours["soft"],
        "xtick.color": colours["rule"],
        "ytick.color": colours["rule"],
        "xtick.labelcolor": colours["soft"],
        "ytick.labelcolor": colours["soft"],
        "text.color": colours["ink"],
        "grid.color": colours["rule"],
        "grid.linewidth": 0.5,
        "xtick.major.size": 3.0,
        "ytick.major.size": 0.0,
        "path.simplify": True,
        "path.simplify_threshold": 0.3,
    }


def quiet(ax: Axes) -> None:
    """Axes with a horizontal grid and no box."""
    ax.grid(visible=True, axis="y")
    ax.set_axisbelow(True)
    for side in ("top", "right", "left"):
        ax.spines[side].set_visible(False)
    ax.yaxis.set_major_locator(MaxNLocator(4))


def svg(canvas: Canvas, title: str) -> str:
    """The canvas, drawn in `STAND_IN`, as an SVG element for inline use: same bytes for the same data."""
    with matplotlib.rc_context({"svg.hashsalt": title}):
        out = io.StringIO()
        FigureCanvasSVG(canvas)
        _settle(canvas)
        canvas.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Groups are numbered alike in every figure; only what is referred to (clip paths, markers) keeps its name.
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    for colour, token in _TOKENS.items():
        text = text.replace(colour, f"var(--{token})")
    text = re.sub(r"font: ([\d.]+px)[^;\"]*", r"font-size: \1", text)
    view = text.split('viewBox="', 1)[1].split('"', 1)[0]
    head = f'<svg viewBox="{view}" role="img" aria-label="{title}">'
    return re.sub(r"\s*\n\s*", "\n", re.sub(r"<svg[^>]*>", head, text, count=1))


def _settle(canvas: Canvas) -> None:
    """Lays the axes out, to a thousandth of a point: the last bits of the solver's places change from run to run."""
    canvas.draw_without_rendering()
    canvas.set_layout_engine("none")
    for ax in canvas.axes:
        x, y, width, height = (round(part, 6) for part in ax.get_position().bounds)
        ax.set_position((x, y, width, height))
