"""`twodof diagram`: new, check, code, render, linearize, as a user meets them."""

import re
import xml.etree.ElementTree as ElementTree
import zipfile
from html.parser import HTMLParser
from pathlib import Path

import pytest

from tests.cli.program import Shell
from twodof.blocks import Diagram
from twodof.blocks.library import Gain, Sum, UnitDelay
from twodof.blocks.schema.json_form import to_json
from twodof.cli.app import run
from twodof.flight.starters import load_diagram
from twodof.models import pitch_rate

pytestmark = pytest.mark.slow

LOOP = Diagram("loop", "a first loop")
LOOP.input("r")
LOOP.param("k", 2.0, low=0.0, high=10.0)
LOOP.add("error", Sum("+-"), a="r", b="memory")
LOOP.add("gain", Gain(), u="error", params={"k": "k"})
LOOP.add("memory", UnitDelay(), u="gain")
LOOP.add("idle", Gain(), u="r")
LOOP.output("y", "gain")


@pytest.fixture
def loop(tmp_path: Path) -> str:
    file = tmp_path / "loop.json"
    file.write_text(to_json(LOOP))
    return str(file)


def test_a_new_diagram_is_the_starter(tmp_path: Path, shell: Shell) -> None:
    file = tmp_path / "mine.json"
    assert run(["diagram", "new", "stock-attitude", str(file)]) == 0
    assert load_diagram(file).name == load_diagram("stock-attitude").name
    file.write_text("{}")
    assert "there already" in shell(["diagram", "new", "stock-attitude", str(file)], 2).err
    assert run(["diagram", "new", "stock-attitude", str(file), "--overwrite"]) == 0
    assert run(["diagram", "new", "no-such-starter", str(tmp_path / "x.json")]) == 2


def test_check_says_what_compiles_and_what_does_not(loop: str, tmp_path: Path, shell: Shell) -> None:
    assert "it compiles" in shell(["diagram", "check", loop]).out
    found = shell(["diagram", "check", loop, "--json"]).json
    assert found["fine"] is True
    assert found["sizes"]["blocks"] == 4
    assert found["feedthrough"] == {"y": ["r"]}
    assert found["left_out"] == ["idle"]
    text = re.sub(r'\["(memory|r)", "(error\.b|gain\.u|idle\.u|memory\.u)"\],?', "", to_json(LOOP))
    broken = tmp_path / "broken.json"
    broken.write_text(re.sub(r",(\s*)\]", r"\1]", text))
    problems = shell(["diagram", "check", str(broken), "--json"], 1).json["problems"]
    assert {p["where"] for p in problems} == {"error.b", "idle.u"}
    assert "2 problems" in shell(["diagram", "check", str(broken)], 1).out


def test_check_names_the_template_and_its_faults(loop: str, tmp_path: Path, shell: Shell) -> None:
    """tests/flight/test_templates.py has the faults one by one."""
    assert "it fits no template of the drone's controllers (attitude_control, " in shell(["diagram", "check", loop]).out
    assert shell(["diagram", "check", "lqr-attitude", "--template", "attitude_control"]).out.endswith(
        "\nit fits the template attitude_control\n"
    )
    d = Diagram("mine")
    d.input("theta", "real", unit="deg")
    d.add("k", Gain(2.0), u="theta")
    d.output("M", "k")
    mine = tmp_path / "mine.json"
    mine.write_text(to_json(d))
    for options, status in ([], 0), (["--template", "attitude_control"], 1):
        head, _, lines = shell(["diagram", "check", str(mine), *options], status).out.partition(
            "it does not fit the template attitude_control:\n"
        )
        assert head.startswith("it compiles")
        assert "  the input theta is real in deg: make it real in rad" in lines
    fit = shell(["diagram", "check", str(mine), "--json", "--template", "motor_control"], 1).json["template"]
    assert (fit["name"], fit["fits"]) == ("motor_control", False)
    assert "the input gyro_y is missing: add real in rad/s, measured pitch rate, its bias still in it" in fit["faults"]
    assert "there are: attitude_control" in shell(["diagram", "check", loop, "--template", "attitude"], 2).err


def test_code_shows_both_sides(loop: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], shell: Shell) -> None:
    out = shell(["diagram", "code", loop]).out
    assert re.search(r"^gain +\d+ +/\* gain: gain \*/$", out, re.MULTILINE)
    assert "left out, as nobody needs them: idle" in out
    out = shell(["diagram", "code", loop, "--block", "memory", "--precision", "float32"]).out
    assert "s->memory_x = " in out
    assert "error" not in out.replace("error_y", "")
    page, source = tmp_path / "loop.html", tmp_path / "loop.c"
    assert run(["diagram", "code", loop, "--html", str(page), "--out", str(source)]) == 0
    lines = source.read_text().splitlines()
    capfd.readouterr()
    found = shell(["diagram", "code", loop, "--json"]).json
    ((first, last),) = found["blocks"]["gain"]["lines"]["step"]
    assert "gain_y = " in "".join(lines[first - 1 : last])
    assert found["lines"] == len(lines)
    assert run(["diagram", "code", loop, "--block", "nothing"]) == 2


def test_export_writes_a_header_and_its_c(loop: str, tmp_path: Path, shell: Shell) -> None:
    folder = tmp_path / "firmware" / "control"
    said = shell(["diagram", "export", loop, str(folder), "--json", "--precision", "float32", "--log", "memory.y"]).json
    assert said["files"] == [str(folder / "loop.h"), str(folder / "loop.c")]
    assert said["sizes"] == {"real": 4, "P": 12, "S": 8, "U": 4, "Y": 8}
    assert "float memory_y; /* memory.y */" in (folder / "loop.h").read_text()
    assert "--force" in shell(["diagram", "export", loop, str(folder)], 2).err
    assert run(["diagram", "export", loop, str(folder), "--name", "again", "--tables"]) == 0
    assert "extern const again_Entry again_parameters[];" in (folder / "again.h").read_text()
    assert "choose another folder" in shell(["diagram", "export", loop, f"{tmp_path / 'loop.json'}/firmware"], 2).err


def test_fmu_writes_a_file_that_ends_in_fmu(loop: str, tmp_path: Path, shell: Shell) -> None:
    file = tmp_path / "loop.fmu"
    said = shell(["diagram", "fmu", loop, str(file), "--fmi", "2.0", "--log", "memory.y", "--json"]).json
    assert (said["fmi"], said["inputs"], said["outputs"]) == ("2.0", 1, 2)
    with zipfile.ZipFile(file) as archive:
        assert b'name="memory.y"' in archive.read("modelDescription.xml")
    assert "--force" in shell(["diagram", "fmu", loop, str(file)], 2).err
    assert "name it loop.fmu" in shell(["diagram", "fmu", loop, str(tmp_path / "loop.zip")], 2).err


def test_the_page_is_self_contained_and_complete(loop: str, tmp_path: Path) -> None:
    page, source = tmp_path / "loop.html", tmp_path / "loop.c"
    assert run(["diagram", "code", loop, "--html", str(page), "--out", str(source)]) == 0
    text = page.read_text()
    assert not re.search(r"(src|href)\s*=|https?:|url\(|@import", text)

    class Reader(HTMLParser):
        def __init__(self) -> None:
            super().__init__()
            self.lines: list[str] = []
            self.marks: set[str] = set()
            self.buttons: set[str] = set()

        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            mark = dict(attrs).get("data-b")
            if tag == "span":
                self.lines.append("")
                self.marks |= {mark} if mark else set()
            if tag == "button" and mark:
                self.buttons.add(mark)

        def handle_data(self, data: str) -> None:
            if self.lines:
                self.lines[-1] += data

    reader = Reader()
    reader.feed(text.partition("</pre>")[0])
    assert reader.lines == source.read_text().splitlines()
    assert reader.buttons <= reader.marks


def test_render_writes_a_picture(loop: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], shell: Shell) -> None:
    file = tmp_path / "loop.svg"
    assert run(["diagram", "render", loop, "--out", str(file)]) == 0
    ElementTree.parse(file)
    capfd.readouterr()
    assert shell(["diagram", "render", loop]).out == file.read_text()
    assert run(["diagram", "render", loop, "--path", "gain"]) == 2


def test_linearize_prints_the_model(loop: str, tmp_path: Path, shell: Shell) -> None:
    found = shell(["diagram", "linearize", loop, "--dt", "0.01", "--at", '{"k": 0.5}', "--json"]).json
    # y = k (r - m), m' = y
    assert (found["A"], found["B"], found["C"], found["D"]) == ([[-0.5]], [[0.5]], [[-0.5]], [[0.5]])
    assert found["states"] == ["memory.x"]
    assert found["dt"] == 0.01
    point = tmp_path / "point.json"
    point.write_text('{"r": 3.0}')
    assert shell(["diagram", "linearize", loop, "--at", str(point), "--trim", "--json"]).json["point"][
        "memory.x"
    ] == pytest.approx(2.0, abs=1e-12)
    out = shell(["diagram", "linearize", loop, "--input", "gain.y", "--output", "gain.y"]).out
    assert "1 states, 1 inputs, 1 outputs" in out
    assert run(["diagram", "linearize", loop, "--at", "{"]) == 2
    assert run(["diagram", "linearize", loop, "--at", str(tmp_path / "none.json")]) == 2
    assert "no parameter named 'q'" in shell(["diagram", "linearize", loop, "--at", '{"q": 1}'], 2).err


def test_linearize_names_states_and_inputs_without_effect(tmp_path: Path, shell: Shell) -> None:
    file = tmp_path / "held.json"
    d = pitch_rate().diagram
    d.input("spare")
    file.write_text(to_json(d))
    out = shell(["diagram", "linearize", str(file)]).out
    assert "x[k+1], one step is 0.004 s; 6 states, 2 inputs, 2 outputs" in out
    assert "plant.past_M[k-1]  " in out
    assert "\\[" not in out
    assert "left out: plant.past_M, 60 elements (nothing depends on it)" in out
    assert "remark: spare: this input has no effect on any output" in out


def test_a_picture_is_svg_and_is_called_so(tmp_path: Path, shell: Shell) -> None:
    assert "picture.svg" in shell(["diagram", "render", "pid-attitude", "--out", str(tmp_path / "picture.png")], 2).err
    assert not any(tmp_path.iterdir())
