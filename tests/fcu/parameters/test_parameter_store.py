"""The store: all or none, typed and bounded, and what the wire can carry is what is kept."""

import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twodof.errors import ParameterError, printable
from twodof.fcu.parameters.parameter_store import ParametersChanged, ParameterStore
from twodof.fcu.parameters.table import VehicleParameter, vehicle_rows, wire_rows
from twodof.parameters import FLIGHT_PARAMETERS

pytestmark = pytest.mark.slow

ROWS = {row.name: row for row in wire_rows(1)}
FREE = [row for row in vehicle_rows(1) if not row.fixed]
WRONG: tuple[Any, ...] = (float("nan"), float("inf"), -float("inf"), 1e300, "1", None, True, 10**400)


def values_of(row: VehicleParameter) -> st.SearchStrategy[float]:
    if row.kind == "int32":
        return st.integers(int(row.low), int(row.high))
    return st.floats(row.low, row.high).map(lambda value: min(max(carried(value), row.low), row.high))


def carried(value: float) -> float:
    """The shortest decimal that float32 rounds as it does `value`."""
    return float(str(np.float32(value)))


GOOD = st.sampled_from(FREE).flatmap(
    lambda row: st.tuples(st.sampled_from(sorted({row.name, row.drone or row.name})), values_of(row))
)
BAD = st.one_of(
    st.tuples(st.sampled_from(sorted(ROWS)), st.sampled_from(WRONG)),
    st.tuples(st.sampled_from(sorted(name for name, row in ROWS.items() if row.kind == "int32")), st.just(0.5)),
    st.tuples(st.text(max_size=20).filter(lambda name: name not in ROWS), st.just(1.0)),
)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.lists(GOOD, max_size=4), st.lists(BAD, max_size=2)), max_size=6))
def test_a_change_is_whole_or_nothing(rounds: list[tuple[list[tuple[str, float]], list[tuple[str, Any]]]]) -> None:
    store, heard = ParameterStore(), []
    store.bus.subscribe(ParametersChanged, lambda changed: heard.append(changed.values))
    states = [dict(store)]
    for good, bad in rounds:
        wanted = dict([*good, *bad])
        names = [ROWS[name].of or name for name in wanted if name in ROWS]
        faulty = dict(bad).keys() | (set() if len(set(names)) == len(names) else {"twice"})
        count, revision = len(heard), store.revision
        if faulty:
            with pytest.raises(ParameterError) as raised:
                store.update(wanted)
            assert all(printable(name) in str(raised.value) for name in dict(bad))
            assert (dict(store), store.revision, len(heard)) == (states[-1], revision, count)
            continue
        store.update(wanted)
        expected = states[-1] | {name: value for given_name, value in wanted.items() for name in both_names(given_name)}
        assert dict(store) == expected
        changed = {name: value for name, value in expected.items() if value != states[-1][name]}
        assert heard[count:] == ([changed] if changed else [])
        if changed:
            states.append(expected)


def both_names(name: str) -> set[str]:
    main = ROWS[name].of or name
    return {main} | {row.name for row in ROWS.values() if row.of == main}


@given(st.sampled_from([row for row in FREE if row.kind == "float"]), st.data())
def test_a_decimal_sent_as_float32_is_that_decimal(row: VehicleParameter, data: st.DataObject) -> None:
    """Six digits survive a float32 (IEEE 754: FLT_DIG), so what a person types is what flies."""
    value = float(f"{data.draw(st.floats(row.low, row.high)):.5g}")
    if row.low <= value <= row.high and (abs(value) > 1e-30 or value == 0.0):  # normal numbers of float32
        store = ParameterStore()
        store.update({row.name: float(np.float32(value))})
        assert store[row.name] == value
        revision = store.revision
        store.update({row.name: float(np.float32(store[row.name]))})  # what was read is sent back
        assert store.revision == revision


def test_a_bound_is_reached_over_the_wire_and_not_passed() -> None:
    store = ParameterStore()
    for row in FREE:
        if row.kind == "float":
            for bound, beyond in ((row.low, -np.inf), (row.high, np.inf)):
                sent = np.float32(bound)
                store.update({row.name: float(sent)})
                assert store[row.name] == bound, row.name
                with pytest.raises(ParameterError, match="outside"):
                    store.update({row.name: float(np.nextafter(sent, np.float32(beyond)))})


def test_gains_change_in_flight_and_the_failsafe_does_not() -> None:
    store = ParameterStore()
    store.update({"RATE_KP": 0.05}, armed=True)
    with pytest.raises(ParameterError, match="SAFE_SP_T: is changed only while disarmed"):
        store.update({"RATE_KP": 0.06, "SAFE_SP_T": 0.4}, armed=True)
    assert store["RATE_KP"] == 0.05
    store.update({"SAFE_SP_T": 0.4})
    # A value that it has already is no change.
    store.update({"SAFE_SP_T": 0.4}, armed=True)


@pytest.mark.parametrize("changes", [{}, {"RATE_KP": 0.07, "COM_DL_LOSS_T": 20, "CAL_MAG1_ROT": -1}])
def test_the_hash_is_px4s_over_names_and_values_as_sent(changes: Mapping[str, float]) -> None:
    """CRC-32 over name and value of each, begun with 0 and not inverted at the end."""
    store = ParameterStore(values=changes)
    kinds = {"int32": np.int32, "float": np.float32}
    content = b"".join(row.name.encode() + kinds[row.kind](store[row.name]).tobytes() for row in store.rows)
    assert store.hash_check() == zlib.crc32(content, 0xFFFFFFFF) ^ 0xFFFFFFFF
    assert store.hash_check() != ParameterStore(system=2).hash_check()


def test_what_flies_by_default_is_what_the_flight_code_has() -> None:
    store = ParameterStore(values={"SAFE_WATCH_BITS": 0, "X0_MAX": 0.2})
    flying = store.flying()
    assert flying["failsafe.sensors.watch_bits"] is False
    assert flying["failsafe.safe.x0_limit"] == 0.2
    with pytest.raises(ParameterError, match="X0_MAX"):
        store.update({"X0_MAX": 0.3}, armed=True)
    store.update({"X0_MAX": 0.3})
    assert store["X0_MAX"] == 0.3
    assert len(flying) == len(FLIGHT_PARAMETERS)
