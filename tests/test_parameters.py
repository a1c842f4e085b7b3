"""A parameter set is always whole and valid, and every change can be taken back."""

import json
import re
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twodof.compile.builder import emit_program
from twodof.errors import ParameterError
from twodof.experiment import Laboratory
from twodof.flight.core import core
from twodof.flight.estimator import POSITION_FILTERS
from twodof.parameters import NAME_LENGTH, PARAMETERS, PRESETS, TUNABLES, Parameter, ParameterSet
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow

ROWS = {row.name: row for row in PARAMETERS}
VALID = st.dictionaries(st.sampled_from(sorted(ROWS)), st.floats(0.0, 1.0), min_size=1).map(
    lambda shares: {name: ROWS[name].low + share * (ROWS[name].high - ROWS[name].low) for name, share in shares.items()}
)


def test_names_fit_mavlink() -> None:
    names = [row.name for row in PARAMETERS] + [row.drone for row in PARAMETERS if row.drone]
    assert len(set(names)) == len(names)
    assert all(1 <= len(name.encode()) <= NAME_LENGTH for name in names)
    assert all(row.unit and row.text for row in PARAMETERS)


def test_the_drones_own_names_bounds_and_gains() -> None:
    values = ParameterSet()
    # Facts about the platform: what QGroundControl shows, and the two sets of gains that flew.
    for name, low, high, default in [
        ("FC_PARAM_4", 0.0, 0.12, 0.0854),
        ("FC_PARAM_5", 0.0, 0.5, 0.251),
        ("FC_PARAM_6", 0.0, 0.003, 0.00054),
        ("FC_PARAM_11", 0.0, 15.0, 11.0),
        ("FC_PARAM_13", 0.0, 4.0, 2.4),
        ("FC_PARAM_14", 0.0, 4.0, 2.81),
        ("FC_PARAM_19", 0.0, 2.5, 1.5),
    ]:
        row = values.row(name)
        assert (row.low, row.high, values[name]) == (low, high, default)
    values.update(PRESETS["student"])
    assert (values["RATE_KP"], values["ATT_KP"], values["POS_KP"]) == (0.0651, 6.1986, 0.7)


@given(VALID, st.sampled_from(sorted(ROWS)), st.sampled_from([float("nan"), float("inf"), -1e-9, 1e9, "1", None, True]))
def test_one_wrong_value_changes_nothing(good: dict[str, float], name: str, wrong: object) -> None:
    values = ParameterSet()
    before, revision = values.snapshot(), values.revision
    with pytest.raises(ParameterError, match=f"{name}: .*nothing was changed"):
        values.update({**good, name: wrong})
    assert (values.snapshot(), values.revision) == (before, revision)


def test_every_fault_is_listed() -> None:
    with pytest.raises(ParameterError) as caught:
        ParameterSet().update({"RATE_KP": 5, "NO_SUCH": 1.0, "FC_PARAM_11": 1.0, "ATT_KP": 2.0})
    text = str(caught.value)
    assert "RATE_KP: 5 is outside 0 to 0.12 s/rad" in text
    assert "NO_SUCH: no such parameter; there are RATE_KP" in text
    assert "ATT_KP: given twice" in text


@given(VALID)
def test_json_keeps_every_bit(change: dict[str, float]) -> None:
    values, other = ParameterSet(change), ParameterSet()
    other.load_json(values.to_json())
    assert other.snapshot() == values.snapshot()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("[]", "has no .version.: 1"),
        (json.dumps({"version": 1}), "has no table"),
        (json.dumps({"version": 1, "parameters": {"ATT_KP": 99}}), "99 is outside 0 to 15 1/s"),
        ('{"version": 1, "parameters": {"ATT_KP": NaN}}', "nan is outside"),
    ],
)
def test_foreign_json_changes_nothing(text: str, says: str) -> None:
    values = ParameterSet()
    with pytest.raises(ParameterError, match=says):
        values.load_json(text)
    assert values.revision == 0


def test_readers_see_whole_sets_only() -> None:
    values = ParameterSet({"VEL_KP": 1.0, "VEL_KI": 1.0})
    torn, stop = [], threading.Event()

    def read() -> None:
        while not stop.is_set():
            seen = values.snapshot()
            if seen["VEL_KP"] != seen["VEL_KI"]:
                torn.append(seen)

    reader = threading.Thread(target=read)
    reader.start()
    try:
        for k in range(3000):
            values.update({"VEL_KP": k % 4, "VEL_KI": k % 4})
    finally:
        stop.set()
        reader.join()
    assert torn == []


def test_a_table_is_checked_when_it_is_made() -> None:
    for row, says in [
        (("A" * 17, 0.0, 0.0, 1.0), "1 to 16 ASCII"),
        (("A", 2.0, 0.0, 1.0), "default 2 is outside 0 to 1"),
        (("A", 0.0, 0.0, float("inf")), "must be finite"),
    ]:
        with pytest.raises(ParameterError, match=says):
            Parameter(*row, unit="-", text="")
    twice = (Parameter("A", 0, 0, 1, "-", ""), Parameter("B", 0, 0, 1, "-", "", drone="A"))
    with pytest.raises(ParameterError, match="A: two parameters have the same name"):
        ParameterSet(table=twice)
    with pytest.raises(ParameterError, match="no such parameter"):
        ParameterSet()["B"]


def test_an_equation_reads_every_row() -> None:
    """In the C of some estimator, a line other than a default, the struct and the table names it."""
    emitted = [emit_program(core(position_filter=kind, failsafe=True), PERIOD).source for kind in POSITION_FILTERS]
    read = {name for source in emitted for name in re.findall(r"p->(\w+)\b(?! = )", source)}
    assert [path for path in TUNABLES if path.replace(".", "_") not in read] == []


@pytest.mark.parametrize("name", ["ATT_KP", "cascade.attitude.kp"])
def test_a_simulation_is_tuned_by_name_and_path(name: str) -> None:
    laboratory = Laboratory(tuning={name: 5.0})
    assert laboratory.loop.machine.get("flight.cascade.attitude.kp") == 5.0
    assert laboratory.fly("doublet").log.provenance["parameters"] == {"ATT_KP": 5.0}
    with pytest.raises(ParameterError, match="16 is outside 0 to 15"):
        Laboratory(tuning={name: 16.0})
