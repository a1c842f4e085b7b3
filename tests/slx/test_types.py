"""Data types of Simulink: buses, dictionaries, integers; values by hand from Simulink's documented rules."""

from pathlib import Path

import numpy as np
import pytest

from tests.slx.files import slx
from tests.slx.test_import import DRAWN, DT, flown, model
from twodof.errors import DiagramError
from twodof.slx.dictionary import dictionary
from twodof.slx.importer import Imported, import_system
from twodof.slx.inspection import inspect
from twodof.slx.matlab import evaluate, run
from twodof.slx.model import read_model

pytestmark = pytest.mark.slow

BUSES = """
elems(1) = Simulink.BusElement;
elems(1).Name = 'p'; elems(1).DataType = 'double';
elems(2) = Simulink.BusElement;
elems(2).Name = 'axes'; elems(2).Dimensions = 3;
Rates = Simulink.Bus; Rates.Elements = elems;
clear elems;
elems(1) = Simulink.BusElement;
elems(1).Name = 'count'; elems(1).DataType = 'uint8';
elems(2) = Simulink.BusElement;
elems(2).Name = 'rates'; elems(2).DataType = 'Bus: Rates';
Sensors = Simulink.Bus;
Sensors.Elements = elems;
start.count = 7; start.rates.p = 1.5; start.rates.axes = [1 2 3];
"""


def imported(tmp_path: Path, blocks: list, lines: list, code: str = BUSES) -> Imported:
    names: dict[str, object] = {}
    assert run(code, names) == []
    return import_system(read_model(slx(model(blocks, lines), tmp_path / "m.slx")), "", names, [tmp_path], DT)


def test_buses_are_taken_apart_changed_and_made(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "in", {"OutDataTypeStr": "Bus: Sensors"}),
        ("Inport", "p", {"Port": "2", "OutDataTypeStr": "double"}),
        ("BusSelector", "take", {"OutputSignals": "rates.p,rates,count", "Ports": "[1, 3]"}),
        ("Gain", "twice", {"Gain": "2"}),
        ("BusAssignment", "put", {"AssignedSignals": "rates.p", "Ports": "[2, 1]"}),
        ("BusCreator", "make", {"OutDataTypeStr": "Bus: Sensors", "Inputs": "2", "Ports": "[2, 1]"}),
        ("Outport", "twofold", {}),
        ("Outport", "changed", {"Port": "2"}),
        ("Outport", "again", {"Port": "3"}),
    ]
    lines = [("in", "take"), ("take:1", "twice"), ("twice", "twofold"), ("in", "put:1"), ("p", "put:2")]
    lines += [("put", "changed"), ("take:3", "make:1"), ("take:2", "make:2"), ("make", "again")]
    given = {"in.count": np.arange(200) % 256, "in.rates.p": DRAWN[0], "in.rates.axes": DRAWN.T.copy(), "p": DRAWN[1]}
    found = flown(imported(tmp_path, blocks, lines), given)
    assert np.array_equal(found["twofold"], 2 * DRAWN[0])
    assert np.array_equal(found["changed.rates.p"], DRAWN[1])
    for bus in ("changed", "again"):
        assert np.array_equal(found[f"{bus}.rates.axes"], DRAWN.T)
        assert np.array_equal(found[f"{bus}.count"], np.arange(200) % 256)
    assert np.array_equal(found["again.rates.p"], DRAWN[0])


def test_a_bus_without_an_object_has_the_names_of_its_lines(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "a", {"OutDataTypeStr": "double"}),
        ("Inport", "b", {"Port": "2", "OutDataTypeStr": "boolean"}),
        ("BusCreator", "make", {"Inputs": "2", "Ports": "[2, 1]"}),
        ("UnitDelay", "z", {}),
        ("BusSelector", "take", {"OutputSignals": "signal2,roll rate", "Ports": "[1, 2]"}),
        ("Outport", "y", {}),
        ("Outport", "q", {"Port": "2"}),
    ]
    lines = [("a", "make:1"), ("b", "make:2"), ("make", "z"), ("z", "take"), ("take:1", "y"), ("take:2", "q")]
    files = model(blocks, lines)
    name = "simulink/blockdiagram.xml"
    files[name] = files[name].replace('<Line><P Name="Src">1#', '<Line><P Name="Name">roll rate</P><P Name="Src">1#')
    on = DRAWN[1] > 0
    found = flown(import_system(read_model(slx(files, tmp_path / "m.slx")), dt=DT), {"a": DRAWN[0], "b": on})
    assert np.array_equal(found["y"], np.r_[False, on[:-1]])
    assert np.array_equal(found["q"], np.r_[0.0, DRAWN[0][:-1]])


def test_a_structure_is_a_constant_a_start_value_and_has_gains(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "on", {"OutDataTypeStr": "boolean"}),
        ("Constant", "first", {"Value": "start", "OutDataTypeStr": "Bus: Sensors"}),
        ("Constant", "zero", {"Value": "0", "OutDataTypeStr": "Bus: Sensors"}),
        ("Switch", "choose", {"Criteria": "u2 ~= 0"}),
        ("UnitDelay", "z", {"InitialCondition": "start"}),
        ("BusSelector", "take", {"OutputSignals": "rates.p", "Ports": "[1, 1]"}),
        ("Gain", "k", {"Gain": "start.rates.axes(3)"}),
        ("Outport", "y", {}),
    ]
    lines = [("first", "choose:1"), ("on", "choose:2"), ("zero", "choose:3"), ("choose", "z"), ("z", "take")]
    lines += [("take", "k"), ("k", "y")]
    on = DRAWN[0] > 0
    found = flown(imported(tmp_path, blocks, lines), {"on": on})
    assert np.array_equal(found["y"], 3 * np.r_[1.5, np.where(on, 1.5, 0.0)[:-1]])


@pytest.mark.parametrize(
    ("block", "said"),
    [
        (("BusSelector", "b", {"OutputSignals": "rates.q"}), "the bus Sensors has no element rates.q"),
        (("BusSelector", "b", {"OutputSignals": "count.p"}), "the bus Sensors has no element count.p"),
        (("Gain", "b", {"Gain": "2"}), "an input that is the bus Sensors is not translated"),
        (("BusCreator", "b", {"Inputs": "1", "OutDataTypeStr": "Bus: Sensors"}), "does not have 1 elements"),
        (("BusCreator", "b", {"Inputs": "1", "OutDataTypeStr": "Bus: Else"}), "the bus Else has no value"),
    ],
)
def test_what_does_not_fit_a_bus_is_refused(tmp_path: Path, block: tuple, said: str) -> None:
    blocks = [("Inport", "in", {"OutDataTypeStr": "Bus: Sensors"}), block, ("Outport", "y", {})]
    (refused,) = imported(tmp_path, blocks, [("in", "b"), ("b", "y")]).refused
    assert refused.path == "b"
    assert said in refused.why


ENTRY = '<Object Class="DD.ENTRY"><P Name="Name" Class="char">{name}</P>{value}</Object>'
OBJECT = '<P Name="Value"><Element Class="{kind}">{body}</Element></P>'
PARAMETER = (
    '<P Name="Value" Class="double" Dimension="2*2">1.25 2.0 3.1 4.0</P><P Name="DataType" Class="char">single</P>'
)
BUS = (
    '<P Name="Elements_internal"><Element Class="Simulink.BusElement"><P Name="Name" Class="char">mode</P>'
    '<P Name="DataType_internal" Class="char">Enum: Mode</P><P Name="Dimensions" Class="double">1.0</P></Element></P>'
)
MODE = (
    '<P Name="Enumerals" Class="struct" Dimension="1*2"><Element><P Name="Name" Class="char">idle</P>'
    '<P Name="Value" Class="char">0</P></Element><Element><P Name="Name" Class="char">armed</P>'
    '<P Name="Value" Class="char">5</P></Element></P>'
)
PLANT = (
    '<P Name="Value" Class="struct"><Element><P Name="m" Class="double">2.5</P>'
    '<P Name="on" Class="logical">1</P></Element></P>'
)


def sldd(path: Path, *entries: str, refers: str = "") -> None:
    more = f'<Object Class="DD.DICTIONARYREFERENCE"><P Name="Subdictionary">{refers}</P></Object>' if refers else ""
    slx({"data/chunk0.xml": f"<DataSource>{''.join(entries)}{more}</DataSource>"}, path)


def test_a_dictionary_has_values_buses_and_enumerations(tmp_path: Path) -> None:
    objects = (("K", "Simulink.Parameter", PARAMETER), ("Command", "Simulink.Bus", BUS))
    enumeration = ("Mode", "Simulink.data.dictionary.EnumTypeDefinition", MODE)
    made = [ENTRY.format(name=n, value=OBJECT.format(kind=k, body=b)) for n, k, b in (*objects, enumeration)]
    sldd(tmp_path / "top.sldd", *made[:2], refers="below.sldd")
    sldd(tmp_path / "below.sldd", made[2], ENTRY.format(name="plant", value=PLANT), refers="top.sldd")
    values = dictionary("top.sldd", [tmp_path])
    # Numbers stand column after column; a parameter has its own type.
    assert np.array_equal(values["K"]["Value"], np.array([[1.25, 3.1], [2.0, 4.0]], dtype=np.float32))
    assert evaluate("Mode.armed + Mode(5)", values) == 10
    blocks = [
        ("Inport", "in", {"OutDataTypeStr": "Bus: Command"}),
        ("BusSelector", "take", {"OutputSignals": "mode", "Ports": "[1, 1]"}),
        ("Constant", "armed", {"Value": "Mode.armed"}),
        ("RelationalOperator", "is", {"Operator": "==", "Ports": "[2, 1]"}),
        ("Constant", "m", {"Value": "plant.m"}),
        ("Outport", "y", {}),
        ("Outport", "mass", {"Port": "2"}),
    ]
    lines = [("in", "take"), ("take", "is:1"), ("armed", "is:2"), ("is", "y"), ("m", "mass")]
    files = model(blocks, lines)
    name = "simulink/blockdiagram.xml"
    files[name] = files[name].replace("<Model>", '<Model><P Name="DataDictionary">top.sldd</P>')
    read = read_model(slx(files, tmp_path / "m.slx"))
    assert inspect(read, [tmp_path]).names == {}
    found = flown(import_system(read, folders=[tmp_path], dt=DT), {"in.mode": np.arange(200) % 7})
    assert np.array_equal(found["y"], np.arange(200) % 7 == 5)
    assert set(found["mass"]) == {2.5}
    lost = import_system(read, dt=DT)
    assert "the data dictionary top.sldd is not found" in lost.notes[0]
    assert {line.path for line in lost.refused} >= {"in", "armed", "m"}


def test_an_enumeration_is_found_in_the_file_of_its_class(tmp_path: Path) -> None:
    code = "classdef Mode < Simulink.IntEnumType\n enumeration\n idle(0) % at rest(9)\n armed (3)\n end\nend\n"
    (tmp_path / "Mode.m").write_text(code, encoding="utf-8")
    blocks = [("Constant", "c", {"Value": "Mode.armed"}), ("Outport", "y", {})]
    assert set(flown(imported(tmp_path, blocks, [("c", "y")]), {})["y"]) == {3}


def test_a_damaged_dictionary_is_a_note_not_a_fault(tmp_path: Path) -> None:
    (tmp_path / "bad.sldd").write_bytes(b"PK\x03\x04 nothing")
    slx({"data/chunk0.xml": '<!DOCTYPE a [<!ENTITY b "c">]><DataSource/>'}, tmp_path / "bomb.sldd")
    sldd(tmp_path / "odd.sldd", ENTRY.format(name="a", value='<P Name="Value" Class="double" Dimension="9*9">1</P>'))
    for name in ("bad.sldd", "bomb.sldd", "../odd.sldd"):
        with pytest.raises(DiagramError):
            dictionary(name, [tmp_path])
    assert dictionary("odd.sldd", [tmp_path]) == {}


def test_a_bus_in_itself_is_refused(tmp_path: Path) -> None:
    code = "A = Simulink.Bus; A.Elements = struct('Name', 'a', 'DataType', 'Bus: A');"
    found = imported(tmp_path, [("Inport", "u", {"OutDataTypeStr": "Bus: A"}), ("Terminator", "t", {})], [], code)
    assert "is nested more than 8 deep" in found.refused[0].why


def test_a_whole_number_of_hexadecimal_digits_has_their_type() -> None:
    assert evaluate("0x1F", {}).dtype == np.uint8
    assert evaluate("0x0100 + 1", {})[0, 0] == 257
