"""Tables and look-ups against numpy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import interp1d

from tests.blocks.library.harness import assert_close, few, run, run_y
from twodof.blocks.library import Lookup, Playback, Table
from twodof.errors import DiagramError

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


def test_mistakes_in_arguments_are_refused() -> None:
    for make in (
        lambda: Lookup([0.0, 0.0], [1.0, 2.0]),
        lambda: Lookup([0.0, 1.0], [1.0]),
        lambda: Lookup([0.0], [1.0]),
        lambda: Lookup(outside="wrap"),
        lambda: Table([0.0, "a"], [1.0, 2.0]),
    ):
        with pytest.raises(DiagramError):
            make()
