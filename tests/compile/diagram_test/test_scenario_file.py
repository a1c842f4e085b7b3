"""Files of tests: what they say is what runs, and what they must not say is refused with its place."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.compile.typed_signals import enumerated
from twodof.compile.diagram_test import ExpectedTable, PointsInput, RampInput, SineInput, StepInput, read_scenarios
from twodof.compile.diagram_test.run_scenarios import run_scenarios
from twodof.errors import DiagramError

WHOLE = """
dt = 0.01
integrator = "euler"

[[test]]
name = "all"
text = "every kind of signal"
duration = 1
parameters = { k = 2, "rate.kp" = 0.5, rate = { ki = 0.25 }, table = [1.0, 2.0] }
inputs.a = 1.5
inputs.b = true
inputs.c = { step = 2.0, at = 0.1, from = 1.0 }
inputs.d = { ramp = 0.5, start = 0.1, stop = 0.2 }
inputs.e = { sine = 0.5, hz = 2.0, phase = 0.1, offset = 1.0 }
inputs.f = { points = [[0.0, 1.0], [0.5, 2.0]], between = "hold" }
inputs.g = [0.0, { step = 1.0 }]
inputs.h = { csv = "data/in.csv", column = "u", between = "interpolate" }
checks = ["y never above 1", "y settles within .1 of 1 by .5"]

[[test]]
name = "table"
[test.table]
csv = "data/in.csv"
between = "hold"
absolute = { y = 0.1 }
relative = 0.01
at = "ticks"
"""


ROWS = "time [s],u,y [rad]\n0,1,\n0.1,2,true\n0.2,-3e-1,nan\n"


def write(folder: Path, text: str, rows: str = ROWS, encoding: str = "utf-8") -> Path:
    (folder / "data").mkdir(exist_ok=True)
    (folder / "data" / "in.csv").write_text(rows, encoding=encoding)
    file = folder / "x.toml"
    file.write_text(text, encoding=encoding)
    return file


GERMAN = ROWS.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(
    ("rows", "encoding"),
    [(ROWS, "utf-8"), (ROWS, "utf-8-sig"), (GERMAN, "utf-16"), (GERMAN.replace(";", "\t"), "utf-8")],
)
def test_a_file_says_what_the_objects_say(tmp_path: Path, rows: str, encoding: str) -> None:
    found = read_scenarios(write(tmp_path, WHOLE, rows, encoding))
    assert (found.dt, found.integrator) == (0.01, "euler")
    first, second = found.scenarios
    assert (first.name, first.text, first.duration) == ("all", "every kind of signal", 1.0)
    assert first.parameters == {"k": 2, "rate.kp": 0.5, "rate.ki": 0.25, "table": [1.0, 2.0]}
    assert first.inputs["c"] == StepInput(2.0, 0.1, 1.0)
    assert first.inputs["d"] == RampInput(0.5, 0.1, 0.2)
    assert first.inputs["e"] == SineInput(0.5, 2.0, 0.1, 1.0)
    assert first.inputs["f"] == PointsInput([(0.0, 1.0), (0.5, 2.0)], "hold")
    assert first.inputs["h"] == PointsInput([(0.0, 1.0), (0.1, 2.0), (0.2, -0.3)], "interpolate")
    assert list(first.checks) == ["y never above 1", "y settles within .1 of 1 by .5"]
    table = second.table
    assert isinstance(table, ExpectedTable)
    assert table.tolerance("y") == (0.1, 0.01)
    assert table.tolerance("z") == (0.0, 0.01)
    rows, values = table.table.column("y")
    assert rows.tolist() == [1, 2]
    assert values[0] == 1.0
    assert np.isnan(values[1])


TEST = '[[test]]\nname = "t"\nduration = 1.0\n'


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", ", test: it is missing"),
        ("[[test]\n", "not TOML"),
        ("x = " + "[" * 5000, "not TOML"),
        ("dt = 0\n" + TEST, "dt: Input should be greater .*given: 0"),
        ('integrator = "ode45"\n' + TEST, ", integrator: Input should be 'rk4' or 'euler'"),
        ("[[test]]\nduration = 1\n", ", test 1, name: it is missing"),
        ('[[test]]\nname = "a\\u001b[31m"\n', r"test 1: name = 'a\\x1b\[31m'"),
        (TEST + TEST, "two tests are named 't'"),
        (TEST + "durations = 3\n", "test 1, durations: unknown key .keys: duration,"),
        (TEST + 'checks = ["y is nice"]\n', "test 1 .t., 'y is nice': this is not an assertion"),
        (TEST + 'checks = ["y settles within true of 1 by 0.5"]\n', "this is not an assertion"),
        (TEST + 'inputs.u = "1"\n', "test 1 .t., u: '1' is not a signal"),
        (TEST + "inputs.u = 1" + "0" * 400 + "\n", "test 1 .t., u: a number is too large"),
        (TEST + "inputs.u = { steps = 1 }\n", "not a signal"),
        (TEST + "inputs.u = { step = 1, before = 2 }\n", "u, before: unknown key .*keys: step, at, from"),
        (TEST + "inputs.u = { step = 1, form = 2 }\n", "u, form: unknown key .keys: from,"),
        (TEST + "inputs.u = { sine = 1 }\n", "u, hz: it is missing"),
        (TEST + "inputs.u = { sine = 1.0, hz = 1e308 }\n", "test 1 .t., u, sine: hz = 1e.308"),
        (TEST + "inputs.u = { step = nan }\n", "test 1 .t., u, step: nan is not a finite number"),
        (TEST + "inputs.u = { points = [[0.0, 1.0]] }\n", "u, between: it is missing"),
        (TEST + 'inputs.u = { points = [[0, "x"]], between = "hold" }\n', "u, points.1.2: Input .*given: 'x'"),
        (TEST + 'inputs.u = { points = [[0, 1]], csv = "data/in.csv", between = "hold" }\n', "u, csv: unknown key"),
        (TEST + 'inputs.u = { points = [[0.1, 1.0], [0.0, 2.0]], between = "hold" }\n', "do not increase"),
        (
            TEST + 'inputs.u = { csv = "data/in.csv", column = [], between = "hold" }\n',
            "u, column: Input should be .*str",
        ),
        (
            TEST + 'inputs.u = { csv = "data/in.csv", column = "w", between = "hold" }\n',
            "u, in.csv: no column named 'w'",
        ),
        (TEST + 'inputs.u = { csv = "data/no.csv", column = "u", between = "hold" }\n', "cannot be read"),
        (TEST + 'inputs.u = { csv = "../in.csv", column = "u", between = "hold" }\n', "not in the folder"),
        (TEST + 'inputs.u = { csv = "/etc/passwd", column = "u", between = "hold" }\n', "not in the folder"),
        (TEST + 'inputs.u = { csv = "a\\u0000b", column = "u", between = "hold" }\n', "not in the folder"),
        (TEST + 'inputs.u = { points = [[1e308, 1.0]], between = "hold" }\n', "do not increase to at most"),
        (TEST + '[test.table]\nbetween = "hold"\ncsv = "data/in.csv"\n', "table: it has no tolerance"),
        (TEST + '[test.table]\nabsolute = 0\ncsv = "data/in.csv"\n', "table, between: it is missing"),
        (TEST + '[test.table]\nabsolute = 0\nbetween = "hold"\n', "either a CSV file or rows"),
        (
            TEST + '[test.table]\nabsolute = 0\nbetween = "hold"\ncsv = "data/in.csv"\nrows = []\n',
            "either a CSV file or rows",
        ),
        (TEST + '[test.table]\nabsolute = {Y = 1}\nbetween = "hold"\ncsv = "data/in.csv"\n', "for 'Y', which is not"),
        (TEST + '[test.table]\nabsolute = 0\nbetween = "hold"\ncolumns = ["y"]\nrows = [[1.0]]\n', "first column"),
        (TEST + '[test.table]\nabsolute = 0\nbetween = "hold"\ncolumns = ["tick"]\nrows = [[0.5]]\n', "not increase"),
        (
            TEST + '[test.table]\nabsolute = 0\nbetween = "hold"\ncolumns = ["tick", "y"]\nrows = [[0]]\n',
            "test 1 .t., table, table, row 1: 1 cells for 2",
        ),
    ],
)
def test_what_a_file_must_not_say_is_refused(tmp_path: Path, text: str, what: str) -> None:
    file = write(tmp_path, text)
    with pytest.raises(DiagramError) as refused:
        read_scenarios(file)
    where, message = str(refused.value).split("x.toml", 1)
    assert where == f"{tmp_path}/"
    assert re.search(what, message)


def test_a_wrong_table_is_refused(tmp_path: Path) -> None:
    file = write(tmp_path, TEST + '[test.table]\nabsolute = 0\nbetween = "hold"\ncsv = "data/in.csv"\n')
    place = tmp_path / "data" / "in.csv"
    for content, what in (
        (b"time,y\n1,0\n0,0\n", "does not increase"),
        (b"time,y\nnan,0\n", "does not increase"),
        (b"time,y,y\n0,0,0\n", "two columns have the same name"),
        (b"time,y\n0\n", "1 cells for 2"),
        (b"\xff", "in.csv: cannot be read: 'utf-8' codec can't decode byte 0xff"),
        (b'time,"y\n', "in.csv: cannot be read: unexpected end of data"),
        (b"", "first column is ''"),
    ):
        place.write_bytes(content)
        with pytest.raises(DiagramError, match=f"x.toml, test 1 .t., table, .*{what}"):
            read_scenarios(file)


# Names of an enumeration's members in inputs, parameters, assertions and tables.
NAMED = """
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
    file.write_text(NAMED.format(first=first, second=second), encoding="utf-8")
    tests = read_scenarios(file)
    return str(run_scenarios(enumerated().case.diagram, tests.scenarios, tests.dt, target="reference")[0])


def test_a_test_reads_and_reports_names(tmp_path: Path) -> None:
    assert outcome(tmp_path) == "arming: all 3 assertions hold"
    assert outcome(tmp_path, second="armed") == ("arming: mode as in table, within 0: idle at 0.1 s is not armed")
    assert outcome(tmp_path, second="nan") == ("arming: mode as in table, within 0: idle at 0.1 s is not nan")
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
        (('asked = "broken"', "asked = 77"), "arming, asked: 77 is not a member of Mode"),
    ):
        file.write_text(NAMED.format(first="flying", second="idle").replace(*change), encoding="utf-8")
        tests = read_scenarios(file)
        with pytest.raises(DiagramError) as refused:
            run_scenarios(enumerated().case.diagram, tests.scenarios, tests.dt, target="reference")
        assert text in str(refused.value)
