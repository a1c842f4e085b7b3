"""Tables and look-ups against numpy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator, interp1d

from tests.blocks.library.harness import assert_close, few, run, run_y
from twodof.blocks.library import Lookup, Lookup2D, Playback, Table

pytestmark = pytest.mark.slow

DT = 0.01

grids = st.lists(st.integers(-200, 200), min_size=2, max_size=17, unique=True).map(sorted)


@few
@given(grids, st.lists(st.floats(-30, 30), min_size=1, max_size=20), st.integers(0, 9))
def test_a_look_up_is_linear_interpolation(grid: list[int], points: list[float], seed: int) -> None:
    b = [0.1 * g for g in grid]
    v = np.random.default_rng(seed).uniform(-5, 5, len(b)).tolist()
    u = np.array([*points, *b])
    np.testing.assert_allclose(run_y(Lookup(b, v), u), np.interp(u, b, v), rtol=0, atol=1e-12)
    line = interp1d(b, v, fill_value="extrapolate")
    # Up to 30 / 0.1 steps of 10 beyond the end: some thousands, of which rounding leaves 1e-16 each.
    np.testing.assert_allclose(run_y(Lookup(b, v, "extrapolate"), u), line(u), rtol=1e-12, atol=1e-10)


@few
@given(grids, grids, st.integers(0, 9))
def test_a_look_up_in_two_dimensions_is_scipys(rows: list[int], columns: list[int], seed: int) -> None:
    a, b = [0.1 * k for k in rows], [0.3 * k for k in columns]
    rng = np.random.default_rng(seed)
    values = rng.uniform(-5, 5, (len(a), len(b)))
    u = np.concatenate([rng.uniform(a[0], a[-1], 12), a, rng.uniform(-30, 30, 5)])
    w = np.concatenate([rng.uniform(b[0], b[-1], 12), rng.choice(b, len(a)), rng.uniform(-90, 90, 5)])
    judge = RegularGridInterpolator((a, b), values, bounds_error=False, fill_value=None)
    inside = np.stack([np.clip(u, a[0], a[-1]), np.clip(w, b[0], b[-1])], axis=-1)
    clipped = run(Lookup2D(a, b, values.tolist()), len(u), inputs={"u": u, "w": w})["y"]
    np.testing.assert_allclose(clipped, judge(inside), rtol=0, atol=1e-11)
    # Beyond the ends both coordinates may be hundreds of segments away, of which rounding leaves 1e-16 each.
    straight = run(Lookup2D(a, b, values.tolist(), "extrapolate"), len(u), inputs={"u": u, "w": w})["y"]
    far = judge(np.stack([u, w], axis=-1))
    np.testing.assert_allclose(straight, far, rtol=1e-11, atol=1e-13 * np.max(np.abs(far)) + 1e-11)


def test_a_look_up_in_two_dimensions_gives_the_table_at_its_points_and_ends() -> None:
    a, b = [0.1, 0.7, 2.0], [-1.0, 0.3]
    values = [[1.1, 2.2], [3.3, 4.4], [5.5, 6.6]]
    u, w = np.repeat(a, 2), np.tile(b, 3)
    assert run(Lookup2D(a, b, values), 6, inputs={"u": u, "w": w})["y"].tolist() == np.ravel(values).tolist()
    beyond = {"u": np.array([np.inf, -np.inf, np.nan]), "w": np.array([np.inf, -np.inf, 0.0])}
    y = run(Lookup2D(a, b, values), 3, inputs=beyond)["y"]
    assert y[:2].tolist() == [6.6, 1.1]
    assert np.isnan(y[2])


def test_a_look_up_keeps_nan_and_bounds_infinity() -> None:
    y = run_y(Lookup([0.0, 1.0, 3.0], [5.0, 6.0, -1.0]), np.array([np.nan, -np.inf, np.inf]))
    assert np.isnan(y[0])
    assert y[1:].tolist() == [5.0, -1.0]


@few
@given(st.lists(st.integers(0, 60), min_size=2, max_size=9, unique=True).map(sorted))
def test_a_table_holds_or_interpolates(ticks: list[int]) -> None:
    times = [k * DT for k in ticks]
    values = np.random.default_rng(len(ticks)).standard_normal(len(ticks))
    k = np.arange(70)
    held = run(Table(times, values.tolist()), 70, DT)["y"]
    index = np.clip(np.searchsorted(ticks, k, side="right") - 1, 0, None)
    assert held.tolist() == values[index].tolist()
    line = run(Table(times, values.tolist(), "linear"), 70, DT)["y"]
    assert_close(line, np.interp(k, ticks, values))


def test_two_times_within_a_tick_take_the_later_value() -> None:
    for method in ("hold", "linear"):
        y = run(Table([0.02, 0.021, 0.05], [1.0, 2.0, 5.0], method), 6, DT)["y"]
        assert_close(y[[0, 1, 2, 5]], [1.0, 1.0, 2.0, 5.0])


def test_playback_holds_each_value_and_then_the_last() -> None:
    block = Playback([1.0, 2.0, 3.0], 2 * DT, start=3 * DT)
    assert run(block, 12, DT)["y"].tolist() == [1, 1, 1, 1, 1, 2, 2, 3, 3, 3, 3, 3]
    again = Playback([1.0, 2.0, 3.0], 2 * DT, start=3 * DT, repeat=True)
    assert run(again, 12, DT)["y"].tolist() == [1, 1, 1, 1, 1, 2, 2, 3, 3, 1, 1, 2]
