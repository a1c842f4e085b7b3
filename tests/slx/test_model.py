"""Files of Simulink: each layout tells the same model, and hostile ones are refused within bounds."""

import time
from pathlib import Path

import pytest

from tests.slx.files import INNER, parts, slx, written
from twodof.errors import DiagramError
from twodof.slx.model import Model, Pin, read_model

pytestmark = pytest.mark.slow

LAYOUTS = ("single", "split", "counts", "text", "braces")


def told(model: Model) -> dict[str, object]:
    """What a model says, in whatever layout."""
    wires = [
        (path, line.name, line.source, [(w.points, w.sink) for w in (line.wire, *line.wire.branches)])
        for path, system in model.root.walk()
        for line in system.lines
    ]
    blocks = {path: (b.type, b.sid, {k: v for k, v in b.values.items() if k != "Ports"}) for path, b in model.blocks()}
    solver = {k: v for k, v in model.solver.items() if k != "Solver"}
    charts = [(c.path, c.function, c.text) for c in model.charts]
    return {"blocks": blocks, "wires": wires, "solver": solver, "callbacks": model.callbacks, "charts": charts}


def test_each_layout_tells_the_same_model(tmp_path: Path) -> None:
    models = {layout: read_model(written(layout, tmp_path)) for layout in LAYOUTS}
    first = told(models["single"])
    assert {layout for layout, model in models.items() if told(model) != first} == set()
    assert {m.kind for m in models.values()} == {"model"}
    assert [models[layout].release for layout in LAYOUTS] == ["R2016a", "R2024a", "R2024a", "R2024a", "R2011b"]
    model = models["split"]
    assert list(dict(model.blocks())) == [
        "error", "P gain", "limits//all", "M", "limits//all/in", "limits//all/Saturation", "limits//all/out",
    ]  # fmt: skip
    assert model.system("limits//all").blocks["3::6"].values == {"UpperLimit": "M_MAX", "LowerLimit": "-M_MAX"}
    line = model.root.lines[0]
    assert line.source == Pin("1", "out", 1)
    assert list(line.wire.sinks()) == [Pin("2", "in", 1)]
    assert line.wire.points == [(20.0, 0.0)]
    assert line.wire.branches[1].points == [(0.0, 60.0), (60.0, 0.0)]
    with pytest.raises(DiagramError, match=r"has no subsystem limits \(its first ones are: limits//all\)"):
        model.system("limits")


@pytest.mark.parametrize("form", ["element", "object", "variables"])
def test_a_mask_is_read_in_all_its_forms(tmp_path: Path, form: str) -> None:
    masks = {
        "element": '<Mask><Type>PID</Type><Initialization>k = 2*Kp;</Initialization>'
        '<MaskParameter Name="Kp" Type="edit"><Value>KP_Q</Value></MaskParameter>'
        '<MaskParameter Name="form" Type="popup"><Value>ideal</Value></MaskParameter></Mask>',
        "object": '<Object PropName="MaskObject"><P Name="Type">PID</P><P Name="Initialization">k = 2*Kp;</P>'
        '<Array PropName="Parameters"><Object><P Name="Type">edit</P><P Name="Name">Kp</P><P Name="Value">KP_Q</P>'
        '</Object><Object><P Name="Type">popup</P><P Name="Name">form</P><P Name="Value">ideal</P></Object></Array>'
        "</Object>",
        "variables": '<P Name="MaskType">PID</P><P Name="MaskInitialization">k = 2*Kp;</P><P Name="MaskVariables">'
        'Kp=@1;form=@2;</P><P Name="MaskStyleString">edit,popup(ideal|parallel)</P>'
        '<P Name="MaskValueString">KP_Q|ideal</P>',
    }  # fmt: skip
    files = parts("single")
    name = "simulink/blockdiagram.xml"
    files[name] = files[name].replace('<P Name="Ports">[1, 1]</P>', f'<P Name="Ports">[1, 1]</P>{masks[form]}')
    mask = dict(read_model(slx(files, tmp_path / "m.slx")).blocks())["limits//all"].mask
    assert mask is not None
    assert (mask.kind, mask.initialization) == ("PID", "k = 2*Kp;")
    assert mask.parameters == {"Kp": ("edit", "KP_Q"), "form": ("popup", "ideal")}
    assert mask.computed == {"Kp": "KP_Q"}


def bomb(entity: bool) -> str:
    lines = "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 10))
    head = f'<!DOCTYPE x [<!ENTITY a0 "aaaaaaaaaa">{lines}]>' if entity else ""
    return f'<?xml version="1.0"?>{head}<ModelInformation><Model><P Name="x">&a9;</P></Model></ModelInformation>'


def hostile(kind: str) -> dict[str, str]:
    """The parts of a hostile file."""
    files = parts("split")
    root, inner = "simulink/systems/system_root.xml", "simulink/systems/system_3.xml"
    if kind == "entities":
        files["simulink/blockdiagram.xml"] = bomb(True)
    elif kind == "a system that holds itself":
        files[inner] = (
            f'<System>{INNER}<Block BlockType="SubSystem" Name="x" SID="99"><System Ref="system_3"/></Block></System>'
        )
    elif kind == "a path out of the archive":
        files[root] = files[root].replace("system_3", "../../../../../../etc/passwd")
    elif kind == "a part that is missing":
        del files[inner]
    elif kind == "too many blocks":
        block = '<Block BlockType="Gain" Name="g" SID="1"/>'
        files[root] = f"<System>{block * 300_000}</System>"
    elif kind == "too deep":
        depth = 200_000
        files[root] = "<System>" + "<Block><System>" * depth + "</System></Block>" * depth + "</System>"
    elif kind == "branches too deep":
        files[root] = "<System><Line>" + "<Branch>" * 100_000 + "</Branch>" * 100_000 + "</Line></System>"
    elif kind == "zeros":
        files["simulink/blockdiagram.xml"] = " " * ((64 << 20) + 1)
    elif kind == "no XML":
        files[root] = "<System><Block"
    elif kind == "no diagram":
        files = {"a.txt": "b"}
    return files


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("entities", "defines entities"),
        ("a system that holds itself", "holds itself or stands twice"),
        ("a path out of the archive", "has no part for its system|holds itself or stands twice"),
        ("a part that is missing", "has no part for its system system_3"),
        ("too many blocks", "more than 100000 blocks|processor time|more memory"),
        ("too deep", "deep|processor time|ends its reader"),
        ("branches too deep", "deep|ends its reader"),
        ("zeros", "has 67108865 bytes"),
        ("no XML", "its XML is damaged"),
        ("no diagram", "has no part simulink/blockdiagram.xml"),
    ],
)
def test_a_hostile_file_is_refused_within_bounds(tmp_path: Path, kind: str, said: str) -> None:
    path = slx(hostile(kind), tmp_path / "hostile.slx")
    begin = time.process_time()
    with pytest.raises(DiagramError, match=said) as refused:
        read_model(path)
    assert "hostile.slx" in str(refused.value)
    assert ".slx or .mdl" in refused.value.remedy
    assert time.process_time() - begin < 2.0  # the child does the work, and its limits end it
    assert read_model(written("split", tmp_path)).name == "split"  # the next file is read


def test_a_file_cut_anywhere_is_refused(tmp_path: Path) -> None:
    for layout in ("split", "text", "braces"):
        path = written(layout, tmp_path)
        data = path.read_bytes()
        for share in (0.0, 0.1, 0.5, 0.9):
            path.write_bytes(data[: int(share * len(data))])
            if layout == "braces" and share == 0.9:
                continue  # the model is whole, and a chart lacks its end
            with pytest.raises(DiagramError, match="slx"):
                read_model(path)
