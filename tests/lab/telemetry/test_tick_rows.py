"""Rows are put together of what comes in any order; each tick is given once, in order, and what is missing is NaN."""

from __future__ import annotations

import numpy as np

from twodof.lab.telemetry_rows import COLUMNS, ONBOARD, PATIENCE_TICKS, PLACES, TickRows

_ALL = np.arange(len(ONBOARD), dtype=np.intp)


def put(rows: TickRows, *ticks: int) -> None:
    """Rows of these ticks, each of whose values is its tick."""
    values = np.repeat(np.array(ticks, dtype=np.float32)[:, None], len(ONBOARD), axis=1)
    rows.onboard(np.array(ticks, dtype=np.uint32), values, _ALL)


def taken(rows: TickRows) -> list[int]:
    found = rows.take()
    return [] if found is None else found[0].tolist()


def test_rows_of_several_messages_are_given_in_order_and_once() -> None:
    rows = TickRows()
    put(rows, 3, 4)
    put(rows, 1, 2)
    ticks, values = rows.take() or (None, None)
    assert ticks is not None
    assert values is not None
    assert ticks.tolist() == [1, 2, 3, 4]
    assert values[:, PLACES["estimate.theta"]].tolist() == [1, 2, 3, 4]
    assert np.isnan(values[:, PLACES["truth.theta"]]).all()
    put(rows, 4, 5)
    assert taken(rows) == [5]
    assert rows.late == 1


def test_the_truth_of_a_tick_is_waited_for_while_it_comes_and_no_longer() -> None:
    rows = TickRows()
    rows.truth(1, (0.1, 0.2, 0.3, 0.4))
    put(rows, 1, 2)
    ticks, values = rows.take() or (None, None)
    assert ticks is not None
    assert values is not None
    assert ticks.tolist() == [1]
    assert values[0, len(ONBOARD) :].tolist() == np.array([0.1, 0.2, 0.3, 0.4], dtype=np.float32).tolist()
    assert values.shape[1] == len(COLUMNS)
    put(rows, *range(3, 2 + PATIENCE_TICKS))
    assert taken(rows) == list(range(2, 2 + PATIENCE_TICKS))  # the truth comes no more


def test_a_drone_that_began_anew_begins_anew_here() -> None:
    rows = TickRows()
    put(rows, 1000)
    assert taken(rows) == [1000]
    put(rows, 0, 1)
    assert taken(rows) == [0, 1]
