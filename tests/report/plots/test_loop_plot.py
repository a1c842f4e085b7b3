"""The root locus in the picture of one loop: its branches cross the axis where the margins say."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from twodof.design import LoopTransfer, margins
from twodof.design.own_loop import read_rational
from twodof.report.plots.canvas import on_paper
from twodof.report.plots.loop_plot import draw_root_locus, write_loop_plot
from twodof.sim.linear import cascade_loop

pytestmark = pytest.mark.slow

CUBIC = LoopTransfer(
    np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -2.0, -3.0]]), np.eye(3)[:, 2:], np.eye(3)[:1], 0.0
)
"""1 / (s (s + 1) (s + 2)): by Routh the poles are on the axis at 6 times the gain, at sqrt 2 rad/s."""


def test_branches_cross_where_routh_says() -> None:
    ax = Figure().subplots()
    draw_root_locus(ax, margins(CUBIC), on_paper())
    assert [text.get_text() for text in ax.texts if "gain" in text.get_text()] == ["6 x the gain"]
    drawn = [line.get_xydata() for line in ax.lines]
    branches = np.concatenate([one for one in drawn if len(one) > 100])
    near = branches[np.abs(branches[:, 0]) < 0.01]
    # 600 gains from .02 to 20: a step is 1.2 % of the gain, .004 rad/s along the branch
    assert np.abs(np.abs(near[:, 1]) - np.sqrt(2.0)).min() < 0.01
    # a branch leaves every open-loop pole: 0, -1, -2
    start = branches[np.isfinite(branches).all(axis=1)]
    for pole in (0.0, -1.0, -2.0):
        assert np.hypot(start[:, 0] - pole, start[:, 1]).min() < 0.02
    assert ax.get_xlim()[0] < -2.0  # and all of them are in the frame


def test_zeros_are_drawn_where_branches_end() -> None:
    loop, ax = read_rational("(s + 2) (s + 3) / ((s + 1) (s^2 + 2 s + 5))").transfer("loop", None), Figure().subplots()
    draw_root_locus(ax, margins(loop), on_paper())
    (zeros,) = [line.get_xydata() for line in ax.lines if line.get_label() == "zeros"]
    assert np.sort(zeros[:, 0]) == pytest.approx([-3.0, -2.0])
    assert zeros[:, 1] == pytest.approx([0.0, 0.0], abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("loop", ["rate", "motors"])
def test_the_picture_of_one_loop_is_wider(loop: str, tmp_path: Path) -> None:
    found = cascade_loop(loop)
    for name, loops in (("one", {loop: found}), ("two", {loop: found, "again": found})):
        write_loop_plot(loops, tmp_path / f"{name}.svg", name)
    one, two = ((tmp_path / f"{name}.svg").read_text() for name in ("one", "two"))
    assert one.count('id="axes_') == 8  # the poles around 0 have a frame of their own in the root locus
    assert two.count('id="axes_') == 6
