"""Pictures of loops: Bode, Nyquist, Nichols, both sensitivities, step response, and the root locus of one loop."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from twodof.design import LoopMargins, LoopTransfer, margins, root_locus
from twodof.design.margins import bode_at
from twodof.design.own_loop import DELAY_STEPS, held, speed_of, step_response
from twodof.report.plots.canvas import Colours, write_figure

Array = NDArray[np.float64]

_COLOURS = ("ink", "grey-box", "input", "simple", "paper", "measured", "bad")
_POINTS = 1500
_DPI = 130
_FEW = 12
_BLOT = 0.06  # poles this near to 0, in heights of the root locus, have a frame of their own
_DAMPING = (0.2, 0.4, 0.6, 0.8)
_SPEED = 4.0  # range of the root locus, in crossovers


PANELS = {
    "all": [["gain", "nyquist", "sensitivity"], ["phase", "nichols", "step"]],
    "bode": [["gain"], ["phase"]],
    "step": [["step"]],
    "rlocus": [["locus"]],
}
"""Panels of each picture, row by row; of one loop alone "all" has its root locus too."""

_SIZES = {"all": (13.0, 8.2), "bode": (8.0, 6.4), "step": (8.0, 4.4), "rlocus": (7.2, 7.2)}


def write_loop_plot(
    loops: Mapping[str, LoopTransfer], path: str | Path, title: str = "", overwrite: bool = False, picture: str = "all"
) -> None:
    """Draw the loops into a .png, .svg or .pdf file, whole or not at all; `picture` is a name of `PANELS`.

    A root locus is of one loop: the first. Raises LogError as `write_figure`.
    """
    write_figure(path, overwrite, title, _DPI, lambda colours: _drawn(loops, title, picture, colours))


def _drawn(loops: Mapping[str, LoopTransfer], title: str, picture: str, colours: Colours) -> Canvas:
    mosaic: Any = PANELS[picture]
    width, height = _SIZES[picture]
    if picture == "all" and len(loops) == 1:  # of several nobody could tell the branches apart
        mosaic, width = [[*row, "locus"] for row in mosaic], 18.0
    canvas = Canvas(figsize=(width, height), layout="constrained")
    panels: dict[str, Axes] = canvas.subplot_mosaic(mosaic)
    found = {name: margins(loop) for name, loop in loops.items()}
    low, high = _span(found)
    for (name, m), colour in zip(found.items(), (colours[c] for c in _COLOURS * len(found)), strict=False):
        end = high if m.loop.dt is None else min(high, math.pi / m.loop.dt)
        omega, size, phase = bode_at(m, np.geomspace(low, end, _POINTS))
        response, angle = m.loop.response(omega), np.degrees(phase)
        label = name if m.stable else f"{name} (unstable)"
        if "gain" in panels:
            panels["gain"].semilogx(omega, size, color=colour, label=label)
            panels["phase"].semilogx(omega, angle, color=colour)
            draw_margins(panels["gain"], panels["phase"], m, colour, labelled=len(found) == 1)
        if "nyquist" in panels:
            panels["nyquist"].plot(response.real, response.imag, color=colour)
            panels["nichols"].plot(angle, size, color=colour)
            one = 1.0 / (1.0 + response)
            panels["sensitivity"].loglog(omega, np.abs(one), color=colour)
            panels["sensitivity"].loglog(omega, np.abs(1.0 - one), color=colour, linestyle=(0, (4, 2)))
            if m.phases:
                panels["nichols"].plot([-180.0 + m.phase_margin_deg], [0.0], "o", color=colour, markersize=4.5)
        if m.stable and "step" in panels:
            time, values = step_response(m)
            panels["step"].plot(time, values, color=colour, label=name)
    _finish(panels, colours, low, high)
    if "locus" in panels:
        draw_root_locus(panels["locus"], next(iter(found.values())), colours)
    for name in ("gain", "step"):
        if name in panels and (name == "gain" or picture == "step") and (len(found) > 1 or picture == "all"):
            panels[name].legend(loc="lower left" if name == "gain" else "lower right")
    if title:
        canvas.suptitle(title, x=0.01, ha="left", fontsize=12, color=colours["ink"])
    return canvas


def _span(found: Mapping[str, LoopMargins]) -> tuple[float, float]:
    """Return the range of frequencies: around the crossovers and the frequencies of the gain margins."""
    places = [m.crossover for m in found.values() if m.phases]
    places += [g.omega for m in found.values() for g in (m.increase,) if g is not None and 0.0 < g.omega < math.inf]
    places = places or [speed_of(m) for m in found.values()]
    ends = [math.inf if m.loop.dt is None else math.pi / m.loop.dt for m in found.values()]
    return 0.03 * min(places), min(30.0 * max(places), max(ends))


def draw_margins(gain: Axes, phase: Axes, m: LoopMargins, colour: str, labelled: bool = True) -> None:
    """Mark gain margins from 0 dB, and the phase margin from -180 deg, each at its frequency, with their sizes."""
    line: Any = {"color": colour, "linewidth": 2.4, "solid_capstyle": "butt", "alpha": 0.55}
    thin: Any = {"color": colour, "linewidth": 0.8, "linestyle": (0, (2, 2))}
    box = {"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1.0}
    text: Any = {"textcoords": "offset points", "fontsize": 8.5, "color": colour, "va": "center", "bbox": box}
    text["xytext"] = (6, 0)
    for crossing in (m.increase, m.decrease):
        if crossing is None or not 0.0 < crossing.omega < math.inf:
            continue
        at, size = crossing.omega, -20.0 * math.log10(crossing.factor)
        gain.plot([at, at], [0.0, size], **line)
        gain.plot([at], [size], "o", color=colour, markersize=4.5)
        phase.axvline(at, **thin)
        if labelled:
            gain.annotate(f"{-size:.1f} dB at {at:.3g} rad/s", (at, 0.5 * size), **text)
    if m.phases:
        at, angle = m.crossover, -180.0 + m.phase_margin_deg
        phase.plot([at, at], [-180.0, angle], **line)
        phase.plot([at], [angle], "o", color=colour, markersize=4.5)
        gain.plot([at], [0.0], "o", color=colour, markersize=4.5)
        gain.axvline(at, **thin)
        if labelled:
            text |= {"xytext": (-6, 0), "ha": "right"}
            phase.annotate(f"{m.phase_margin_deg:.1f} deg at {at:.3g} rad/s", (at, 0.5 * (angle - 180.0)), **text)


def _finish(panels: Mapping[str, Axes], colours: Colours, low: float, high: float) -> None:
    soft: dict[str, Any] = {"color": colours["soft"], "linewidth": 0.8}
    range_ = {"xlabel": "frequency [rad/s]", "xlim": (low, high)}
    # Panel, title, settings, and the height of a line, if there is one.
    rows: tuple[tuple[str, str, dict[str, Any], float | None], ...] = (
        ("gain", "Bode: |L| [dB]", range_, 0.0),
        ("phase", "Bode: phase of L [deg]", range_, -180.0),
        ("nyquist", "Nyquist: imaginary part of L", {"xlabel": "real part of L", "ylim": (-2.0, 2.0)}, None),
        (
            "nichols",
            "Nichols: |L| [dB]",
            {"xlabel": "phase of L [deg]", "ylim": (-40.0, 40.0), "xticks": range(-360, 31, 90)},
            None,
        ),
        ("sensitivity", "|S| solid, |T| dashed", {**range_, "ylim": (0.01, 10.0)}, 1.0),
        ("step", "step response of T", {"xlabel": "time after the step [s]"}, 1.0),
    )
    for name, title, settings, line in rows:
        if name in panels:
            ax = panels[name]
            ax.set_title(title, loc="left", fontsize=10)
            ax.set(**settings)
            ax.grid(visible=True)
            if line is not None:
                ax.axhline(line, **soft)
    if "gain" in panels:
        _in_steps(panels["gain"], 20.0, -100.0, 80.0)
        _in_steps(panels["phase"], 90.0, -450.0, 180.0)
    scales = [panels[name].xaxis for name in ("gain", "phase", "sensitivity") if name in panels]
    for axis in (*scales, *([panels["sensitivity"].yaxis] if "sensitivity" in panels else [])):
        axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    if "step" in panels:
        panels["step"].set_xlim(left=0.0)
    if "nyquist" in panels:
        nyquist, nichols = panels["nyquist"], panels["nichols"]
        cross: dict[str, Any] = {"color": colours["bad"], "markersize": 11, "markeredgewidth": 1.6}
        angle = np.linspace(0.0, 2.0 * np.pi, 200)
        nyquist.plot(np.cos(angle), np.sin(angle), linestyle=(0, (2, 2)), **soft)
        nyquist.plot([-1.0], [0.0], "+", **cross)
        nyquist.set_xlim(-2.9, 1.8)
        nyquist.set_aspect("equal", adjustable="box")
        nichols.plot([-180.0], [0.0], "+", **cross)
        for peak, below in ((3.0, True), (6.0, False)):
            _sensitivity_contour(nichols, peak, below, soft)
        nichols.set_xlim(-360.0, 0.0)


def _in_steps(ax: Axes, step: float, least: float, most: float) -> None:
    """Let the axis reach from one whole step to another around the curves, within limits."""
    low, high = ax.dataLim.intervaly
    low, high = max(least, step * math.floor(low / step)), min(most, step * math.ceil(high / step))
    ax.set(ylim=(low, high), yticks=np.arange(low, high + 0.5 * step, step * max(1, round((high - low) / step / 8))))


def _sensitivity_contour(ax: Axes, peak: float, below: bool, look: Mapping[str, Any]) -> None:
    """Draw the contour of |S| = `peak` [dB]: a circle about -1 with the radius 1 / |S|; labelled at one end."""
    l = -1.0 + np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 400)) / 10.0 ** (peak / 20.0)
    angle = np.degrees(np.angle(l)) % 360.0 - 360.0
    size = 20.0 * np.log10(np.abs(l))
    ax.plot(angle, size, linestyle=(0, (2, 2)), **look)
    end = int(np.argmin(size) if below else np.argmax(size))
    place = float(angle[end]), float(size[end])
    aligned: Any = {"ha": "center", "va": "top" if below else "bottom"}
    ax.annotate(f"|S| {peak:g} dB", place, fontsize=8, color=look["color"], **aligned)


def draw_root_locus(ax: Axes, found: LoopMargins, colours: Colours) -> None:
    """Draw the poles for .02 to 20 times the gain or past the margin, those of the loop, and lines of equal damping.

    A sampled loop's poles are drawn as z = e^(sT), so the axes are those of the s plane [rad/s] for both. A continuous
    delay is sampled, finely. Poles that would be a blot at 0 have a frame of their own.
    """
    loop = found.loop
    if loop.delay:
        loop = held(loop, max(0.01 / speed_of(found), loop.delay / DELAY_STEPS))
    # Few states cost little: more gains draw a branch sharply where it leaves the real axis.
    most = max(20.0, 1.5 * found.increase.factor if found.increase is not None else 0.0)
    gains = np.append(0.0, np.geomspace(0.02, most, 600 if len(loop.a) > _FEW else 4000))
    z, dt = root_locus(loop, gains), loop.dt
    # A pole at z = 0, of a delay, has no place in the s plane.
    branches = _continuous(z, dt)
    zeros = _continuous(_zeros(loop), dt)
    reach = _reach(found, np.append(branches[0], zeros))
    _draw_branches(ax, found, branches, reach, colours)
    ax.plot(zeros.real, zeros.imag, "o", color=colours["soft"], markersize=6, fillstyle="none", label="zeros")
    for crossing in (found.increase, found.decrease):
        if crossing is not None and 0.1 * reach < crossing.omega < reach:
            ax.plot([0.0, 0.0], [crossing.omega, -crossing.omega], "o", color=colours["bad"], markersize=5)
            beside: Any = {"xytext": (6, 0), "textcoords": "offset points", "fontsize": 8, "va": "center"}
            says = f"{crossing.factor:.2g} x the gain"
            ax.annotate(says, (0.0, crossing.omega), color=colours["bad"], **beside)
    soft: dict[str, Any] = {"color": colours["soft"], "linewidth": 0.7, "linestyle": (0, (2, 3))}
    for damping in _DAMPING:
        slope = math.sqrt(1.0 - damping**2) / damping
        far = 2.0 * reach
        ax.plot([-far, 0.0, -far], [far * slope, 0.0, -far * slope], **soft)
        x = min(0.93, 0.93 / slope) * reach
        ax.annotate(f"{damping:g}", (-x, x * slope), fontsize=8, color=colours["soft"], ha="right", va="bottom")
    ax.set_xlabel("real part [1/s]")
    ax.set_title("root locus [rad/s], lines of equal damping", loc="left", fontsize=10)
    # Between the real axis and the branches that leave to the right.
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.28))
    sizes = np.abs(np.concatenate([branches[0], found.poles_rad]))
    slow = sizes[(sizes > 1e-6 * reach) & (sizes < _BLOT * reach)]
    if slow.size > 2:
        inset = ax.inset_axes((0.09, 0.05, 0.34, 0.34))
        _draw_branches(inset, found, branches, 1.6 * float(slow.max()), colours)
        inset.tick_params(labelsize=7)
        inset.set_title("around 0", loc="left", fontsize=8)


def _continuous(z: Any, dt: float | None) -> Any:
    """Return roots of z in the s plane, where those at 0 have no place; of a continuous loop they are there."""
    return z if dt is None else np.log(np.where(z == 0.0, np.nan, z)) / dt


def _zeros(loop: LoopTransfer) -> Any:
    """Return the finite zeros: where the system matrix of A, B, C and D loses its rank."""
    from scipy.linalg import eigvals  # imported late: most commands start without it

    matrix = np.block([[loop.a, loop.b], [loop.c, np.array([[loop.d]])]])
    rates = np.diag([*np.ones(len(loop.a)), 0.0])
    found = eigvals(matrix, rates)
    # Those at infinity come out as very large numbers.
    return found[np.isfinite(found) & (np.abs(found) < 1e6 * (1.0 + np.abs(loop.a).max()))]


def _reach(found: LoopMargins, roots: Any) -> float:
    """Return half the height of the frame: it holds crossover, margins, the slower poles and zeros of the open loop."""
    speed = speed_of(found)
    places = [speed, *(g.omega for g in (found.increase,) if g is not None and 0.0 < g.omega < math.inf)]
    near = np.abs(np.concatenate([roots, found.poles_rad]))
    places += near[np.isfinite(near) & (near < _SPEED * max(places))].tolist()
    reach = 1.3 * max(places)
    return reach if found.loop.dt is None else min(reach, math.pi / found.loop.dt)


def _draw_branches(ax: Axes, found: LoopMargins, branches: Any, reach: float, colours: Colours) -> None:
    """Draw branches and poles in a frame from -`reach` to half of it, and the axes through 0."""
    # Where a branch jumps, from the upper half to the lower one, the line is broken.
    jump = np.abs(np.diff(branches, axis=0)) > 0.5 * reach
    lines = branches.copy()
    lines[1:][jump] = np.nan
    for j in range(lines.shape[1]):
        ax.plot(lines[:, j].real, lines[:, j].imag, color=colours["input"], linewidth=1.3)
    ax.plot(branches[0].real, branches[0].imag, "x", color=colours["soft"], markersize=6, label="open loop")
    now = found.poles_rad
    ax.plot(now.real, now.imag, "s", color=colours["ink"], markersize=4.5, label="closed loop")
    ax.axvline(0.0, color=colours["soft"], linewidth=0.8)
    ax.axhline(0.0, color=colours["soft"], linewidth=0.8)
    ax.set(xlim=(-reach, 0.5 * reach), ylim=(-reach, reach))
    ax.set_aspect("equal", adjustable="box")
    ax.grid(visible=True)
