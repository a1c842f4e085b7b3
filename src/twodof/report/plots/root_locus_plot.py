"""The root locus as a picture: where the closed loop's poles go when the gain changes, in the s plane."""

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from twodof.design import LoopMargins, root_locus
from twodof.report.plots.canvas import Colours

_GAINS = np.concatenate([[0.0], np.geomspace(0.02, 20.0, 600)])
_DAMPING = (0.2, 0.4, 0.6, 0.8)
_SPEED = 4.0  # of the crossover: how far from 0 the picture goes


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
            ax.annotate(
                f"{crossing.factor:.2g} x the gain",
                (0.0, crossing.omega),
                xytext=(6, 0),
                textcoords="offset points",
                fontsize=8,
                color=colours["bad"],
                va="center",
            )
    soft: dict[str, Any] = {"color": colours["soft"], "linewidth": 0.7, "linestyle": (0, (2, 3))}
    for damping in _DAMPING:
        slope = math.sqrt(1.0 - damping**2) / damping
        far = 2.0 * reach
        ax.plot([-far, 0.0, -far], [far * slope, 0.0, -far * slope], **soft)
        x = min(0.93, 0.93 / slope) * reach
        ax.annotate(f"{damping:g}", (-x, x * slope), fontsize=8, color=colours["soft"], ha="right", va="bottom")
    ax.axvline(0.0, color=colours["soft"], linewidth=0.8)
    ax.axhline(0.0, color=colours["soft"], linewidth=0.8)
    ax.set_xlim(-reach, 0.5 * reach)
    ax.set_ylim(-reach, reach)
    ax.set_aspect("equal", adjustable="box")
    ax.set_title("root locus [rad/s], lines of equal damping", loc="left", fontsize=10)
    ax.set_xlabel("real part [1/s]")
    ax.grid(visible=True)
    # Between the real axis and the branches that leave to the right.
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.28))
