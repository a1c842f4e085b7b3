"""Names of an enumeration's members in tests of a diagram: in inputs, parameters, assertions and tables."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.compile.typed_signals import enumerated
from twodof.compile.diagram_test.run_scenarios import run_scenarios
from twodof.compile.diagram_test.scenario_file import read_scenarios
from twodof.errors import DiagramError

TEST = """
dt = 0.1
[[test]]
name = "arming"
duration = 0.3
inputs.number = 1
inputs.go = true
inputs.asked = "broken"
parameters.logic.after = "idle"
checks = ["mode always equals {first} until 0", "logic.light final value within 0 of green"]
[test.table]
columns = ["time", "mode"]
rows = [[0.0, "flying"], [0.1, "{second}"]]
between = "hold"
absolute = 0
"""


def outcome(tmp_path: Path, first: str = "flying", second: str = "idle") -> str:
    file = tmp_path / "t.toml"
    file.write_text(TEST.format(first=first, second=second), encoding="utf-8")
    tests = read_scenarios(file)
    return str(run_scenarios(enumerated().case.diagram, tests.scenarios, tests.dt, target="reference")[0])


def test_a_test_reads_and_reports_names(tmp_path: Path) -> None:
    assert outcome(tmp_path) == "arming: all 3 assertions hold"
    assert outcome(tmp_path, second="armed") == ("arming: mode as in table, within 0: idle at 0.1 s is not armed")
    assert outcome(tmp_path, first="armed").endswith("flying at 0 s is not armed")


def test_a_name_that_is_not_a_member_is_refused_where_it_stands(tmp_path: Path) -> None:
    for given, text in (
        ({"first": "fly"}, "arming, mode: Mode has no member 'fly' (there are: flying"),
        ({"second": "fly"}, "table, row 2, mode: Mode has no member 'fly' (there are: flying"),
    ):
        with pytest.raises(DiagramError) as refused:
            outcome(tmp_path, **given)
        assert text in str(refused.value)


def test_a_name_where_a_number_belongs_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "t.toml"
    for change, text in (
        (('"time", "mode"', '"time", "flies.y"'), "table, row 1, flies.y: 'flying' is not a number"),
        (("mode always", "flies.y always"), "flies.y: 'flying' is not a number"),
        (("number = 1", 'number = "flying"'), "number: 'flying' is not a signal"),
    ):
        file.write_text(TEST.format(first="flying", second="idle").replace(*change), encoding="utf-8")
        tests = read_scenarios(file)
        with pytest.raises(DiagramError) as refused:
            run_scenarios(enumerated().case.diagram, tests.scenarios, tests.dt, target="reference")
        assert text in str(refused.value)
