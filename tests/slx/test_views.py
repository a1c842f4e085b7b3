"""What is told of a Simulink model: what it holds, its picture, and what differs from another."""

import copy
import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from tests.slx.files import model as parts_of
from tests.slx.files import parts, slx, written
from twodof.cli.slx import slx as command
from twodof.slx.difference import difference
from twodof.slx.inspection import inspect
from twodof.slx.matlab.parser import assigned_names, names_in
from twodof.slx.model import Model, Pin, read_model
from twodof.slx.picture import pin_points, sheet_name, sheet_svg

pytestmark = pytest.mark.slow
DIAGRAM = "simulink/blockdiagram.xml"


@pytest.fixture
def model(tmp_path: Path) -> Model:
    return read_model(written("single", tmp_path))


def test_inspect_tells_what_the_model_needs(model: Model) -> None:
    found = inspect(model)
    assert found.blocks == {"Inport": 2, "Outport": 2, "Gain": 1, "SubSystem": 1, "Saturate": 1}
    assert (found.systems, found.depth, found.inputs, found.outputs) == (1, 1, ("error",), ("M",))
    # kp has its value from the InitFcn; of g.ki the structure is missing.
    assert found.names == {"M_MAX": ("limits//all/Saturation",), "g": ("P gain",)}
    assert (found.functions, found.charts, found.loose) == (("limits/f",), (), 0)


def test_a_library_is_looked_for_and_its_mask_tells_names_from_choices(tmp_path: Path) -> None:
    mask = (
        '<Mask><MaskParameter Name="Kp" Type="edit"><Value>0</Value></MaskParameter>'
        '<MaskParameter Name="form" Type="popup"><Value>ideal</Value></MaskParameter></Mask>'
    )
    inside = '<System><Block BlockType="Gain" Name="g" SID="2"><P Name="Gain">Kp</P></Block></System>'
    pid = f'<System><Block BlockType="SubSystem" Name="PID" SID="1">{mask}{inside}</Block></System>'
    link = (
        '<System><Block BlockType="Reference" Name="q loop" SID="1"><P Name="SourceBlock">my_pids/PID</P>'
        '<InstanceData><P Name="Kp">KP_Q</P><P Name="form">parallel</P></InstanceData></Block></System>'
    )
    path = slx({DIAGRAM: f"<ModelInformation><Model>{link}</Model></ModelInformation>"}, tmp_path / "m.slx")
    (library,) = inspect(read_model(path), [tmp_path]).libraries
    assert (library.name, library.blocks, library.file, library.own) == ("my_pids", 1, None, False)
    slx({DIAGRAM: f"<ModelInformation><Library>{pid}</Library></ModelInformation>"}, tmp_path / "my_pids.slx")
    found = inspect(read_model(path), [tmp_path])
    assert found.libraries[0].file == tmp_path / "my_pids.slx"
    assert found.names == {"KP_Q": ("q loop",)}
    assert inspect(read_model(tmp_path / "my_pids.slx")).names == {}  # Kp is the mask's own


def test_names_and_assignments_of_matlab() -> None:
    assert names_in("[a' b.c(2) 'text' 1e3 zeros(2, n)] % e\n* sin(x)'") == ["a", "b", "zeros", "n", "sin", "x"]
    code = "a = 1; b.c = 2, [d, e.f] = g(3);\nx(2) = a == 4; for k = 1:n, y = k; end"
    assert assigned_names(code) == {"a", "b", "d", "e", "x", "k", "y"}


def test_the_picture_shows_each_block_and_each_wire_meets_its_pins(model: Model) -> None:
    svg = sheet_svg(model)
    root = ElementTree.fromstring(svg)
    texts = [t.text for t in root.iter("{http://www.w3.org/2000/svg}text")]
    assert {"error", "M", "P gain", "kp/2 + …", "limits/all", "e"} <= set(texts)
    ways = [re.findall(r"[-\d.]+", w.get("points", "")) for w in root.iter("{http://www.w3.org/2000/svg}polyline")]
    ends = {(float(w[0]), float(w[1]), float(w[-2]), float(w[-1])) for w in ways}
    assert (140.0, 47.0, 200.0, 47.0) in ends  # from the gain's tip to the subsystem
    assert (260.0, 47.0, 320.0, 47.0) in ends
    assert f'href="{sheet_name(model, "limits//all")}"' in svg
    inner = sheet_svg(model, "limits//all")
    assert f'href="{sheet_name(model, "")}"' in inner
    assert "-M_MAX .. …" in inner
    assert svg == sheet_svg(model)


@pytest.mark.parametrize(
    ("values", "pin", "place"),
    [
        ({}, Pin("2", "in", 1), (100.0, 47.0)),
        ({}, Pin("2", "out", 1), (140.0, 47.0)),
        ({"BlockMirror": "on"}, Pin("2", "in", 1), (140.0, 47.0)),
        ({"BlockRotation": "270"}, Pin("2", "out", 1), (120.0, 64.0)),  # downwards
        ({"BlockRotation": "90"}, Pin("2", "out", 1), (120.0, 30.0)),  # upwards
        ({"Orientation": "left"}, Pin("2", "out", 1), (100.0, 47.0)),
    ],
)
def test_pins_turn_with_their_block(model: Model, values: dict[str, str], pin: Pin, place: tuple[float, float]) -> None:
    block = model.root.blocks["2"]
    block.values.update(values)
    assert pin_points(block, (100.0, 30.0, 140.0, 64.0), (1, 1))(pin) == pytest.approx(place)


def test_the_difference_names_what_a_reviewer_asks_for(model: Model, tmp_path: Path) -> None:
    assert difference(model, copy.deepcopy(model)).equal
    files, added = parts("single"), '<Block BlockType="Abs" Name="size" SID="8"/>'
    files[DIAGRAM] = (
        files[DIAGRAM]
        .replace("kp/2 + g.ki", "kp")
        .replace("[320, 40, 350, 54]", "[420, 40, 450, 54]")  # moved only
        .replace('Name="limits/all"', 'Name="bounds"')
        .replace('<Block BlockType="Outport" Name="M"', f'{added}<Block BlockType="Outport" Name="M"')
        .replace('<P Name="Src">3#out:1</P><P Name="Dst">4#', '<P Name="Src">8#out:1</P><P Name="Dst">4#')
        .replace("ode4", "ode1")
    )  # fmt: skip
    files["simulink/stateflow.xml"] = files["simulink/stateflow.xml"].replace("y = u;", "y = 2*u;")
    found = difference(model, read_model(slx(files, tmp_path / "after.slx")))
    assert found.added == [("size", "Abs")]
    assert found.removed == []
    assert found.renamed == [("limits//all", "bounds")]
    assert found.values == [("P gain", "Gain", "kp/2 + g.ki", "kp"), ("solver", "SolverName", "ode4", "ode1")]
    assert found.wires == [("", "bounds -> M", False), ("", "size -> M", True)]
    assert found.code == [
        ("limits/f (MATLAB Function)", ["@@ -1,2 +1,2 @@", " function y = f(u)", "-y = u;", "+y = 2*u;"])
    ]
    assert found.looks == 1


def test_the_commands(tmp_path: Path) -> None:
    path = written("split", tmp_path)
    run = CliRunner().invoke
    shown = run(command, ["inspect", str(path), "--json"])
    assert shown.exit_code == 0
    assert json.loads(shown.output)["release"] == "R2024a"
    plain = run(command, ["inspect", str(path)]).output
    assert "saved by R2024a" in plain
    assert re.search(r"M_MAX +limits//all/Saturation", plain)
    drawn = run(command, ["draw", str(path), "--out", str(tmp_path / "pictures")])
    assert drawn.exit_code == 0
    pictures = {file.name: file.read_text(encoding="utf-8") for file in (tmp_path / "pictures").iterdir()}
    links = {name for svg in pictures.values() for name in re.findall(r'href="([^"]+)"', svg)}
    assert links == set(pictures) == {"split.svg", "split.limits_all.svg"}
    other = written("braces", tmp_path)
    assert run(command, ["diff", str(path), str(path)]).exit_code == 0
    same = run(command, ["diff", str(path), str(other), "--json"])
    assert json.loads(same.output)["wires"] == []


def test_names_of_referenced_models_and_functions_are_listed(tmp_path: Path) -> None:
    code = "function y = f(u, ...\n P, inner)\ny = P*u*inner;"
    files = parts_of(
        [
            ("Gain", "k", {"Gain": "own*given"}),
            ("Inport", "bus", {"OutDataTypeStr": "Bus: Sensors"}),
            ("SubSystem", "f", {"SFBlockType": "MATLAB Function"}, ([("Inport", "u", {})], [])),
        ],
        [],
    )
    chart = f'<Stateflow><machine><chart><P Name="type">EML_CHART</P><P Name="name">f</P><P Name="script">{code}</P>'
    files["simulink/stateflow.xml"] = f"{chart}</chart></machine></Stateflow>"
    slx(files, tmp_path / "plant.slx")
    values = {"ModelNameDialog": "plant.slx", "ParameterArgumentNames": "given, inner"}
    top = read_model(slx(parts_of([("ModelReference", "Plant", values)], []), tmp_path / "top.slx"))
    assert inspect(top, [tmp_path]).names == {"P": ("Plant/f",), "Sensors": ("Plant/bus",), "own": ("Plant/k",)}
