"""Assertions over time, against their meaning written out tick by tick."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twodof.compile.diagram_test import assertion
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow

DT = 0.25  # exact in binary, so that times can be compared as they stand
VALUES = st.lists(st.sampled_from([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, math.nan, math.inf]), min_size=9, max_size=9)
LIMIT = st.sampled_from([-1.0, -0.5, 0.0, 0.5, 1.0])
TIMES = st.integers(0, 16).map(lambda eighth: eighth * 0.125)
Holds = Callable[[float], bool]


def first_wrong(values: Sequence[float], holds: Holds, start: float, stop: float) -> int | None:
    """The first tick from `start` to `stop` [s] at which the value does not hold."""
    for k, value in enumerate(values):
        if start <= k * DT <= stop and not holds(value):
            return k
    return None


@settings(max_examples=50)
@given(VALUES, LIMIT, LIMIT, st.tuples(TIMES, TIMES).map(sorted), st.integers(0, 3))
def test_what_stays_within_limits_does_so_at_each_tick(
    values: list[float], a: float, b: float, times: list[float], form: int
) -> None:
    low, high = min(a, b), max(a, b)
    claims: list[tuple[str, Holds]] = [
        (f"y never above {a}", lambda v: v <= a),
        (f"y never below {a}", lambda v: v >= a),
        (f"y always within [{low}, {high}]", lambda v: low <= v <= high),
        (f"y always equals {a}", lambda v: v == a),
    ]
    text, holds = claims[form]
    start, stop = times
    for when, first, last in (
        ("", 0.0, 2.0),
        (f" between {start} and {stop} s", start, stop),
        (f" from {start}", start, 2.0),
        (f" until {stop} s", 0.0, stop),
    ):
        meant = assertion(text + when)
        if not any(first <= k * DT <= last for k in range(9)):
            with pytest.raises(DiagramError, match="no tick is within these times"):
                meant.judge(np.array(values), DT)
            continue
        found = meant.judge(np.array(values), DT)
        wrong = first_wrong(values, holds, first, last)
        assert (found.passed, found.tick) == (wrong is None, wrong)
        if wrong is not None and not math.isnan(values[wrong]):
            assert found.value == values[wrong]
            assert found.by == abs(values[wrong] - found.limit)


@pytest.mark.parametrize("text", ["A[0,1] always within[-1,1]", "A [ 0 , 1 ]  always within [ -1 , 1 ] from 0"])
def test_blanks_beside_brackets_and_commas_do_not_matter(text: str) -> None:
    meant = assertion(text)
    assert (meant.signal, meant.verb, meant.low, meant.high) == ("A[0, 1]", "always", -1.0, 1.0)


@settings(max_examples=50)
@given(VALUES, LIMIT, st.sampled_from([0.0, 0.5, 1.0]), TIMES)
def test_settled_is_within_the_band_from_then_on(values: list[float], aim: float, band: float, by: float) -> None:
    found = assertion(f"y settles within {band} of {aim} by {by} s").judge(np.array(values), DT)
    wrong = first_wrong(values, lambda v: abs(v - aim) <= band, by, math.inf)
    assert (found.passed, found.tick) == (wrong is None, wrong)
    if found.passed:  # and it says since when
        inside = [abs(v - aim) <= band for v in values]
        since = next(k for k in range(9) if all(inside[k:]))
        assert found.text == f"settled at {since * DT:.6g} s"
    last = assertion(f"y final value within {band} of {aim}").judge(np.array(values), DT)
    assert last.passed == (abs(values[-1] - aim) <= band)


@settings(max_examples=50)
@given(VALUES, LIMIT, TIMES.filter(bool), st.booleans())
def test_what_rises_begins_below_and_is_there_in_time(
    values: list[float], aim: float, before: float, rising: bool
) -> None:
    word = "rises" if rising else "falls"
    found = assertion(f"y {word} to {aim} before {before}").judge(np.array(values), DT)
    there = [v >= aim if rising else v <= aim for v in values]
    begins = values[0] < aim if rising else values[0] > aim
    in_time = any(there[k] for k in range(9) if k * DT < before)
    assert found.passed == (begins and in_time)
    if found.passed:
        assert found.text == f"at {there.index(True) * DT:.6g} s"


def test_a_time_of_decimal_fractions_is_the_tick_that_is_meant() -> None:
    """.3 s / 4 ms is 74.99999999999999 in binary; tick 75 is meant, the first at or after and the last until it."""
    values = np.zeros(251)
    values[75] = 1.0
    assert assertion("y never above .5 from .3").judge(values, 0.004).tick == 75
    assert assertion("y never above .5 until .3").judge(values, 0.004).tick == 75
    assert assertion("y never above .5 until .299").judge(values, 0.004).passed
    assert not assertion("y rises to 1 before .3").judge(values, 0.004).passed
    assert assertion("y rises to 1 before .304").judge(values, 0.004).passed


def test_a_failure_says_when_and_by_how_much() -> None:
    values = np.array([0.0, 0.6, 0.9, 0.0])
    found = assertion("y never above 0.5").judge(values, DT)
    assert (found.tick, found.time, found.value, found.limit) == (1, 0.25, 0.6, 0.5)
    assert (
        found.text == "0.6 at 0.25 s is above 0.5 by 0.1; 2 ticks in all, the worst: 0.9 at 0.5 s is above 0.5 by 0.4"
    )
    short = assertion("y rises to 1 before 1").judge(values, DT)
    assert short.text == "it comes to 0.9, 0.1 short of 1"


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("y is small", "not an assertion"),
        ("y never above", "not an assertion"),
        ("never above 3", "not an assertion"),
        ("y never above 3 by 2", "not an assertion"),
        ("y never above __import__", "not an assertion"),
        ("y never above 1e999", "too large"),
        ("y always within [1, -1]", "no value is within"),
        ("y settles within -1 of 0 by 1", "no value is within"),
        ("y never above 1 between 2 and 1", "not in order"),
        ("y settles within 1 of 0 by -1", "not in order"),
    ],
)
def test_what_is_not_an_assertion_is_refused(text: str, what: str) -> None:
    with pytest.raises(DiagramError, match=what):
        assertion(text)


def test_a_claim_about_a_time_after_the_end_is_a_mistake() -> None:
    for text in ("y never above 1 until 3", "y settles within 1 of 0 by 1e308", "y rises to 1 before 3"):
        with pytest.raises(DiagramError, match="ends"):
            assertion(text).judge(np.zeros(5), DT)
