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
from twodof.models.lti import DelayedStateSpace
from twodof.report.plots.canvas import Colours, write_figure

Array = NDArray[np.float64]

_COLOURS = ("ink", "grey-box", "input", "simple", "paper", "measured", "bad")
_POINTS = 1500
_DPI = 130
_STEP_S, _STEPS = 12.0, 4000  # of the step response: the longest time, and the most samples
_GAINS = np.concatenate([[0.0], np.geomspace(0.02, 20.0, 600)])
_DAMPING = (0.2, 0.4, 0.6, 0.8)
_SPEED = 4.0  # range of the root locus, in crossovers


def write_loop_plot(
    loops: Mapping[str, LoopTransfer], path: str | Path, title: str = "", overwrite: bool = False
) -> None:
    """Draw the loops into a .png, .svg or .pdf file, whole or not at all. Raises LogError as `write_figure`."""
    write_figure(path, overwrite, title, _DPI, lambda colours: _drawn(loops, title, colours))


def _drawn(loops: Mapping[str, LoopTransfer], title: str, colours: Colours) -> Canvas:
    # One loop alone has room for its root locus: of several nobody could tell the branches apart.
    alone = len(loops) == 1 and not next(iter(loops.values())).delay
    canvas = Canvas(figsize=(18.0 if alone else 13.0, 8.2), layout="constrained")
    kinds = [["gain", "nyquist", "sensitivity"], ["phase", "nichols", "step"]]
    mosaic: list[Any] = [[*row, "locus"] for row in kinds] if alone else list(kinds)
    panels = canvas.subplot_mosaic(mosaic)
    axes = [[panels[kind] for kind in row] for row in kinds]
    gain, nyquist, sensitivity = axes[0]
    phase, nichols, step = axes[1]
    found = {name: margins(loop) for name, loop in loops.items()}
    low, high = _span(found)
    for (name, m), colour in zip(found.items(), (colours[c] for c in _COLOURS * len(found)), strict=False):
        end = high if m.loop.dt is None else min(high, math.pi / m.loop.dt)
        omega, size, angle = bode_at(m, np.geomspace(low, end, _POINTS))
        response = m.loop.response(omega)
        angle = np.degrees(angle)
        label = name if m.stable else f"{name} (unstable)"
        gain.semilogx(omega, size, color=colour, label=label)
        phase.semilogx(omega, angle, color=colour)
        nyquist.plot(response.real, response.imag, color=colour)
        nichols.plot(angle, size, color=colour)
        one = 1.0 / (1.0 + response)
        sensitivity.loglog(omega, np.abs(one), color=colour)
        sensitivity.loglog(omega, np.abs(1.0 - one), color=colour, linestyle=(0, (4, 2)))
        if m.phases:
            for ax, x, y in ((gain, m.crossover, 0.0), (phase, m.crossover, -180.0 + m.phase_margin_deg)):
                ax.plot([x], [y], "o", color=colour, markersize=4.5)
            nichols.plot([-180.0 + m.phase_margin_deg], [0.0], "o", color=colour, markersize=4.5)
        if m.stable:
            time, values = step_response(m)
            step.semilogx(time[1:], values[1:], color=colour)
    _finish(axes, colours, low, high)
    if alone:
        draw_root_locus(panels["locus"], next(iter(found.values())), colours)
    gain.legend(loc="lower left")
    if title:
        canvas.suptitle(title, x=0.01, ha="left", fontsize=12, color=colours["ink"])
    return canvas


def _span(found: Mapping[str, LoopMargins]) -> tuple[float, float]:
    places = [m.crossover for m in found.values() if m.phases] or [1.0]
    return 0.05 * min(places), max(30.0 * max(places), 100.0)


def step_response(m: LoopMargins) -> tuple[Array, Array]:
    """Return (time [s], value) of T after a unit step: how the loop follows its set-point.

    A continuous loop is sampled at a hundredth of its crossover's period.
    """
    loop = m.loop
    speed = m.crossover if m.phases else 1.0
    end = min(_STEP_S, 25.0 / speed)
    if loop.dt is None:
        dt = max(0.06 / speed, end / _STEPS)
        from_continuous = _sampled(loop, dt)
    else:
        dt, from_continuous = loop.dt, loop
    steps = max(2, min(_STEPS, round(end / dt)))
    x, values = np.zeros(len(from_continuous.a)), np.empty(steps)
    b, c, d = from_continuous.b[:, 0], from_continuous.c[0], from_continuous.d
    for k in range(steps):
        values[k] = (c @ x + d) / (1.0 + d)
        x = from_continuous.a @ x + b * (1.0 - values[k])
    return np.asarray(dt * np.arange(steps)), values


def _sampled(loop: LoopTransfer, dt: float) -> LoopTransfer:
    model = DelayedStateSpace.of(loop.a, loop.b, loop.c, [[loop.d]], loop.delay)
    return LoopTransfer.of(model.zero_order_hold(dt))


def _finish(axes: Any, colours: Colours, low: float, high: float) -> None:
    gain, nyquist, sensitivity = axes[0]
    phase, nichols, step = axes[1]
    soft: dict[str, Any] = {"color": colours["soft"], "linewidth": 0.8}
    range_ = {"xlabel": "frequency [rad/s]", "xlim": (low, high)}
    turns = range(-360, 31, 90)
    # Axes, title, settings, and the height of a line, if there is one.
    rows: tuple[tuple[Axes, str, dict[str, Any], float | None], ...] = (
        (gain, "Bode: |L| [dB]", {**range_, "ylim": (-60.0, 60.0)}, 0.0),
        (phase, "Bode: phase of L [deg]", {**range_, "ylim": (-400.0, 30.0), "yticks": turns}, -180.0),
        (nyquist, "Nyquist: imaginary part of L", {"xlabel": "real part of L", "ylim": (-2.0, 2.0)}, None),
        (nichols, "Nichols: |L| [dB]", {"xlabel": "phase of L [deg]", "ylim": (-40.0, 40.0), "xticks": turns}, None),
        (sensitivity, "|S| solid, |T| dashed", {**range_, "ylim": (0.01, 10.0)}, 1.0),
        (step, "step response of T", {"xlabel": "time after the step [s]"}, 1.0),
    )
    cross: dict[str, Any] = {"color": colours["bad"], "markersize": 11, "markeredgewidth": 1.6}
    for ax, title, settings, line in rows:
        ax.set_title(title, loc="left", fontsize=10)
        ax.set(**settings)
        ax.grid(visible=True)
        if line is not None:
            ax.axhline(line, **soft)
    for axis in (gain.xaxis, phase.xaxis, sensitivity.xaxis, sensitivity.yaxis, step.xaxis):
        axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    _circle(nyquist, 0.0, 1.0, soft)
    nyquist.plot([-1.0], [0.0], "+", **cross)
    nyquist.set_xlim(-2.9, 1.8)
    nyquist.set_aspect("equal", adjustable="box")
    nichols.plot([-180.0], [0.0], "+", **cross)
    for peak, below in ((3.0, True), (6.0, False)):
        _sensitivity_contour(nichols, peak, below, soft)
    nichols.set_xlim(-360.0, 0.0)


def _circle(ax: Axes, centre: float, radius: float, look: Mapping[str, Any]) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    ax.plot(centre + radius * np.cos(angle), radius * np.sin(angle), linestyle=(0, (2, 2)), **look)


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
    """Draw the poles for .02 to 20 times the gain, those of the loop itself, and lines of equal damping.

    A sampled loop's poles are drawn as z = e^(sT), so the axes are those of the s plane [rad/s] for both.
    """
    z = root_locus(found.loop, _GAINS)
    dt = found.loop.dt
    # A pole at z = 0, of a delay, has no place in the s plane.
    branches = z if dt is None else np.log(np.where(z == 0.0, np.nan, z)) / dt
    reach = _SPEED * (found.crossover if found.phases else 1.0)
    if dt is not None:
        reach = min(reach, math.pi / dt)
    # Where a branch jumps, from the upper half to the lower one, the line is broken.
    jump = np.abs(np.diff(branches, axis=0)) > 0.5 * reach
    lines = branches.copy()
    lines[1:][jump] = np.nan
    for j in range(lines.shape[1]):
        ax.plot(lines[:, j].real, lines[:, j].imag, color=colours["input"], linewidth=1.3)
    ax.plot(branches[0].real, branches[0].imag, "x", color=colours["soft"], markersize=6, label="open loop")
    now = found.poles_rad
    ax.plot(now.real, now.imag, "s", color=colours["ink"], markersize=4.5, label="closed loop")
    for crossing in (found.increase, found.decrease):
        if crossing is not None and 0.0 < crossing.omega < reach:
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
    ax.axvline(0.0, color=colours["soft"], linewidth=0.8)
    ax.axhline(0.0, color=colours["soft"], linewidth=0.8)
    ax.set(xlim=(-reach, 0.5 * reach), ylim=(-reach, reach), xlabel="real part [1/s]")
    ax.set_aspect("equal", adjustable="box")
    ax.set_title("root locus [rad/s], lines of equal damping", loc="left", fontsize=10)
    ax.grid(visible=True)
    # Between the real axis and the branches that leave to the right.
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.28))
