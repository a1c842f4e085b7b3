"""Data types of Simulink: buses, dictionaries, integers; values by hand from Simulink's documented rules."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.slx.files import model, model_of, slx
from tests.slx.test_import import DRAWN, DT, flown
from twodof.blocks.bus import Bus
from twodof.errors import DiagramError
from twodof.slx.data_types import kind_of
from twodof.slx.dictionary import dictionary
from twodof.slx.importer import Imported, import_system
from twodof.slx.inspection import inspect
from twodof.slx.matlab.program import evaluate
from twodof.slx.matlab.script import run
from twodof.slx.model import read_model

pytestmark = pytest.mark.slow

BUSES = """
elems(1) = Simulink.BusElement;
elems(1).Name = 'p'; elems(1).DataType = 'double';
elems(2) = Simulink.BusElement;
elems(2).Name = 'axes'; elems(2).Dimensions = 3;
elems(3) = Simulink.BusElement; elems(3).Name = 'on'; elems(3).DataType = 'boolean';
Rates = Simulink.Bus; Rates.Elements = elems;
clear elems;
elems(1) = Simulink.BusElement;
elems(1).Name = 'count'; elems(1).DataType = 'uint8';
elems(2) = Simulink.BusElement;
elems(2).Name = 'rates'; elems(2).DataType = 'Bus: Rates';
Sensors = Simulink.Bus;
Sensors.Elements = elems;
start.count = 7; start.rates.p = 1.5; start.rates.axes = [1 2 3];
start.rates.on = true;
"""


def imported(tmp_path: Path, blocks: list, lines: list, code: str = BUSES) -> Imported:
    names: dict[str, object] = {}
    assert run(code, names) == []
    return import_system(read_model(slx(model(blocks, lines), tmp_path / "m.slx")), "", names, [tmp_path], DT)


def test_buses_are_joined_to_an_array(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "a", {"OutDataTypeStr": "Bus: Rates"}),
        ("Inport", "b", {"Port": "2", "OutDataTypeStr": "Bus: Rates"}),
        ("Concatenate", "join", {"NumInputs": "2", "Ports": "[2, 1]"}),
        ("Outport", "y", {}),
    ]
    lines = [("a", "join:1"), ("b", "join:2"), ("join", "y")]
    given = {f"{name}.p": DRAWN[k] for k, name in enumerate("ab")}
    given |= {"a.axes": DRAWN.T.copy(), "b.axes": -DRAWN.T, "a.on": DRAWN[0] > 0, "b.on": DRAWN[1] > 0}
    found = flown(imported(tmp_path, blocks, lines), given)
    assert np.array_equal(found["y.p"], DRAWN[:2].T)
    assert np.array_equal(found["y.on"], DRAWN[:2].T > 0)
    assert np.array_equal(found["y.axes"], np.stack([DRAWN.T, -DRAWN.T], axis=1))


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
    given = {
        "in.count": np.arange(200) % 256,
        "in.rates.p": DRAWN[0],
        "in.rates.axes": DRAWN.T.copy(),
        "in.rates.on": np.ones(200, bool),
        "p": DRAWN[1],
    }
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


def test_a_line_without_a_name_has_that_of_the_line_across_its_subsystems_border(tmp_path: Path) -> None:
    def passing(name: str) -> tuple[Any, ...]:
        inner = ([("Inport", "in", {}), ("Outport", "out", {})], [("in", "out")])
        return "SubSystem", name, {"Ports": "[1, 1]"}, inner

    blocks = [("Inport", "a", {}), ("Inport", "b", {"Port": "2"}), passing("into"), passing("out of"),
              ("BusCreator", "make", {"Inputs": "2", "Ports": "[2, 1]"}), ("Outport", "y", {}),
              ("BusSelector", "take", {"OutputSignals": "roll rate", "Ports": "[1, 1]"})]  # fmt: skip
    lines = [("a", "into"), ("b", "out of"), ("out of", "make:1"), ("into", "make:2"), ("make", "take"), ("take", "y")]
    files = model(blocks, lines)
    name = "simulink/blockdiagram.xml"
    files[name] = files[name].replace('<Line><P Name="Src">1#', '<Line><P Name="Name">roll rate</P><P Name="Src">1#')
    found = flown(import_system(read_model(slx(files, tmp_path / "m.slx")), dt=DT), {"a": DRAWN[0], "b": DRAWN[1]})
    assert np.array_equal(found["y"], DRAWN[0])


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
    objects = (("K", "House.Parameter", PARAMETER), ("Command", "Simulink.Bus", BUS))
    enumeration = ("Mode", "Simulink.data.dictionary.EnumTypeDefinition", MODE)
    made = [ENTRY.format(name=n, value=OBJECT.format(kind=k, body=b)) for n, k, b in (*objects, enumeration)]
    sldd(tmp_path / "top.sldd", *made[:2], refers="below.sldd")
    sldd(tmp_path / "below.sldd", made[2], ENTRY.format(name="plant", value=PLANT), refers="top.sldd")
    values = dictionary("top.sldd", [tmp_path])
    # Numbers stand column after column; a parameter has its own type, and may be of a package of the user's.
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
    source = {"SourceBlock": "simulink/Logic and Bit Operations/Compare To Constant"}
    files = model([("Inport", "u", {"OutDataTypeStr": "int32"}), ("Reference", "is", source), ("Outport", "y", {})],
                  [("u", "is"), ("is", "y")])  # fmt: skip
    name, given = "simulink/blockdiagram.xml", '<P Name="relop">==</P><P Name="const">Mode.armed</P>'
    files[name] = files[name].replace('Name="is" SID="2">', f'Name="is" SID="2"><InstanceData>{given}</InstanceData>')
    read = read_model(slx(files, tmp_path / "linked.slx"))
    assert inspect(read, [tmp_path]).names == {}
    found = flown(import_system(read, folders=[tmp_path], dt=DT), {"u": np.arange(200) % 5})
    assert np.array_equal(found["y"], np.arange(200) % 5 == 3)


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


def test_a_function_gives_the_buses_that_it_assigns_in_the_workspace(tmp_path: Path) -> None:
    ending = "assignin('base', 'Given', Sensors);\nend\nfunction more()\nx = 1;\nend"
    code = f"% buses\nfunction define(varargin)\n{BUSES}{ending}"
    names: dict[str, object] = {"Rates": 5}
    assert run(code, names) == []
    assert [one["Name"] for one in names["Given"]["Elements"]] == ["count", "rates"]  # type: ignore[index]
    assert set(names) == {"Rates", "Given"}
    assert names["Rates"] == 5
    assert [one.line for one in run("\nfunction define\nx = 1;\ny = load('a');", names)] == [4]


@pytest.mark.parametrize("last", ["end\n", ""])
def test_a_saved_cell_array_gives_its_buses(last: str) -> None:
    """Whether the function ends with its own end or with that of its last if."""
    code = """function cells = define(varargin)
    quiet = false;
    if nargin == 1 && islogical(varargin{1}) && varargin{1} == false
      quiet = true;
    elseif nargin > 1 || (nargin == 1 && varargin{2})
      error('no');
    end
    cells = {{'Out', '', '', 'Auto', '-1', { ...
      {'stamp', 1, 'uint32', -1, 'real', 'Sample', 'Fixed', [], [], sprintf('ms'), ''}; ...
      {'speed', [3 1], 'single', -1, 'real', 'Sample', 'Fixed', [], [], '', ''} ...
    }}}';
    if ~quiet
      Simulink.Bus.cellToObject(cells)
    end
    """
    names: dict[str, Any] = {}
    assert run(code + last, names) == []
    (kind,) = [kind_of(f"Bus: {name}", names) for name in names]
    assert isinstance(kind, Bus)
    assert [(port.name, port.kind, port.width) for port in kind.fields] == [
        ("stamp", "uint32", None), ("speed", "real", 3)
    ]  # fmt: skip


# --- whole numbers

INT8 = np.arange(-128, 128, dtype=np.int64).repeat(2)[:200]
OTHER = np.random.default_rng(2).integers(-128, 128, 200)


def wrapped(values: np.ndarray, kind: str) -> np.ndarray:
    """The low bits of whole numbers, by numpy."""
    return values.astype(np.int64).astype(kind)


def saturated(values: np.ndarray, kind: str) -> np.ndarray:
    limits = np.iinfo(kind)
    return np.clip(values, limits.min, limits.max).astype(kind)


def relayed(u: np.ndarray) -> list[int]:
    """1 from 20 on, -3 from -20 down, else as before."""
    found, on = list[int](), False
    for one in u:
        on = one >= 20 or (on and one > -20)
        found.append(1 if on else -3)
    return found


def counted(u: np.ndarray, clear: np.ndarray) -> list[int]:
    """The sum of truths so far, between 1 and 3, and afresh where `clear` falls."""
    found, x, before = list[int](), 0, False
    for one, now in zip(u, clear, strict=True):
        x = min(max(0 if before and not now else x, 1), 3)
        found.append(x)
        x, before = min(x + one, 3), now
    return found


WRAP, SATURATE = {"SaturateOnIntegerOverflow": "off"}, {"SaturateOnIntegerOverflow": "on"}


def of_kinds(tmp_path: Path, block: tuple, kinds: tuple[str, ...]) -> Imported:
    """Import a model of one block with inputs u1, u2, ... of these types."""
    blocks = [("Inport", f"u{k}", {"Port": str(k), "OutDataTypeStr": one}) for k, one in enumerate(kinds, start=1)]
    lines = [*((f"u{k}", f"b:{k}") for k in range(1, len(kinds) + 1)), ("b", "y")]
    kind, values = block
    return imported(tmp_path, [*blocks, (kind, "b", values), ("Outport", "y", {})], lines)


@pytest.mark.parametrize(
    ("block", "kinds", "given", "wanted"),
    [
        (("Sum", WRAP), ("int8", "int8"), (INT8, OTHER), wrapped(INT8 + OTHER, "int8")),
        (("Sum", SATURATE), ("int8", "int8"), (INT8, OTHER), saturated(INT8 + OTHER, "int8")),
        (("Sum", {"Inputs": "-+", **SATURATE}), ("uint8", "uint8"), (INT8 + 128, OTHER + 128),
         saturated(OTHER - INT8, "uint8")),
        (("Sum", {"OutDataTypeStr": "int32", "Inputs": "+-+"}), ("uint8", "int8", "boolean"),
         (INT8 + 128, OTHER, OTHER > 0), INT8 + 128 - OTHER + (OTHER > 0)),
        (("Sum", WRAP), ("int32", "int32"), (INT8 << 24, OTHER << 24), wrapped((INT8 + OTHER) << 24, "int32")),
        (("Sum", SATURATE), ("uint32", "uint32"), ((INT8 + 128) << 24, (OTHER + 128) << 24),
         saturated((INT8 + OTHER + 256) << 24, "uint32")),
        (("Product", WRAP), ("int16", "int16"), (INT8 * 251, OTHER * 7), wrapped(INT8 * 251 * OTHER * 7, "int16")),
        (("Product", SATURATE), ("int16", "int16"), (INT8 * 251, OTHER * 7),
         saturated(INT8 * 251 * OTHER * 7, "int16")),
        (("Product", WRAP), ("uint32", "uint32"), ((INT8 + 128) << 20, (OTHER + 128) << 9),
         wrapped(((INT8 + 128) << 20) * ((OTHER + 128) << 9), "uint32")),
        (("Gain", {"Gain": "3", **WRAP}), ("uint8",), (INT8 + 128,), wrapped(3 * (INT8 + 128), "uint8")),
        # A gain of 16 bits: 33554 / 2^25, the 0.000999987125F of MathWorks' C.
        (("Gain", {"Gain": ".001", "OutDataTypeStr": "double"}), ("uint16",), ((INT8 + 128) * 257,),
         (INT8 + 128) * 257 * (33554 / 2**25)),
        (("Gain", {"Gain": ".1", "OutDataTypeStr": "double", "ParamDataTypeStr": "double"}), ("int16",), (INT8,),
         0.1 * INT8),
        (("Gain", {"Gain": "-.001", "OutDataTypeStr": "double"}), ("int16",), (INT8 * 255,),
         INT8 * 255 * (-16777 / 2**24)),
        (("Gain", {"Gain": ".3", "OutDataTypeStr": "double"}), ("boolean",), (OTHER > 0,), 0.3 * (OTHER > 0)),
        (("Sum", {"Inputs": "++", "OutDataTypeStr": "Inherit: Inherit via internal rule", **WRAP}),
         ("uint8", "boolean"), (INT8 + 128, OTHER > 0), wrapped(INT8 + 128 + (OTHER > 0), "uint8")),
        (("Logic", {"Operator": "OR", "OutDataTypeStr": "uint8"}), ("boolean", "int8"), (OTHER > 50, INT8),
         (OTHER > 50) | (INT8 != 0)),
        (("Relay", {"OnSwitchValue": "20", "OffSwitchValue": "-20", "OffOutputValue": "-3"}), ("int8",), (OTHER,),
         relayed(OTHER)),
        (("Reference", {"SourceBlock": "simulink/Logic and Bit Operations/Interval Test", "lowlimit": "[-9 3]",
                        "uplimit": "[5 90]"}), ("int8",), (OTHER,),
         (OTHER[:, None] >= [-9, 3]) & (OTHER[:, None] <= [5, 90])),
        (("Reference", {"SourceBlock": "simulink/Logic and Bit Operations/Detect Increase"}), ("uint32",),
         ((OTHER + 128) << 24,), np.diff(OTHER, prepend=-128) > 0),
        (("Reference", {"SourceBlock": "simulink/Logic and Bit Operations/Detect Rise Positive", "vinit": "1"}),
         ("boolean",), (OTHER > 0,), (OTHER > 0) & ~np.r_[True, OTHER[:-1] > 0]),
        (("LookupNDDirect", {"NumberOfTableDimensions": "2", "Table": "[1 2 3;4 5 6]"}), ("uint8", "uint8"),
         ((INT8 + 128) % 4, (OTHER + 128) % 3),
         np.array([[1, 2, 3], [4, 5, 6]])[np.minimum((INT8 + 128) % 4, 1), (OTHER + 128) % 3]),
        (("DiscreteIntegrator", {"IntegratorMethod": "Accumulation: Forward Euler", "OutDataTypeStr": "uint32",
                                 "ExternalReset": "falling", "LimitOutput": "on", "UpperSaturationLimit": "3",
                                 "LowerSaturationLimit": "1"}), ("boolean", "boolean"), (OTHER > -60, OTHER > 0),
         counted(OTHER > -60, OTHER > 0)),
        (("Abs", SATURATE), ("int8",), (INT8,), saturated(np.abs(INT8), "int8")),
        (("Abs", WRAP), ("int8",), (INT8,), wrapped(np.abs(INT8), "int8")),
        (("UnaryMinus", SATURATE), ("int8",), (INT8,), saturated(-INT8, "int8")),
        (("Bias", {"Bias": "-100", **WRAP}), ("uint8",), (INT8 + 128,), wrapped(INT8 + 28, "uint8")),
        (("MinMax", {"Function": "min", "Inputs": "2"}), ("int16", "int16"), (INT8, OTHER), np.minimum(INT8, OTHER)),
        (("Saturate", {"LowerLimit": "-5", "UpperLimit": "inf"}), ("int8",), (INT8,), np.maximum(INT8, -5)),
        (("DataTypeConversion", {"OutDataTypeStr": "uint8", **WRAP}), ("int32",), (OTHER * 1009,),
         wrapped(OTHER * 1009, "uint8")),
        (("DataTypeConversion", {"OutDataTypeStr": "uint16", **SATURATE}), ("int32",), (OTHER * 1009,),
         saturated(OTHER * 1009, "uint16")),
        (("DataTypeConversion", {"OutDataTypeStr": "fixdt(1,8,0)", **WRAP, "RndMeth": "Floor"}), ("double",),
         (DRAWN[0] * 1e11,), wrapped(np.floor(DRAWN[0] * 1e11), "int8")),
        (("DataTypeConversion", {"OutDataTypeStr": "int32", **WRAP, "RndMeth": "Zero"}), ("double",),
         (DRAWN[0] * 1e11,), wrapped(np.trunc(DRAWN[0] * 1e11), "int32")),
        (("DataTypeConversion", {"OutDataTypeStr": "boolean"}), ("int8",), (INT8,), INT8 != 0),
        (("DataTypeConversion", {"OutDataTypeStr": "double"}), ("uint32",), ((INT8 + 128) << 24,), (INT8 + 128) << 24),
        (("RelationalOperator", {"Operator": "<"}), ("uint8", "int8"), (INT8 + 128, OTHER), INT8 + 128 < OTHER),
        (("RelationalOperator", {"Operator": "=="}), ("boolean", "boolean"), (INT8 > 0, OTHER > 0),
         (INT8 > 0) == (OTHER > 0)),
        (("RelationalOperator", {"Operator": ">="}), ("int8", "double"), (INT8, DRAWN[0] * 50), DRAWN[0] * 50 <= INT8),
        (("RelationalOperator", {"Operator": "isNaN", "Ports": "[1, 1]"}), ("double",),
         (np.where(INT8 > 9, np.nan, 1.0),), INT8 > 9),
        (("CompareToConstant", {"relop": ">", "const": "7", "OutDataTypeStr": "uint8"}), ("uint8",), (INT8 + 128,),
         INT8 + 128 > 7),
        (("CompareToConstant", {"relop": "==", "const": "[2 5]"}), ("uint8",), (INT8 + 128,),
         (INT8 + 128)[:, None] == [2, 5]),
        (("Switch", {"Criteria": "u2 > Threshold", "Threshold": "9"}), ("uint16", "int8", "uint32"),
         (INT8 + 128, OTHER, (OTHER + 128) << 20), np.where(OTHER > 9, INT8 + 128, (OTHER + 128) << 20)),
        (("DiscreteIntegrator", {"IntegratorMethod": "Accumulation: Forward Euler", "InitialCondition": "7"}),
         ("uint32",), ((INT8 + 128) << 24,), wrapped(7 + np.r_[0, np.cumsum((INT8 + 128) << 24)[:-1]], "uint32")),
        (("Decrement Real World", {}), ("int8",), (INT8,), wrapped(INT8 - 1, "int8")),
        (("Bitwise Operator", {"logicop": "XOR", "BitMask": "85"}), ("uint8",), (INT8 + 128,), (INT8 + 128) ^ 85),
        (("Bitwise Operator", {"logicop": "NOT", "UseBitMask": "off"}), ("uint16",), (INT8 + 128,), 65407 - INT8),
        (("Bitwise Operator", {"logicop": "NAND", "UseBitMask": "off"}), ("int8", "int8"), (INT8, OTHER),
         ~(INT8 & OTHER)),
        (("ArithShift", {"BitShiftNumber": "2", "BitShiftDirection": "Left"}), ("uint8",), (INT8 + 128,),
         wrapped((INT8 + 128) << 2, "uint8")),
        (("ArithShift", {"BitShiftNumber": "3", "BitShiftDirection": "Right"}), ("int8",), (INT8,), INT8 >> 3),
    ],
)  # fmt: skip
def test_whole_numbers_are_rounded_saturated_or_wrapped(
    tmp_path: Path, block: tuple, kinds: tuple[str, ...], given: tuple[np.ndarray, ...], wanted: np.ndarray
) -> None:
    named = {"Bitwise Operator": "simulink/Logic and Bit Operations/Bitwise Operator"}
    named["Decrement Real World"] = "simulink/Additional Math/Decrement Real World"
    if block[0] in named:
        block = ("Reference", {"SourceBlock": named[block[0]], **block[1]})
    found = flown(of_kinds(tmp_path, block, kinds), {f"u{k + 1}": one for k, one in enumerate(given)})
    assert np.array_equal(found["y"], wanted)


@pytest.mark.parametrize(
    ("rounding", "wanted"),
    [
        ("Floor", [-3, -2, -1, 0, 0, 0, 1, 2]),
        ("Ceiling", [-2, -1, 0, 0, 1, 1, 2, 3]),
        ("Zero", [-2, -1, 0, 0, 0, 0, 1, 2]),
        ("Nearest", [-2, -1, 0, 0, 0, 1, 2, 3]),
        ("Round", [-3, -2, -1, 0, 0, 1, 2, 3]),
        ("Convergent", [-2, -2, 0, 0, 0, 0, 2, 2]),
    ],
)
def test_each_rounding_goes_where_simulink_says(tmp_path: Path, rounding: str, wanted: list[int]) -> None:
    block = ("DataTypeConversion", {"OutDataTypeStr": "int8", "RndMeth": rounding})
    given = np.array([-2.5, -1.5, -0.5, 0.0, 0.25, 0.5, 1.5, 2.5])
    found = of_kinds(tmp_path, block, ("double",))
    assert flown(found, {"u1": given}, 8)["y"].tolist() == wanted


@pytest.mark.parametrize(("rounding", "of"), [("Floor", np.floor), ("Zero", np.trunc), ("Ceiling", np.ceil)])
def test_a_quotient_of_whole_numbers_is_rounded_and_by_0_the_largest(tmp_path: Path, rounding: str, of: Any) -> None:
    a, b = np.array([7, -7, 7, -128, 5, -5, 0]), np.array([2, 2, -2, -1, 0, 0, 0])
    found = of_kinds(tmp_path, ("Product", {"Inputs": "*/", "RndMeth": rounding, **SATURATE}), ("int8", "int8"))
    wanted = [*np.clip(of(a[:4] / b[:4]), -128, 127).astype(int), 127, -128, 127]
    assert flown(found, {"u1": a, "u2": b}, len(a))["y"].tolist() == wanted


def test_a_product_of_doubles_may_be_a_whole_number(tmp_path: Path) -> None:
    block = ("Product", {"Inputs": "*//", "OutDataTypeStr": "int32", "RndMeth": "Zero"})
    found = of_kinds(tmp_path, block, ("double",) * 3)
    a, b, c = DRAWN
    assert np.array_equal(flown(found, {"u1": 1e3 * a, "u2": b, "u3": c})["y"], np.trunc(1e3 * a / b / c))


@pytest.mark.parametrize(
    ("block", "kinds", "other", "wanted"),
    [
        (("Sum", {}), ("int8", "int8"), OTHER, wrapped(INT8 + OTHER, "int8")),
        (("Sum", {}), ("int8", "double"), 0.5, INT8 + 0.5),
        (("Gain", {"Gain": "2", "OutDataTypeStr": "int8"}), ("int8",), 0, wrapped(2 * INT8, "int8")),
        (("Product", {"Inputs": "*/"}), ("int8", "double"), 49.0, INT8 / 49.0),
        (("Product", {"OutDataTypeStr": "int8"}), ("double", "double"), 0.3, np.floor(INT8 * 0.3)),
    ],
)
def test_a_file_without_defaults_means_those_of_its_releases(
    tmp_path: Path, block: tuple, kinds: tuple[str, ...], other: Any, wanted: np.ndarray
) -> None:
    """Files since R2022a have none, and name Saturate, Zero and Same as first input where these are chosen."""
    given = {"u1": INT8, "u2": np.broadcast_to(other, INT8.shape)}
    found = flown(of_kinds(tmp_path, block, kinds), {f"u{k}": given[f"u{k}"] for k in range(1, len(kinds) + 1)})
    assert np.array_equal(found["y"], wanted)


@pytest.mark.parametrize(("kind", "of"), [("boolean", DRAWN[:3] > -0.5), ("int8", np.int8(DRAWN[:2] * 20))])
def test_a_product_of_one_vector_of_whole_numbers_is_that_of_its_elements(tmp_path: Path, kind: str, of: Any) -> None:
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": kind, "PortDimensions": str(len(of))}),
        ("Product", "p", {"Inputs": "1", "OutDataTypeStr": "double"}),
        ("Outport", "y", {}),
    ]
    found = flown(imported(tmp_path, blocks, [("u", "p"), ("p", "y")]), {"u": of.T})
    assert np.array_equal(found["y"], np.prod(of, axis=0, dtype=float))
    assert len(set(found["y"])) > 1


@pytest.mark.parametrize(("mask", "wanted"), [("off", [0b010, 0b000]), ("on", [[0b111, 0b010], [0b001, 0b110]])])
def test_bits_of_one_vector_are_combined_into_one_number_without_a_mask(
    tmp_path: Path, mask: str, wanted: list[Any]
) -> None:
    bits = {"SourceBlock": "simulink/Logic and Bit Operations/Bitwise Operator", "logicop": "AND", "BitMask": "255",
            "UseBitMask": mask, "NumInputPorts": "1"}  # fmt: skip
    blocks = [("Inport", "u", {"OutDataTypeStr": "uint8", "PortDimensions": "2"}), ("Reference", "b", bits)]
    found = imported(tmp_path, [*blocks, ("Outport", "y", {})], [("u", "b"), ("b", "y")])
    assert flown(found, {"u": np.array([[0b111, 0b010], [0b001, 0b110]])}, 2)["y"].tolist() == wanted


def test_an_input_that_nothing_drives_is_0_of_its_type(tmp_path: Path) -> None:
    code = "e(1) = Simulink.BusElement; e(1).Name = 'n'; e(1).DataType = 'uint8'; B = Simulink.Bus; B.Elements = e;"
    names: dict[str, Any] = {}
    assert run(code, names) == []
    blocks = [("Constant", "k", {"Value": "0", "OutDataTypeStr": "Bus: B"}),
              ("BusAssignment", "b", {"AssignedSignals": "n", "Ports": "[2, 1]"}), ("Outport", "y", {})]  # fmt: skip
    file = model_of(blocks, [("k", "b:1"), ("b", "y")], tmp_path / "m.slx")
    found = import_system(read_model(file), "", names, dt=0.01)
    assert not np.any(flown(found, {})["y.n"])


@pytest.mark.parametrize(
    ("block", "kinds", "said"),
    [
        (("Gain", {"Gain": ".5"}), ("int8",), "its scaling is not known"),
        (("Product", {"Inputs": "/*"}), ("int8", "int8"), "Inputs = '/*' of int8 is not translated"),
        (("Sum", {"OutDataTypeStr": "Inherit: Inherit via internal rule"}), ("int8", "int16"), "of int16 and int8"),
        (("Sum", {"OutDataTypeStr": "fixdt(1,16,11)"}), ("double", "double"), "the data type 'fixdt(1,16,11)'"),
        (("CompareToConstant", {"const": "2.5"}), ("uint8",), "a comparison of uint8 with 2.5"),
        (("DiscreteIntegrator", {}), ("uint32",), "IntegratorMethod = 'Integration: Forward Euler'"),
    ],
)
def test_what_the_file_does_not_say_is_refused(tmp_path: Path, block: tuple, kinds: tuple[str, ...], said: str) -> None:
    (refused,) = of_kinds(tmp_path, block, kinds).refused
    assert said in refused.why


def test_a_sum_begins_with_the_first_that_is_added(tmp_path: Path) -> None:
    a, b, c = DRAWN
    found = of_kinds(tmp_path, ("Sum", {"Inputs": "--+"}), ("double",) * 3)
    assert np.array_equal(flown(found, {"u1": a, "u2": b, "u3": c})["y"], (c - a) - b)
    assert not np.array_equal((c - a) - b, (-a - b) + c)


def test_a_state_in_a_loop_takes_the_type_of_what_is_added(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "int16", "PortDimensions": "3"}),
        ("UnitDelay", "z", {}),
        ("Sum", "sum", {"Ports": "[2, 1]", **WRAP}),
        ("Gain", "twice", {"Gain": "2", **WRAP}),
        ("Outport", "y", {}),
    ]
    lines = [("z", "twice"), ("twice", "sum:1"), ("u", "sum:2"), ("sum", "z"), ("sum", "y")]
    u = np.random.default_rng(4).integers(-900, 900, (200, 3))
    state, wanted = np.zeros(3, dtype=np.int64), []
    for row in u:
        state = wrapped(2 * state + row, "int16").astype(np.int64)
        wanted.append(state)
    assert np.array_equal(flown(imported(tmp_path, blocks, lines), {"u": u})["y"], wanted)


def test_a_loop_of_truths_is_one_of_truths(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "set", {"OutDataTypeStr": "boolean"}),
        ("Memory", "z", {}),
        ("Logic", "or", {"Operator": "OR", "Ports": "[2, 1]"}),
        ("Outport", "y", {}),
    ]
    found = flown(imported(tmp_path, blocks, [("z", "or:1"), ("set", "or:2"), ("or", "z"), ("or", "y")]),
                  {"set": np.arange(200) == 50})  # fmt: skip
    assert found["y"].dtype == bool
    assert np.array_equal(found["y"], np.arange(200) >= 50)


def function(name: str, code: str, output: str = "", said: str = "Inherit: Same as Simulink") -> str:
    """The XML of a MATLAB Function, whose output may have a declared type."""
    data = f'<data SSID="2" name="{output}"><P Name="scope">OUTPUT_DATA</P><P Name="dataType">{said}</P></data>'
    script = f'<state SSID="1"><eml><P Name="script">{code}</P></eml></state>'
    head = f'<P Name="name">{name}</P><P Name="type">EML_CHART</P>'
    return f'<chart id="9">{head}<Children>{script}{data}</Children></chart>'


def test_a_bus_goes_round_a_loop_of_a_memory_and_functions(tmp_path: Path) -> None:
    """The functions declare the buses that they give; two names differ in a space at the end."""
    ports: list = [("Inport", "b", {}), ("Outport", "r", {})]
    kind = {"SFBlockType": "MATLAB Function", "Ports": "[1, 1]"}
    blocks = [("Memory", "z", {}), ("SubSystem", "f", kind, (ports, [])), ("SubSystem", "f ", kind, (ports, [])),
              ("Outport", "y", {"OutDataTypeStr": "Bus: Rates"})]  # fmt: skip
    lines = [("z", "f"), ("f", "f "), ("f ", "z"), ("f ", "y")]
    first = "function r = one(b)\nr = b; r.p = b.p + 1;"
    second = "function r = two(b)\nr = b; r.axes = b.axes + b.p * [1; 2; 3]; r.on = b.p > 3;"
    parts = {f"simulink/stateflow/chart_{n}.xml": function(name, code.replace(">", "&gt;"), "r", "Bus: Rates")
             for n, (name, code) in enumerate([("f", first), ("f ", second)])}  # fmt: skip
    names: dict[str, object] = {}
    assert run(BUSES, names) == []
    path = slx({**model(blocks, lines), **parts}, tmp_path / "m.slx")
    found = flown(import_system(read_model(path), "", names, [], DT), {}, 5)
    assert found["y.p"].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert found["y.axes"][:, 2].tolist() == [3.0, 9.0, 18.0, 30.0, 45.0]
    assert found["y.on"].tolist() == [False, False, False, True, True]


def test_a_bus_says_how_many_parts_a_for_each_has(tmp_path: Path) -> None:
    each: tuple = (
        [
            ("ForEach", "each", {}),
            ("Inport", "part", {"Partition": "on"}),
            ("UnitDelay", "z", {}),
            ("Outport", "out", {}),
        ],
        [("part", "z"), ("z", "out")],
    )
    blocks = [("Inport", "in", {"OutDataTypeStr": "Bus: Rates"}), ("BusSelector", "s", {"OutputSignals": "p,axes"}),
              ("SubSystem", "parts", {"Ports": "[1, 1]"}, each), ("Terminator", "end", {}),
              ("Outport", "y", {})]  # fmt: skip
    found = imported(tmp_path, blocks, [("in", "s"), ("s:1", "end"), ("s:2", "parts"), ("parts", "y")])
    axes = np.random.default_rng(3).normal(0.0, 1.0, (200, 3))
    got = flown(found, {"in.p": np.zeros(200), "in.axes": axes, "in.on": np.zeros(200, bool)})["y"]
    assert np.array_equal(got, np.vstack([np.zeros(3), axes[:-1]]))


def test_an_enumeration_that_only_a_library_names_is_found(tmp_path: Path) -> None:
    code = "classdef Gear < Simulink.IntEnumType\n enumeration\n low(3)\n high(7)\n end\nend\n"
    (tmp_path / "Gear.m").write_text(code)
    inside: tuple = ([("Constant", "k", {"Value": "double(Gear.high)"}), ("Outport", "out", {})], [("k", "out")])
    files = model([("SubSystem", "part", {"Ports": "[0, 1]"}, inside)], [])
    text = files["simulink/blockdiagram.xml"].replace("<Model>", "<Library>").replace("</Model>", "</Library>")
    slx({"simulink/blockdiagram.xml": text}, tmp_path / "parts.slx")
    blocks = [("Reference", "link", {"SourceBlock": "parts/part", "Ports": "[0, 1]"}), ("Outport", "y", {})]
    found = imported(tmp_path, blocks, [("link", "y")])
    assert flown(found, {}, 3)["y"].tolist() == [7.0, 7.0, 7.0]
    assert inspect(read_model(tmp_path / "m.slx"), [tmp_path]).names == {}


def test_recorded_data_have_the_type_that_their_block_declares(tmp_path: Path) -> None:
    blocks = [("FromWorkspace", "log", {"VariableName": "log", "OutDataTypeStr": "Bus: Rates"}),
              ("BusSelector", "s", {"OutputSignals": "on"}), ("Outport", "y", {})]  # fmt: skip
    on = np.arange(200) % 3 == 0
    given = {"log.p": np.zeros(200), "log.axes": np.zeros((200, 3)), "log.on": on}
    got = flown(imported(tmp_path, blocks, [("log", "s"), ("s", "y")]), given)["y"]
    assert got.dtype == bool
    assert np.array_equal(got, on)


def test_a_port_of_a_whole_bus_takes_the_type_that_is_declared_behind_it(tmp_path: Path) -> None:
    element = {"InterfaceIsComposite": "1", "InterfacePortName": "rates", "InterfaceElement": ""}
    inside: tuple = (
        [("Inport", "in", {"OutDataTypeStr": "Bus: Rates"}), ("BusSelector", "s", {"OutputSignals": "axes"}),
         ("Outport", "out", {})], [("in", "s"), ("s", "out")]
    )  # fmt: skip
    blocks = [("Inport", "a", element), ("SubSystem", "part", {"Ports": "[1, 1]"}, inside), ("Outport", "y", {})]
    found = imported(tmp_path, blocks, [("a", "part"), ("part", "y")])
    axes = np.random.default_rng(3).normal(0.0, 1.0, (200, 3))
    got = flown(found, {"rates.p": np.zeros(200), "rates.axes": axes, "rates.on": np.zeros(200, bool)})["y"]
    assert np.array_equal(got, axes)


def test_a_loop_through_a_matrix_is_as_wide_as_its_columns(tmp_path: Path) -> None:
    blocks = [
        ("Integrator", "x", {"InitialCondition": "1"}),
        ("Gain", "A", {"Gain": "[0 1; -4 0]", "Multiplication": "Matrix(K*u)"}),
        ("Outport", "y", {}),
    ]
    y = flown(imported(tmp_path, blocks, [("x", "A"), ("A", "x"), ("x", "y")]), {})["y"]
    t = DT * np.arange(200)  # x'' = -4 x from (1, 1); Runge-Kutta of fourth order, error of 2 h^5 / 120 a step
    assert np.allclose(y[:, 0], np.cos(2 * t) + 0.5 * np.sin(2 * t), atol=1e-7)


@pytest.mark.parametrize("kind", ["Constant", "Ground", "DataTypeConversion"])
def test_a_type_is_taken_from_behind(tmp_path: Path, kind: str) -> None:
    """From the element of a bus, and from what the signal is added to."""
    values = {"Constant": {"Value": "250", "OutDataTypeStr": "Inherit: Inherit via back propagation"}}
    source = [("Inport", "u", {"OutDataTypeStr": "double"})] * (kind == "DataTypeConversion")
    blocks = [
        *source,
        ("Inport", "n", {"Port": str(1 + len(source)), "OutDataTypeStr": "uint8"}),
        ("Inport", "rates", {"Port": str(2 + len(source)), "OutDataTypeStr": "Bus: Rates"}),
        (kind, "c", values.get(kind, {})),
        ("BusCreator", "make", {"OutDataTypeStr": "Bus: Sensors", "Ports": "[2, 1]"}),
        ("Outport", "bus", {}),
        (kind, "d", values.get(kind, {})),
        ("Sum", "sum", {"Ports": "[2, 1]", **WRAP}),
        ("Outport", "y", {"Port": "2"}),
    ]
    lines = [*[("u", "c"), ("u", "d")] * len(source), ("c", "make:1"), ("rates", "make:2"), ("make", "bus")]
    lines += [("n", "sum:1"), ("d", "sum:2"), ("sum", "y")]
    given = {"n": INT8 + 128, "rates.p": DRAWN[0], "rates.axes": DRAWN.T.copy(), "rates.on": DRAWN[2] > 0}
    given |= {"u": 300 + DRAWN[1]} if source else {}
    found = flown(imported(tmp_path, blocks, lines), given)
    value = {"Constant": 250, "Ground": 0, "DataTypeConversion": 255}[kind]
    assert set(found["bus.count"]) == {value}
    assert np.array_equal(found["y"], wrapped(INT8 + 128 + value, "uint8"))


# --- matrices

A, B = np.array([[0.3, -1.0, 2.0], [4.0, 0.1, -0.7]]), np.array([[1.5, 0.25], [-2.0, 3.0], [0.5, 1.0]])
NAMES = "A = [.3 -1 2; 4 .1 -.7]; B = [1.5 .25; -2 3; .5 1];"


@pytest.mark.parametrize(
    ("block", "wanted"),
    [
        (("Product", {"Multiplication": "Matrix(*)"}), lambda a, b, u: a @ b),
        (("Sum", {"Inputs": "-+"}), lambda a, b, u: b.T - a),
        (("Product", {"Inputs": "*/"}), lambda a, b, u: a / b.T),
        (("Concatenate", {"Mode": "Multidimensional array", "ConcatenateDimension": "2"}),
         lambda a, b, u: np.c_[a, b.T]),
        (("Concatenate", {"Mode": "Multidimensional array"}), lambda a, b, u: np.r_[a, b.T]),
        (("Gain", {"Gain": "A", "Multiplication": "Matrix(u*K)"}), lambda a, b, u: b @ A * u),
        (("Gain", {"Gain": "3"}), lambda a, b, u: 3 * a),
        (("Math", {"Operator": "transpose"}), lambda a, b, u: a.T),
        (("Reshape", {}), lambda a, b, u: a.flatten(order="F")),
        (("Reshape", {"OutputDimensionality": "Customize", "OutputDimensions": "[3 2]"}),
         lambda a, b, u: a.reshape(3, 2, order="F")),
        (("Selector", {"NumberOfDimensions": "2", "IndexOptions": "Select all,Index vector (dialog)",
                       "Indices": "[],[3 1]"}), lambda a, b, u: a[:, [2, 0]]),
        (("Selector", {"NumberOfDimensions": "2", "IndexMode": "Zero-based", "Indices": "1,2",
                       "IndexOptions": "Index vector (dialog),Index vector (dialog)"}), lambda a, b, u: a[1, 2]),
        (("UnitDelay", {"InitialCondition": "B'"}), None),
        (("Abs", {}), lambda a, b, u: np.abs(a)),
    ],
)  # fmt: skip
def test_matrices_are_computed_as_numpy_does(tmp_path: Path, block: tuple, wanted: object) -> None:
    """A times u, a signal, and the constant B or its transpose go into a block; y is looked at after each step."""
    kind, values = block
    two = kind in ("Product", "Sum", "Concatenate")
    second = "B" if values.get("Multiplication", "").startswith("Matrix") else "B'"
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double"}),
        ("Constant", "A", {"Value": "B" if kind == "Gain" and values["Gain"] == "A" else "A"}),
        ("Product", "scaled", {"Ports": "[2, 1]"}),
        ("Constant", "B", {"Value": second}),
        (kind, "b", {**values, "Ports": f"[{1 + two}, 1]"}),
        ("Outport", "y", {}),
    ]
    lines = [("A", "scaled:1"), ("u", "scaled:2"), ("scaled", "b:1"), *[("B", "b:2")] * two, ("b", "y")]
    if not two:
        blocks = [one for one in blocks if one[1] != "B"]
    y = flown(imported(tmp_path, blocks, lines, NAMES), {"u": DRAWN[0]})["y"]
    for k, u in enumerate(DRAWN[0]):
        if wanted is None:
            expected = B.T if k == 0 else A * DRAWN[0][k - 1]
        else:
            expected = wanted(A * u, B, u)  # type: ignore[operator]
        # numpy's product of matrices may add in another order: some units in the last place
        assert np.allclose(np.reshape(y[k], np.shape(expected)), expected, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("kind", ["Integrator", "DiscreteIntegrator"])
def test_an_integral_of_a_matrix_is_that_of_each_element(tmp_path: Path, kind: str) -> None:
    """X' = X A from a matrix that is not symmetric, in a loop: Runge-Kutta of fourth order, and Euler."""
    blocks = [
        (kind, "X", {"InitialCondition": "[1 2; 3 4; 5 6]", "IntegratorMethod": "Integration: Forward Euler"}),
        ("Constant", "A", {"Value": "[0 1; -4 .5]"}),
        ("Product", "XA", {"Multiplication": "Matrix(*)", "Ports": "[2, 1]"}),
        ("Outport", "y", {}),
    ]
    lines = [("X", "XA:1"), ("A", "XA:2"), ("XA", "X"), ("X", "y")]
    y = flown(imported(tmp_path, blocks, lines), {})["y"]
    step, now = DT * np.array([[0.0, 1.0], [-4.0, 0.5]]), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    order = 4 if kind == "Integrator" else 1
    factor = sum(np.linalg.matrix_power(step, k) / math.factorial(k) for k in range(order + 1))
    for k in range(len(y)):
        assert np.allclose(y[k], now, rtol=1e-12), k
        now = now @ factor


def test_elements_of_a_vector_are_assigned(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "uint8", "PortDimensions": "3"}),
        ("Inport", "v", {"Port": "2", "OutDataTypeStr": "uint8"}),
        ("Assignment", "put", {"Indices": "2", "IndexMode": "Zero-based", "Ports": "[2, 1]"}),
        ("Outport", "y", {}),
    ]
    u = np.random.default_rng(5).integers(0, 256, (200, 3))
    given = {"u": u, "v": INT8 + 128}
    y = flown(imported(tmp_path, blocks, [("u", "put:1"), ("v", "put:2"), ("put", "y")]), given)["y"]
    assert np.array_equal(y, np.c_[u[:, :2], INT8 + 128])


@pytest.mark.parametrize(
    ("block", "said"),
    [
        (("Math", {"Operator": "conj"}), "Operator = 'conj' is not translated"),
        (("Reshape", {"OutputDimensionality": "Derive from reference input port"}), "OutputDimensionality"),
        (("Assignment", {"Ports": "[2, 1]", "IndexOptions": "Index vector (port)"}), "IndexOptions"),
    ],
)
def test_what_is_no_matrix_operation_is_refused(tmp_path: Path, block: tuple, said: str) -> None:
    kind, values = block
    blocks = [("Inport", "u", {"OutDataTypeStr": "double", "PortDimensions": "3"}), (kind, "b", values)]
    found = imported(tmp_path, [*blocks, ("Outport", "y", {})], [("u", "b"), ("b", "y")])
    assert said in found.refused[0].why


# --- single among double


def test_numbers_of_single_and_double_are_each_rounded_as_their_type_says(tmp_path: Path) -> None:
    """Beside numpy's float32 and float64: each operation rounds once, and single meets double in double."""
    code = """e(1) = Simulink.BusElement; e(1).Name = 's'; e(1).DataType = 'single';
    e(2) = Simulink.BusElement; e(2).Name = 'd'; Both = Simulink.Bus; Both.Elements = e;"""
    blocks = [
        ("Inport", "a", {"OutDataTypeStr": "single"}),
        ("Inport", "b", {"OutDataTypeStr": "double", "Port": "2"}),
        ("Inport", "c", {"OutDataTypeStr": "single", "PortDimensions": "3", "Port": "3"}),
        ("Inport", "bus", {"OutDataTypeStr": "Bus: Both", "Port": "4"}),
        ("Gain", "tenth", {"Gain": ".1"}),
        ("Sum", "less", {"Inputs": "+-"}),
        ("Sum", "wide", {}),
        ("Product", "ratio", {"Inputs": "*/"}),
        ("DataTypeConversion", "narrow", {"OutDataTypeStr": "single"}),
        ("DiscreteIntegrator", "integral", {"gainval": ".7", "InitialCondition": ".3"}),
        ("Gain", "rows", {"Gain": "[.1 .2 .3; .4 .5 .6]", "Multiplication": "Matrix(K*u)"}),
        ("UnitDelay", "before", {"InitialCondition": ".1"}),
        ("Constant", "k", {"Value": "single(.7)"}),
        ("Switch", "chosen", {"Criteria": "u2 > Threshold", "Threshold": ".1"}),
        ("BusSelector", "fields", {"OutputSignals": "s,d"}),
        ("Product", "squared", {}),
        *((("Outport", f"y{k}", {"Port": str(k)})) for k in range(1, 9)),
    ]
    lines = [("a", "tenth"), ("tenth", "less:1"), ("a", "less:2"), ("less", "y1"), ("tenth", "wide:1"), ("b", "wide:2"),
             ("wide", "y2"), ("less", "integral"), ("integral", "y3"), ("b", "ratio:1"), ("wide", "ratio:2"),
             ("ratio", "narrow"), ("narrow", "before"), ("before", "y4"), ("c", "rows"), ("rows", "y5"),
             ("tenth", "chosen:1"), ("b", "chosen:2"), ("k", "chosen:3"), ("chosen", "y6"), ("bus", "fields"),
             ("fields:1", "squared:1"), ("fields:1", "squared:2"), ("squared", "y7"), ("fields:2", "y8")]  # fmt: skip
    f4, (a, b, s) = np.float32, DRAWN.copy()
    a, s, c = a.astype(f4), s.astype(f4), DRAWN.T.astype(f4)
    g = a * f4(0.1)
    less, narrow = g - a, (b / (g.astype(float) + b)).astype(f4)
    x, integral = f4(0.3), []
    for v in less:
        integral.append(x)
        x = f4(x + f4(0.7 * DT) * v)
    m = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], f4)
    rows = (m[:, 0] * c[:, :1] + m[:, 1] * c[:, 1:2]) + m[:, 2] * c[:, 2:]
    wanted = [less, g.astype(float) + b, np.array(integral), np.r_[f4(0.1), narrow[:-1]], rows,
              np.where(b > 0.1, g, f4(0.7)), s * s, b]  # fmt: skip
    found = flown(imported(tmp_path, blocks, lines, code), {"a": a, "b": b, "c": c, "bus.s": s, "bus.d": b})
    for k, one in enumerate(wanted, start=1):
        assert found[f"y{k}"].dtype == one.dtype
        assert np.array_equal(found[f"y{k}"], one), k


def test_a_selector_takes_places_from_its_input_or_from_a_start(tmp_path: Path) -> None:
    """Element u2 of a vector, counted from 0; two elements from its place on; and an assignment there."""
    place = {"IndexOptions": "Index vector (port)", "IndexMode": "Zero-based"}
    start = {"IndexOptions": "Starting index (port)", "IndexMode": "Zero-based", "OutputSizes": "2"}
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double", "PortDimensions": "4"}),
        ("Inport", "k", {"OutDataTypeStr": "uint8", "Port": "2"}),
        ("Selector", "one", {**place, "Ports": "[2, 1]"}),
        ("Selector", "two", {**start, "Ports": "[2, 1]"}),
        ("Assignment", "put", {**place, "Ports": "[3, 1]"}),
        ("Selector", "fixed", {"IndexOptions": "Starting index (dialog)", "Indices": "3", "OutputSizes": "2"}),
        *(("Outport", name, {"Port": str(n)}) for n, name in enumerate(("a", "b", "c", "d"), start=1)),
    ]
    lines = [("u", "one:1"), ("k", "one:2"), ("u", "two:1"), ("k", "two:2"), ("u", "put:1"), ("one", "put:2")]
    lines += [("k", "put:3"), ("u", "fixed"), ("one", "a"), ("two", "b"), ("put", "c"), ("fixed", "d")]
    found = imported(tmp_path, blocks, lines)
    assert found.diagram is not None, found.refused
    rng = np.random.default_rng(3)
    u, k = rng.normal(size=(200, 4)), rng.integers(0, 3, 200)
    y = flown(found, {"u": u, "k": k.astype(np.uint8)})
    rows = np.arange(200)
    assert np.array_equal(y["a"], u[rows, k])
    assert np.array_equal(y["b"], np.stack([u[rows, k], u[rows, k + 1]], 1))
    assert np.array_equal(y["c"], u)
    assert np.array_equal(y["d"], u[:, 2:])


def test_vectors_of_single_beside_double_stay_single(tmp_path: Path) -> None:
    """A Mux, a Demux, a Selector and a Gain of a vector round as float32 in a model that has doubles too."""
    blocks = [
        ("Inport", "c", {"OutDataTypeStr": "single", "PortDimensions": "3"}),
        ("Inport", "a", {"OutDataTypeStr": "single", "Port": "2"}),
        ("Inport", "b", {"OutDataTypeStr": "double", "Port": "3"}),
        ("Mux", "join", {"Inputs": "2", "Ports": "[2, 1]"}),
        ("Demux", "part", {"Outputs": "[2 2]", "Ports": "[1, 2]"}),
        ("Selector", "swap", {"Indices": "[2 1]"}),
        ("Gain", "gains", {"Gain": "[.1 .2]"}),
        *((("Outport", f"y{k}", {"Port": str(k)})) for k in range(1, 4)),
    ]
    lines = [("c", "join:1"), ("a", "join:2"), ("join", "part"), ("part:1", "swap"), ("part:2", "gains")]
    found = imported(tmp_path, blocks, [*lines, ("swap", "y1"), ("gains", "y2"), ("b", "y3")])
    c, a = DRAWN.T.astype(np.float32), DRAWN[0].astype(np.float32)
    y = flown(found, {"c": c, "a": a, "b": DRAWN[1]})
    assert np.array_equal(y["y1"], c[:, [1, 0]])
    assert np.array_equal(y["y2"], np.stack([c[:, 2], a], 1) * np.array([0.1, 0.2], np.float32))


def test_64_bit_numbers_are_doubles_and_say_so(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "t", {"OutDataTypeStr": "uint64"}),
        ("Constant", "first", {"Value": "5", "OutDataTypeStr": "uint64"}),
        ("Sum", "since", {"Inputs": "+-", "OutDataTypeStr": "uint64"}),
        ("Gain", "seconds", {"Gain": "1e-6", "OutDataTypeStr": "double", "ParamDataTypeStr": "double"}),
        ("Outport", "y", {}),
        ("Outport", "whole", {"Port": "2"}),
    ]
    lines = [("t", "since:1"), ("first", "since:2"), ("since", "seconds"), ("seconds", "y"), ("since", "whole")]
    found = imported(tmp_path, blocks, lines)
    assert any("exact up to 2^53" in note for note in found.notes)
    t = 2.0**52 + np.arange(200)
    y = flown(found, {"t": t})
    assert np.array_equal(y["whole"], t - 5.0)
    assert np.array_equal(y["y"], 1e-6 * (t - 5.0))


def test_a_bus_of_one_type_is_a_vector_where_a_block_takes_none(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "a", {"OutDataTypeStr": "double"}),
        ("Inport", "b", {"Port": "2", "OutDataTypeStr": "double", "PortDimensions": "2"}),
        ("BusCreator", "make", {"Inputs": "2", "Ports": "[2, 1]"}),
        ("Gain", "k", {"Gain": "[2 3 5]"}),
        ("Outport", "y", {}),
    ]
    found = imported(tmp_path, blocks, [("a", "make:1"), ("b", "make:2"), ("make", "k"), ("k", "y")])
    assert np.array_equal(flown(found, {"a": DRAWN[0], "b": DRAWN[1:].T.copy()})["y"], DRAWN.T * [2.0, 3.0, 5.0])


def test_an_s_function_without_code_is_missing(tmp_path: Path) -> None:
    block = ("S-Function", "solve", {"FunctionName": "solver", "Ports": "[1, 1]"})
    blocks, lines = [("Inport", "u", {}), block, ("Outport", "y", {})], [("u", "solve"), ("solve", "y")]
    assert "the code of the S-Function solver is not found" in imported(tmp_path, blocks, lines).refused[0].why
    (tmp_path / "solver.c").touch()
    assert "solver is code of its own" in imported(tmp_path, blocks, lines).refused[0].why


def test_elements_of_a_bus_without_a_type_are_inputs(tmp_path: Path) -> None:
    port = {"Port": "1", "InterfaceIsComposite": "1", "InterfacePortNumber": "1", "InterfacePortName": "Estimates"}
    blocks = [
        ("Inport", "first", {**port, "InterfaceElement": "velocity"}),
        ("Inport", "second", {**port, "InterfaceElement": "current"}),
        ("Sum", "both", {"Inputs": "+-"}),
        ("Outport", "y", {}),
    ]
    found = imported(tmp_path, blocks, [("first", "both:1"), ("second", "both:2"), ("both", "y")])
    y = flown(found, {"Estimates_velocity": DRAWN[0], "Estimates_current": DRAWN[1]})["y"]
    assert np.array_equal(y, DRAWN[0] - DRAWN[1])


def test_a_transposed_vector_is_a_row_to_products_and_a_vector_to_others(tmp_path: Path) -> None:
    """By numpy: u' u, u u' of which the first column is taken, and elements of 2 u' that a Demux parts."""
    matrix = {"Multiplication": "Matrix(*)", "Ports": "[2, 1]"}
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double", "PortDimensions": "3"}),
        ("Math", "row", {"Operator": "transpose"}),
        ("Product", "inner", matrix),
        ("Product", "outer", matrix),
        ("Constant", "first", {"Value": "[1; 0; 0]"}),
        ("Product", "column", matrix),
        ("Gain", "twice", {"Gain": "2"}),
        ("Math", "back", {"Operator": "transpose"}),
        ("Demux", "part", {"Outputs": "3"}),
        ("Terminator", "end", {}),
        *(("Outport", name, {"Port": str(k)}) for k, name in enumerate(("y", "z", "a", "b", "c"), start=1)),
    ]
    lines = [("u", "row"), ("row", "inner:1"), ("u", "inner:2"), ("inner", "y"), ("u", "outer:1"), ("row", "outer:2"),
             ("outer", "column:1"), ("first", "column:2"), ("column", "z"), ("row", "twice"), ("twice", "part"),
             ("part:1", "a"), ("part:3", "b"), ("part:2", "end"), ("twice", "back"), ("back", "c")]  # fmt: skip
    u = DRAWN[:3].T.copy()
    found = flown(imported(tmp_path, blocks, lines), {"u": u})
    assert np.allclose(found["y"], (u * u).sum(axis=1), rtol=1e-15)
    assert np.array_equal(found["z"], u * u[:, :1])
    assert np.array_equal(found["a"], 2 * u[:, 0])
    assert np.array_equal(found["b"], 2 * u[:, 2])
    assert np.array_equal(found["c"], 2 * u)


@pytest.mark.parametrize(("kind", "along"), [("Sum", "1"), ("Sum", "2"), ("Product", "1"), ("Product", "2")])
def test_the_elements_of_a_row_are_joined_along_the_row_alone(tmp_path: Path, kind: str, along: str) -> None:
    """Along the other dimension Simulink leaves the row as it is."""
    values = {"Inputs": "+" if kind == "Sum" else "*", "CollapseMode": "Specified dimension", "CollapseDim": along}
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double", "PortDimensions": "3"}),
        ("Math", "row", {"Operator": "transpose"}),
        (kind, "all", {**values, "Ports": "[1, 1]"}),
        ("Outport", "y", {}),
    ]
    found = imported(tmp_path, blocks, [("u", "row"), ("row", "all"), ("all", "y")])
    if along == "1":
        assert [(one.path, one.status) for one in found.report] == [("all", "refused")]
        return
    u = DRAWN[:3].T.copy()
    joined = u.sum(axis=1) if kind == "Sum" else u.prod(axis=1)
    assert np.allclose(flown(found, {"u": u})["y"], joined, rtol=1e-13)


def test_an_input_without_a_type_is_the_bus_that_is_selected_of_it(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "in", {}),
        ("BusSelector", "take", {"OutputSignals": "a.rates,a.on, b", "Ports": "[1, 3]"}),
        ("Gain", "product", {"Gain": "[1 2]", "Multiplication": "Matrix(K*u)"}),
        ("Sum", "sum", {"Inputs": "+-", "Ports": "[2, 1]"}),
        *(("Outport", name, {"Port": str(k)}) for k, name in enumerate(("y", "z"), start=1)),
    ]
    lines = [("in", "take"), ("take:1", "product"), ("take:2", "sum:1"), ("take:3", "sum:2")]
    found = imported(tmp_path, blocks, [*lines, ("product", "y"), ("sum", "z")])
    given = {"in.a.rates": DRAWN[:2].T.copy(), "in.a.on": DRAWN[1], "in.b": DRAWN[2]}
    out = flown(found, given)
    assert np.array_equal(out["y"], DRAWN[0] + 2.0 * DRAWN[1])
    assert np.array_equal(out["z"], DRAWN[1] - DRAWN[2])
    assert any("what is selected of it" in line.why for line in found.report)


def test_signals_of_one_name_are_numbered_in_a_bus(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double"}),
        ("Gain", "twice", {"Gain": "2"}),
        ("BusCreator", "make", {"Inputs": "2", "Ports": "[2, 1]"}),
        ("BusSelector", "take", {"OutputSignals": "v (signal 2)"}),
        ("Outport", "y", {}),
    ]
    files = model(blocks, [("u", "twice"), ("u", "make:1"), ("twice", "make:2"), ("make", "take"), ("take", "y")])
    named = {part: text.replace("<Line>", '<Line><P Name="Name">v</P>') for part, text in files.items()}
    found = flown(import_system(read_model(slx(named, tmp_path / "m.slx")), dt=DT), {"u": DRAWN[0]})
    assert np.array_equal(found["y"], 2 * DRAWN[0])
