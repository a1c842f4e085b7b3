"""`twodof identify` of an own structure on the columns of tables, and its plot."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from tests.cli.program import Shell
from twodof.blocks import Diagram
from twodof.blocks.library import FirstOrder
from twodof.cli.app import run
from twodof.flight.starters import save_diagram

pytestmark = pytest.mark.slow

GAIN, TIME_CONSTANT, DT = 20.0, 0.35, 0.01
COLUMNS = ["--input", "u=volt", "--output", "speed=tacho", "--time", "stamp"]
SOURCE = """
from twodof.blocks import Diagram
from twodof.blocks.library import FirstOrder
from twodof.models import Structure

def motor():
    d = Diagram("motor")
    d.input("u", unit="V")
    d.param("gain", 1.0, low=0.0, high=1000.0)
    d.param("time_constant", 0.1, unit="s", low=0.001, high=10.0)
    d.add("lag", FirstOrder(unit="rad/s"), u="u", params={"gain": "gain", "time_constant": "time_constant"})
    d.output("speed", "lag")
    return d

structure = Structure(motor(), estimate=("gain", "time_constant"))
number = 3
def broken():
    return 1 / 0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same data as CSV, Parquet and .mat, and the same structure as Python and JSON."""
    made = tmp_path_factory.mktemp("own")
    generator = np.random.default_rng(1)
    time = DT * np.arange(800)
    volt = 6.0 * np.sign(generator.standard_normal(40)).repeat(20)
    speed = np.zeros(800)
    for k in range(799):
        speed[k + 1] = speed[k] + (1.0 - np.exp(-DT / TIME_CONSTANT)) * (GAIN * volt[k] - speed[k])
    table = {"stamp": time, "volt": volt, "tacho": speed + generator.normal(0.0, 2.0, 800)}
    table["back"] = -0.1 * table["tacho"]  # k_v is at most 50
    rows = np.column_stack(list(table.values()))
    np.savetxt(made / "m.csv", rows, delimiter=",", header="stamp [s],volt [V],tacho,back", comments="", fmt="%.17g")
    pq.write_table(pa.table({**table, "dt": np.full(800, DT)}), made / "m.parquet")
    vectors = {name: one[:, None] for name, one in table.items()}
    savemat(made / "m.mat", {**vectors, "note": "by hand", "k": 2.0, "Ts": DT})
    (made / "model.py").write_text(SOURCE)
    space: dict[str, object] = {}
    exec(SOURCE, space)
    diagram = space["motor"]()  # type: ignore[operator]
    assert isinstance(diagram, Diagram)
    assert isinstance(diagram.parts["lag"].item, FirstOrder)
    save_diagram(diagram, made / "model.json")
    return made


def answer(arguments: list[str], shell: Shell) -> dict[str, dict[str, dict[str, float]]]:
    found: dict[str, dict[str, dict[str, float]]] = shell(["identify", *arguments, "--json"]).json
    return found


def test_every_form_of_table_gives_one_result(folder: Path, shell: Shell) -> None:
    found = [
        answer([str(folder / table), "--structure", str(folder / structure), *COLUMNS], shell)["estimates"]
        for table, structure in (
            ("m.csv", "model.py:structure"),
            ("m.parquet", "model.py"),
            ("m.mat", "model.py:motor"),
            ("m.csv", "model.json"),
        )
    ]
    for name, truth in (("gain", GAIN), ("time_constant", TIME_CONSTANT)):
        assert abs(found[0][name]["value"] - truth) < 3.0 * found[0][name]["sigma"]
        assert [one[name]["value"] for one in found] == pytest.approx([found[0][name]["value"]] * 4, rel=1e-6)


def test_a_period_stands_for_time_stamps(folder: Path, shell: Shell) -> None:
    columns = ["--structure", str(folder / "model.py"), *COLUMNS[:-2]]
    stamped = answer([str(folder / "m.csv"), *columns, "--time", "stamp"], shell)["estimates"]
    for table, period in (("m.csv", "0.01"), ("m.parquet", "0.01"), ("m.mat", "Ts"), ("m.parquet", "dt")):
        found = answer([str(folder / table), *columns, "--period", period], shell)["estimates"]
        assert found["gain"]["value"] == pytest.approx(stamped["gain"]["value"], rel=1e-6), table


def test_a_value_is_held_and_another_file_validates(folder: Path, shell: Shell) -> None:
    arguments = [str(folder / "m.csv"), "--structure", str(folder / "model.json"), *COLUMNS, "--estimate", "gain"]
    arguments += ["--value", "time_constant=0.35", "--window", "1", "4", "--validate", str(folder / "m.parquet")]
    found = answer(arguments, shell)
    assert list(found["estimates"]) == ["gain"]
    assert found["fixed"] == {"time_constant": 0.35}
    assert len(found["validation"]) == 1


def test_a_prior_is_weighed_against_the_data(folder: Path, shell: Shell) -> None:
    arguments = [str(folder / "m.csv"), "--structure", str(folder / "model.py:structure"), *COLUMNS]
    plain = answer(arguments, shell)["estimates"]["gain"]
    mean = plain["value"] + 2.0 * plain["sigma"]
    known = f"gain={mean},{plain['sigma']}"
    weighed = answer([*arguments, "--prior", known], shell)
    assert weighed["prior"] == {"gain": [mean, plain["sigma"]]}
    # Two sources of one weight meet half-way, but for the noise, which is estimated anew.
    middle = plain["value"] + plain["sigma"]
    assert weighed["estimates"]["gain"]["value"] == pytest.approx(middle, abs=0.1 * plain["sigma"])
    # What a prior speaks of is estimated.
    both = answer([*arguments, "--estimate", "time_constant", "--prior", known], shell)["estimates"]
    assert list(both) == ["time_constant", "gain"]


def test_models_are_named_and_compared(folder: Path, shell: Shell) -> None:
    columns = ["--input", "volt", "--output", "tacho", "--time", "stamp"]
    pair = [str(folder / "m.csv"), str(folder / "m.parquet"), "--merge"]
    compared = ["--compare", "arx:1,1,1", "--compare", "process:P1", "--validate", str(folder / "m.mat")]
    found = answer([*pair, "--model", "oe:1,1,1", *columns, *compared], shell)
    pole = np.exp(-DT / TIME_CONSTANT)
    for name, truth in (("f1", -pole), ("b1", GAIN * (1.0 - pole))):
        assert abs(found["estimates"][name]["value"] - truth) < 4.0 * found["estimates"][name]["sigma"]
    assert [one["record"] for one in found["identification"]] == ["m.csv", "m.parquet"]
    rows = found["compared"]
    assert {row["model"] for row in rows} == {"oe:1,1,1", "arx:1,1,1", "process:P1"}
    assert found["linear"]["A"] == [[pytest.approx(pole, abs=0.01)]]
    # Twice the time from step to step: the pole is squared.
    slow = answer([str(folder / "m.csv"), "--model", "oe:1,1,1", *columns, "--detrend", "--resample", "0.02"], shell)
    assert slow["linear"]["dt"] == pytest.approx(2.0 * DT)
    assert slow["estimates"]["f1"]["value"] == pytest.approx(-(pole**2), abs=0.01)


def test_a_model_that_cannot_be_fitted_is_left_out_of_the_comparison(folder: Path, shell: Shell) -> None:
    short = folder / "short.csv"
    short.write_text("\n".join((folder / "m.csv").read_text().splitlines()[:40]))
    columns = ["--input", "volt", "--output", "tacho", "--time", "stamp"]
    models = ["--model", "arx:1,1,1", "--compare", "arx:25,25,1", "--compare", "oe:1,1,1"]
    said = shell(["identify", str(short), *columns, *models])
    assert "note: arx:25,25,1 is left out: " in said.err
    assert "note: the models are compared on the data of their fit" in said.err
    assert "oe:1,1,1" in said.out


def test_a_table_without_a_flight_asks_for_its_columns(folder: Path, shell: Shell) -> None:
    (folder / "own.csv").write_text("time,volt,temp\n0,1,20\n0.1,2,21\n0.2,1,20\n")
    said = shell(["identify", str(folder / "own.csv")], 2).err
    assert "this is no flight of the 2DoF Drone: its columns are volt, temp" in said
    assert "--input NAME --output NAME --model arx:2,2,1" in said


def test_a_ready_made_structure_fits_columns_too(folder: Path, shell: Shell) -> None:
    arguments = [str(folder / "m.csv"), "--model", "velocity", "--input", "theta=volt", "--output", "v=back"]
    found = answer([*arguments, "--time", "stamp", "--estimate", "p_v", "--estimate", "k_v"], shell)
    assert found["estimates"]["p_v"]["value"] == pytest.approx(1.0 / TIME_CONSTANT, rel=0.02)


@pytest.mark.long
def test_the_plot_shows_data_tests_bode_and_ellipse(folder: Path, shell: Shell) -> None:
    arguments = ["identify", str(folder / "m.csv"), "--structure", str(folder / "model.py:structure"), *COLUMNS]
    for suffix, head in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".html", b"<!doctype html>")):
        path = folder / f"fit{suffix}"
        assert run([*arguments, "--plot", str(path)]) == 0
        content = path.read_bytes()
        assert content[:15].lower().startswith(head.lower())
        if suffix != ".png":
            text = content.decode()
            for word in ("speed [rad/s]", "residual [rad/s]", "u [V]", "time_constant [s]", "(rad/s)/V", "phase [deg]"):
                assert word in text, word
            assert "measured, 95 %" in text
            assert "within the 99 % band" in text
    assert "is there already" in shell([*arguments, "--plot", str(folder / "fit.png")], 2).err


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--input", "u=volt"], "which structure"),
        (["--structure", "model.py", *COLUMNS, "--prior", "gain=20"], "is not NAME=MEAN,SIGMA"),
        (["--model", "arx:1,1,1", "--input", "volt"], "which column is the output"),
        (["--model", "arx:1,1,1", "--input", "volt", "--output", "tacho", "--merge"], "there is one log"),
        (["--model", "arix:1,1,1", *COLUMNS], "no structure called"),
        (["--detrend"], "which structure"),
        (["--structure", "model.py", *COLUMNS, "--prior", "gian=20,1"], "no unknown 'gian'"),
        (["--structure", "model.py", *COLUMNS, "--prior", "gain=20,0"], "give (mean, standard deviation)"),
        (["--structure", "model.py:nothing", *COLUMNS], "has no 'nothing'"),
        (["--structure", "model.py:number", *COLUMNS], "a int is not a structure"),
        (["--structure", "model.py:broken", *COLUMNS], "ZeroDivisionError"),
        (["--structure", "absent.py", *COLUMNS], "cannot be read"),
        (["--structure", "model.py", "--input", "w=volt"], "has no input 'w'"),
        (["--structure", "model.py", "--input", "u=vlt", "--time", "stamp"], "there are: volt"),
        (["--structure", "model.py", "--input", "u=volt", "--time", "clock"], "no column 'clock'"),
        (["--structure", "model.py", "--input", "u=volt", "--time", "stamp"], "no column named as an output"),
        (["--structure", "model.py", *COLUMNS, "--experiment", "doublet"], "--experiment"),
        (["--structure", "model.py", *COLUMNS, "--period", "0.01"], "give one of --time and --period"),
        (["--structure", "model.py", *COLUMNS[:-2], "--period", "-1"], "a period of -1 s"),
        (["--structure", "model.py", *COLUMNS[:-2], "--period", "volt"], "column 'volt' has "),
        (["--structure", "model.py", *COLUMNS, "--model", "rail"], "--model"),
        (["--structure", "model.py", *COLUMNS, "--estimate", "mu"], "no unknown 'mu'"),
        (["--structure", "model.py", *COLUMNS, "--hold", "u"], "write u=linear"),
        (["--structure", "model.py", *COLUMNS, "--hold", "u=soft"], "no hold named 'soft'"),
        (["--structure", "model.py", *COLUMNS, "--plot", "fit.doc"], "no picture has the suffix"),
        (["--structure", "model.py", *COLUMNS, "--window", "900", "901"], "window"),
        (["--structure", "model.py", *COLUMNS, "--reference", "back"], "it is of use to a plot only"),
        (["--structure", "model.py", *COLUMNS, "--reference", "zero", "--plot", "r.svg"], "has no column 'zero'"),
    ],
)
def test_wrong_options_are_refused_with_a_remedy(
    folder: Path, arguments: list[str], reason: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert run(["identify", "m.csv", *arguments]) in (1, 2)
    said = capfd.readouterr().err
    assert reason in " ".join(said.split()), said
    assert "Traceback" not in said


Rows = list[list[str]]


def cell(row: int, column: int, text: str) -> Callable[[Rows], Rows]:
    """Return the change of one cell; row 0 holds the headings."""
    return lambda rows: [*rows[:row], [*rows[row][:column], text, *rows[row][column + 1 :]], *rows[row + 1 :]]


def headed(*names: str) -> Callable[[Rows], Rows]:
    return lambda rows: [list(names), *rows[1:]]


def moved(column: int, steps: int) -> Callable[[Rows], Rows]:
    """Return the change that logs a column so many rows late."""
    return lambda rows: [
        rows[0],
        *([*r[:column], rows[max(k - steps, 0) + 1][column], *r[column + 1 :]] for k, r in enumerate(rows[1:])),
    ]


@pytest.mark.parametrize(
    ("change", "separator", "words"),
    [
        (lambda rows: [row[:2] for row in rows], ",", "no column 'tacho'"),
        (cell(41, 2, "oops"), ",", "words, 'oops' in row 41"),
        (cell(41, 2, "nan"), ",", ""),
        (cell(41, 2, ""), ",", ""),
        (cell(41, 1, "inf"), ",", "inf at sample 40"),
        (lambda rows: [*rows[:41], rows[40], *rows[41:]], ",", "repeated stamps"),
        (lambda rows: [rows[0], *rows[:0:-1]], ",", "sort the samples"),
        (headed("stamp [s]", "volt [V]", "tacho [rad/s]", "back"), ",", ""),
        (headed("stamp (s)", "volt (V)", "tacho (rad/s)", "back"), ",", ""),
        (lambda rows: [["stamp", "volt", "tacho", "back"], ["s", "V", "rad/s", "-"], *rows[1:]], ",", ""),
        (lambda rows: [["stamp [ms]", *rows[0][1:]], *([str(1e3 * float(r[0])), *r[1:]] for r in rows[1:])], ",", ""),
        (lambda rows: rows[:2], ",", "holds 1 samples"),
        (lambda rows: rows[:1], ",", "give a header line and below it numbers"),
        (lambda rows: rows[1:], ",", "write the names of the columns"),
        (lambda rows: [[one.replace(".", ",") for one in row] for row in rows], ";", ""),
        (lambda rows: [[one.replace(".", ",") for one in row] for row in rows], ",", "a comma may be the decimal mark"),
        (lambda rows: [*rows[:41], rows[41][:2], *rows[42:]], ",", "Expected 4 columns, got 2"),
        (cell(300, 2, "2000"), ",", "speed at 2.99 s"),
        (cell(300, 1, "6000"), ",", "u at 2.99 s"),
        (moved(1, 100), ",", "s before the time stamps"),
        (moved(2, 100), ",", "s after the time stamps"),
    ],
)
def test_a_broken_table_is_right_refused_or_noted(
    folder: Path,
    tmp_path: Path,
    change: Callable[[Rows], Rows],
    separator: str,
    words: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    rows = change([line.split(",") for line in (folder / "m.csv").read_text().splitlines()])
    (tmp_path / "t.csv").write_text("".join(separator.join(row) + "\n" for row in rows))
    structure = f"{folder / 'model.py'}:structure"
    code = run(["identify", str(tmp_path / "t.csv"), "--structure", structure, *COLUMNS])
    said = capfd.readouterr()
    both = " ".join((said.out + said.err).split())
    assert "Traceback" not in both
    assert words in both
    assert not code or "remedy: " in both or "note: " in both
    if not words:
        values = {
            line.split()[0]: float(line.split()[1]) for line in said.out.splitlines() if line[:4] in ("gain", "time")
        }
        assert values == pytest.approx({"gain": GAIN, "time_constant": TIME_CONSTANT}, rel=0.02)
    assert bool(words) or code == 0
