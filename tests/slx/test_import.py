"""Simulink models as diagrams: beside MathWorks' own C where it is at hand, and beside arithmetic written by hand."""

import gzip
import json
import os
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import pytest
from scipy.io import savemat
from scipy.signal import lfilter
from typer.testing import CliRunner

from tests.slx.files import model, slx, written
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.cli.slx import slx as command
from twodof.compile import build
from twodof.errors import DiagramError
from twodof.slx.importer import Imported, import_system
from twodof.slx.inspection import inspect
from twodof.slx.matlab.script import read_workspace, run
from twodof.slx.model import read_model

pytestmark = pytest.mark.slow
DT = 0.01
STEPS = 200


def flown(found: Imported, inputs: dict[str, np.ndarray], steps: int = STEPS) -> dict[str, np.ndarray]:
    """What the imported diagram gives, after a round trip through JSON."""
    assert found.diagram is not None, [line for line in found.report if line.status == "refused"]
    return build(from_json(to_json(found.diagram)), dt=found.dt).machine().run(steps, inputs)


def one_block(tmp_path: Path, kind: str, values: dict[str, str], count: int = 1, width: int = 1) -> Imported:
    """Import a model of one block with inputs u1, u2, ... and the output y."""
    dimension = {} if width == 1 else {"PortDimensions": str(width)}
    ports = [
        ("Inport", f"u{k}", {"Port": str(k), "OutDataTypeStr": "double", **dimension}) for k in range(1, count + 1)
    ]
    blocks = [*ports, (kind, "block", values), ("Outport", "y", {})]
    lines = [*((f"u{k}", f"block:{k}") for k in range(1, count + 1)), ("block", "y")]
    return import_system(read_model(slx(model(blocks, lines), tmp_path / "m.slx")), dt=DT)


DRAWN = np.random.default_rng(1).normal(0.0, 2.0, (3, STEPS))


def by_hand_integral(u: np.ndarray, low: float, high: float) -> np.ndarray:
    y, state = [], 0.0
    for v in u:
        y.append(state)
        state = min(max(state + 2.0 * DT * v, low), high)
    return np.array(y)


@pytest.mark.parametrize(
    ("kind", "values", "count", "wanted"),
    [
        ("Sum", {"Inputs": "|-+-"}, 3, lambda a, b, c: -a + b - c),
        ("Sum", {"Inputs": "3"}, 3, lambda a, b, c: a + b + c),
        ("Product", {"Inputs": "*/*"}, 3, lambda a, b, c: a / b * c),
        ("Gain", {"Gain": "2/3"}, 1, lambda a: (2 / 3) * a),
        ("Saturate", {"UpperLimit": "1", "LowerLimit": "-.25"}, 1, lambda a: np.clip(a, -0.25, 1.0)),
        ("UnitDelay", {"InitialCondition": "3"}, 1, lambda a: np.r_[3.0, a[:-1]]),
        ("Delay", {"DelayLength": "4", "InitialCondition": "-1"}, 1, lambda a: np.r_[[-1.0] * 4, a[:-4]]),
        ("Memory", {"X0": ".5"}, 1, lambda a: np.r_[0.5, a[:-1]]),
        (
            "DiscreteIntegrator",
            {"gainval": "2", "LimitOutput": "on", "UpperSaturationLimit": ".1", "LowerSaturationLimit": "-.1"},
            1,
            lambda a: by_hand_integral(a, -0.1, 0.1),
        ),
        ("Abs", {}, 1, np.abs),
        ("Bias", {"Bias": "-2.5"}, 1, lambda a: a - 2.5),
        ("UnaryMinus", {}, 1, lambda a: -a),
        ("Signum", {}, 1, np.sign),
        ("Sqrt", {}, 1, lambda a: np.sqrt(np.where(a < 0, np.nan, a))),
        ("Math", {"Operator": "square"}, 1, lambda a: a * a),
        ("MinMax", {"Function": "max", "Inputs": "2"}, 2, np.maximum),
        ("Switch", {"Threshold": "0.5"}, 3, lambda a, b, c: np.where(b >= 0.5, a, c)),
        ("Switch", {"Criteria": "u2 ~= 0"}, 3, lambda a, b, c: np.where(b != 0, a, c)),
        ("RelationalOperator", {"Operator": "~="}, 2, lambda a, b: a != b),
        ("DeadZone", {}, 1, lambda a: np.where(a > 0.5, a - 0.5, np.where(a < -0.5, a + 0.5, 0.0))),
    ],
)
def test_a_block_computes_what_its_definition_says(
    tmp_path: Path, kind: str, values: dict[str, str], count: int, wanted: Callable[..., np.ndarray]
) -> None:
    found = flown(one_block(tmp_path, kind, values, count), {f"u{k + 1}": DRAWN[k] for k in range(count)})
    assert np.array_equal(found["y"], wanted(*DRAWN[:count]), equal_nan=True)


@pytest.mark.parametrize("kind", ["DiscreteTransferFcn", "DiscreteFilter"])
def test_a_filter_is_that_of_scipy(tmp_path: Path, kind: str) -> None:
    values = {"Numerator": "[1 .5]", "Denominator": "[2 -1 .3]"}
    found = flown(one_block(tmp_path, kind, values), {"u1": DRAWN[0]})
    top = [0.0, 1.0, 0.5] if kind == "DiscreteTransferFcn" else [1.0, 0.5]
    # Another order of the operations: some units in the last place.
    assert np.allclose(found["y"], lfilter(top, [2.0, -1.0, 0.3], DRAWN[0]), rtol=1e-12, atol=1e-14)


def test_a_discrete_pid_follows_mathworks_order_of_operations(tmp_path: Path) -> None:
    values = {"SourceBlock": "slpidlib/PID Controller", "TimeDomain": "Discrete-time", "P": "2", "I": ".7", "D": ".05",
              "N": "40", "LimitOutput": "on", "UpperSaturationLimit": "1.5", "LowerSaturationLimit": "-1",
              "AntiWindupMode": "back-calculation", "Kb": "3"}  # fmt: skip
    found = flown(one_block(tmp_path, "Reference", values), {"u1": DRAWN[0]})
    integral = filtered = 0.0
    wanted = []
    for u in DRAWN[0]:
        slope = (0.05 * u - filtered) * 40.0
        y = (2.0 * u + integral) + slope
        limited = min(max(y, -1.0), 1.5)
        wanted.append(limited)
        integral += DT * ((limited - y) * 3.0 + 0.7 * u)
        filtered += DT * slope
    assert np.array_equal(found["y"], wanted)


def test_a_variant_is_its_active_choice(tmp_path: Path) -> None:
    """Choices: a gain, a MATLAB Function, whose code the file has under the choice's path, and a referenced model."""
    function = ("SubSystem", "k", {"SFBlockType": "MATLAB Function", "Ports": "[1, 1]"})
    choices = ""
    for number, block in ((1, ("Gain", "k", {"Gain": "3"})), (2, function)):
        sheet = model([("Inport", "in", {}), block, ("Outport", "out", {})], [("in", "k"), ("k", "out")])
        system = sheet["simulink/blockdiagram.xml"].partition("<Model>")[2].partition("</Model>")[0]
        control = f'<P Name="VariantControl">MODE == {number}</P>'
        choices += f'<Block BlockType="SubSystem" Name="choice {number}" SID="1{number}">{control}{system}</Block>'
    inner = [("Inport", "in", {}), ("Gain", "k", {"Gain": "7"}), ("Outport", "out", {})]
    slx(model(inner, [("in", "k"), ("k", "out")]), tmp_path / "inner.slx")
    control = '<P Name="VariantControl">MODE == 3</P><P Name="ModelNameDialog">inner</P>'
    choices += f'<Block BlockType="ModelReference" Name="choice 3" SID="13">{control}</Block>'
    ports = '<Block BlockType="Inport" Name="in" SID="21"/><Block BlockType="Outport" Name="out" SID="22"/>'
    variant = f'<P Name="Variant">on</P><P Name="Ports">[1, 1]</P><System>{ports}{choices}</System>'
    files = model(
        [("Inport", "u", {}), ("SubSystem", "gain", {}), ("Outport", "y", {})], [("u", "gain"), ("gain", "y")]
    )
    name = "simulink/blockdiagram.xml"
    files[name] = files[name].replace('Name="gain" SID="2">', f'Name="gain" SID="2">{variant}')
    code = '<P Name="labelString">f</P><eml><P Name="script">function y = f(u)\ny = 5 * u;</P></eml>'
    chart = '<chart id="9"><P Name="name">gain/choice 2/k</P><Children><state SSID="1">{}</state></Children></chart>'
    files["simulink/stateflow/chart_9.xml"] = chart.format(code)
    read = read_model(slx(files, tmp_path / "m.slx"))
    for mode, factor in ((1, 3.0), (2, 5.0), (3, 7.0)):
        found = import_system(read, "", {"MODE": np.array([[float(mode)]])}, [tmp_path], DT)
        assert np.array_equal(flown(found, {"u": DRAWN[0]})["y"], factor * DRAWN[0])
    (refused,) = [line for line in import_system(read, dt=DT).refused if line.path == "gain"]
    assert "MODE has no value" in refused.why


def test_vectors_are_joined_split_and_expanded(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double", "PortDimensions": "3"}),
        ("Inport", "k", {"Port": "2", "OutDataTypeStr": "double"}),
        ("Product", "scaled", {"Ports": "[2, 1]"}),
        ("Demux", "parts", {"Outputs": "[1 2]", "Ports": "[1, 2]"}),
        ("Mux", "again", {"Ports": "[2, 1]"}),
        ("Gain", "matrix", {"Gain": "[0 1 0; 2 0 0]", "Multiplication": "Matrix(K*u)"}),
        ("Selector", "second", {"Indices": "[2 1]", "InputPortWidth": "2"}),
        ("Outport", "y", {}),
    ]
    lines = [("u", "scaled:1"), ("k", "scaled:2"), ("scaled", "parts"), ("parts:1", "again:1"), ("parts:2", "again:2")]
    lines += [("again", "matrix"), ("matrix", "second"), ("second", "y")]
    found = import_system(read_model(slx(model(blocks, lines), tmp_path / "m.slx")), dt=DT)
    u = DRAWN.T.copy()
    scaled = u * DRAWN[0][:, None]
    assert np.array_equal(flown(found, {"u": u, "k": DRAWN[0]})["y"], np.c_[2 * scaled[:, 0], scaled[:, 1]])


def test_elements_of_vectors_are_chosen_and_joined_one_by_one(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double", "PortDimensions": "3"}),
        ("Gain", "twice", {"Gain": "2", "Multiplication": "Matrix(K*u)"}),
        ("Constant", "none", {"Value": "[7 8 9]"}),
        ("Switch", "chosen", {"Criteria": "u2 > Threshold", "Threshold": ".5"}),
        ("CompareToConstant", "large", {"relop": ">", "const": "[1 2 3]"}),
        ("Logic", "any", {"Operator": "OR", "Inputs": "1"}),
        ("MinMax", "most", {"Function": "max", "Inputs": "1"}),
        ("Product", "scaled", {"Multiplication": "Matrix(*)"}),
        ("Saturate", "held", {"LowerLimit": "[-1 -2 -inf]", "UpperLimit": "2"}),
        ("Outport", "y", {}),
        ("Outport", "some", {"Port": "2"}),
        ("Outport", "all", {"Port": "3"}),
        ("Outport", "within", {"Port": "4"}),
    ]
    lines = [("u", "twice"), ("twice", "chosen:1"), ("u", "chosen:2"), ("none", "chosen:3"), ("chosen", "y"),
             ("u", "large"), ("large", "any"), ("any", "some"), ("u", "most"),
             ("u", "scaled:1"), ("most", "scaled:2"), ("scaled", "all"),
             ("u", "held"), ("held", "within")]  # fmt: skip
    found = flown(import_system(read_model(slx(model(blocks, lines), tmp_path / "m.slx")), dt=DT), {"u": DRAWN.T})
    assert np.array_equal(found["y"], np.where(DRAWN.T > 0.5, 2.0 * DRAWN.T, [7.0, 8.0, 9.0]))
    assert np.array_equal(found["some"], (DRAWN.T > [1.0, 2.0, 3.0]).any(axis=1))
    assert np.array_equal(found["within"], np.clip(DRAWN.T, [-1.0, -2.0, -np.inf], 2.0))
    assert np.array_equal(found["all"], DRAWN.T * DRAWN.T.max(axis=1, keepdims=True))


def test_a_loop_is_broken_at_its_delay_and_goto_leads_to_from(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double"}),
        ("Sum", "sum", {"Ports": "[2, 1]"}),
        ("Goto", "to", {"GotoTag": "y"}),
        ("From", "from", {"GotoTag": "y"}),
        ("UnitDelay", "z", {}),
        ("Terminator", "end", {}),
        ("Outport", "y", {}),
    ]
    lines = [("u", "sum:1"), ("z", "sum:2"), ("sum", "to"), ("from", "z"), ("sum", "y"), ("sum", "end")]
    found = import_system(read_model(slx(model(blocks, lines), tmp_path / "m.slx")), dt=DT)
    assert np.array_equal(flown(found, {"u": DRAWN[0]})["y"], np.cumsum(DRAWN[0]))
    assert [line.path for line in found.report if line.status == "dropped"] == ["end"]


def test_what_is_commented_is_cut_or_passed_and_what_hangs_in_the_air_is_said(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double"}),
        ("Gain", "past", {"Gain": "9", "Commented": "through"}),
        ("Gain", "cut", {"Gain": "9", "Commented": "on"}),
        ("Sum", "sum", {"Inputs": "+++", "Ports": "[3, 1]"}),
        ("Outport", "y", {}),
    ]
    lines = [("u", "past"), ("u", "cut"), ("past", "sum:1"), ("cut", "sum:2"), ("sum", "y")]
    found = import_system(read_model(slx(model(blocks, lines), tmp_path / "m.slx")), dt=DT)
    assert np.array_equal(flown(found, {"u": DRAWN[0]})["y"], DRAWN[0])
    assert "nothing drives input 2, 3: it is 0" in [line.why for line in found.report]


def test_another_period_than_the_blocks_have_is_refused(tmp_path: Path) -> None:
    found = one_block(tmp_path, "ZeroOrderHold", {"SampleTime": "0.004"})
    assert [line.why for line in found.refused] == ["0.004 s (block) is no multiple of 0.01 s (--dt)"]


def test_the_time_of_an_import_grows_with_the_blocks(tmp_path: Path) -> None:
    """900 blocks, the last one first in the file, take at most six times as long as 300: linear is three."""

    def seconds(count: int) -> float:
        chain = [("Gain" if k % 3 else "UnitDelay", f"g{k}", {"Gain": "1.01"}) for k in range(count)]
        blocks = [("Inport", "u", {"OutDataTypeStr": "double"}), *reversed(chain), ("Outport", "y", {})]
        names = ["u", *(name for _, name, _ in chain), "y"]
        read = read_model(slx(model(blocks, list(pairwise(names))), tmp_path / "m.slx"))
        times = []
        for _ in range(3):
            begin = time.process_time()
            assert import_system(read, dt=DT).diagram is not None
            times.append(time.process_time() - begin)
        return min(times)

    assert seconds(900) < 6.0 * seconds(300)


def test_what_is_not_translated_is_refused_by_path_and_parameter_all_at_once(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "u", {}),
        ("DiscreteIntegrator", "sum of q", {"ShowStatePort": "on"}),
        ("Gain", "k", {"Gain": "1/m"}),
        ("IGRF", "field", {}),
        ("Outport", "y", {}),
    ]
    lines = [("u", "sum of q"), ("sum of q", "y"), ("u", "k")]
    found = import_system(read_model(slx(model(blocks, lines), tmp_path / "m.slx")), dt=DT)
    assert found.diagram is None
    assert [(line.path, line.status) for line in found.report if line.status == "not reached"] == []
    assert {(line.path, line.why) for line in found.refused} == {
        ("sum of q", "ShowStatePort = 'on' is not translated"),
        ("k", "parameter Gain: 1/m: m has no value"),
        ("field", "the block type IGRF is not translated"),
    }


def test_a_port_is_as_wide_as_what_splits_it(tmp_path: Path) -> None:
    blocks = [("Inport", "rates", {}), ("Demux", "split", {"Outputs": "3", "Ports": "[1, 3]"}), ("Outport", "q", {})]
    found = import_system(
        read_model(slx(model(blocks, [("rates", "split"), ("split:2", "q")]), tmp_path / "m.slx")), dt=DT
    )
    assert np.array_equal(flown(found, {"rates": DRAWN.T.copy()})["q"], DRAWN[1])
    assert "taken for a vector of 3 doubles" in next(line.why for line in found.report if line.path == "rates")


def test_names_come_from_scripts_and_mat_files_and_masks_shadow_them(tmp_path: Path) -> None:
    (tmp_path / "gains.m").write_text("kp = 4; integral\nM_MAX = load('x');\n", encoding="utf-8")
    (tmp_path / "integral.m").write_text("g.ki = .5;\n", encoding="utf-8")  # found beside the script that calls it
    savemat(tmp_path / "more.mat", {"M_MAX": 1.5, "cells": np.array([1, 1j], dtype=object)})
    names: dict[str, object] = {}
    assert [one.line for one in read_workspace(tmp_path / "gains.m", names)] == [2]
    assert [one.why for one in read_workspace(tmp_path / "more.mat", names)] == [
        "cells: is not a number, a text or a structure"
    ]
    found = import_system(read_model(written("split", tmp_path)), "", names)
    assert found.dt == 0.004  # the fixed step Ts, which the model's InitFcn says
    # The model's own InitFcn says kp = 2, a --workspace file 4.
    assert np.array_equal(flown(found, {"error": DRAWN[0]})["M"], np.clip(2.5 * DRAWN[0], -1.5, 1.5))


def test_the_command_writes_the_diagram_or_says_why_not(tmp_path: Path) -> None:
    path, out = written("split", tmp_path), tmp_path / "limits.json"
    (tmp_path / "w.m").write_text("M_MAX = 1; g.ki = 0;", encoding="utf-8")
    invoke = CliRunner().invoke
    refused = invoke(command, ["import", str(path), "--out", str(out)])
    assert refused.exit_code == 1
    assert "g.ki has no value" in refused.output
    assert not out.exists()
    done = invoke(command, ["import", str(path), "--out", str(out), "--workspace", str(tmp_path / "w.m"), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.output)["fine"] is True
    assert list(from_json(out.read_text(encoding="utf-8")).outputs) == ["M"]


ROTATION = """function [body, speed] = ned2body(ned, attitude)
% from the earth to the body
theta = attitude(2); psi = attitude(3);
C = [cos(theta)*cos(psi) cos(theta)*sin(psi) -sin(theta)
     -sin(psi)           cos(psi)            0
     sin(theta)*cos(psi) sin(theta)*sin(psi) cos(theta)];
body = C * ned;
speed = sqrt(ned' * ned) + max(ned(1), 0) ^ 2;
"""


def matlab_function(tmp_path: Path, code: str) -> Imported:
    """Import a model with a MATLAB Function of two vectors."""
    port = {"OutDataTypeStr": "double", "PortDimensions": "3"}
    blocks = [
        ("Inport", "ned", port),
        ("Inport", "attitude", {"Port": "2", **port}),
        ("SubSystem", "to body", {"SFBlockType": "MATLAB Function", "Ports": "[2, 2]"}),
        ("Outport", "body", {}),
        ("Outport", "speed", {"Port": "2"}),
    ]
    lines = [("ned", "to body:1"), ("attitude", "to body:2"), ("to body:1", "body"), ("to body:2", "speed")]
    files = model(blocks, lines)
    state = f'<state SSID="1"><P Name="labelString">f</P><eml><P Name="script">{escape(code)}</P></eml></state>'
    chart = f'<chart id="9"><P Name="name">to body</P><Children>{state}</Children></chart>'
    files["simulink/stateflow/chart_9.xml"] = chart
    return import_system(read_model(slx(files, tmp_path / "m.slx")), dt=DT)


def test_a_name_with_space_around_it_has_its_code(tmp_path: Path) -> None:
    code = "function y = f(u)\ny = 5 * u;"
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double"}),
        ("SubSystem", "plant ", {}, ([
            ("Inport", "u", {}),
            ("SubSystem", "  rises ", {"SFBlockType": "MATLAB Function", "Ports": "[1, 1]"}),
            ("Outport", "y", {}),
        ], [("u", "  rises "), ("  rises ", "y")])),
        ("Outport", "y", {}),
    ]  # fmt: skip
    files = model(blocks, [("u", "plant "), ("plant ", "y")])
    state = f'<state SSID="1"><P Name="labelString">f</P><eml><P Name="script">{code}</P></eml></state>'
    chart = f'<chart id="9"><P Name="name">plant /  rises </P><Children>{state}</Children></chart>'
    files["simulink/stateflow/chart_9.xml"] = chart
    read = read_model(slx(files, tmp_path / "m.slx"))
    for asked in ("", "plant", "plant "):  # a space at the end may be left out
        assert np.array_equal(flown(import_system(read, asked, dt=DT), {"u": DRAWN[0]})["y"], 5 * DRAWN[0])


def test_a_block_with_the_asked_name_comes_before_one_with_a_space(tmp_path: Path) -> None:
    blocks = [("SubSystem", name, {}, ([("Gain", gain, {})], [])) for name, gain in (("a", "k"), ("a ", "l"))]
    read = read_model(slx(model(blocks, []), tmp_path / "m.slx"))
    assert [one.name for name in ("a", "a ") for one in read.system(name).blocks.values()] == ["k", "l"]
    with pytest.raises(DiagramError, match="its first ones are: 'a', 'a '"):
        read.system(" a")


def test_the_report_tells_the_values_of_a_librarys_mask(tmp_path: Path) -> None:
    inside = ([("Inport", "u", {}), ("Gain", "P", {"Gain": "Kp"}), ("Outport", "y", {})], [("u", "P"), ("P", "y")])
    text = model([("SubSystem", "PID", {}, inside)], [])["simulink/blockdiagram.xml"]
    mask = '<Mask><MaskParameter Name="Kp" Type="edit"><Value>0</Value></MaskParameter></Mask>'
    text = text.replace('Name="PID" SID="1">', f'Name="PID" SID="1">{mask}')
    files = {"simulink/blockdiagram.xml": text.replace("<Model>", "<Library>").replace("</Model>", "</Library>")}
    found = import_system(read_model(slx(files, tmp_path / "l.slx")), "PID", dt=DT)
    assert found.notes == ["PID: has the values of its mask in the library: Kp = 0"]


def test_a_matlab_function_of_assignments_is_translated(tmp_path: Path) -> None:
    ned, attitude = np.random.default_rng(3).normal(size=(2, STEPS, 3))
    found = flown(matlab_function(tmp_path, ROTATION), {"ned": ned, "attitude": attitude})
    (_, ct, cp), (_, st, sp) = np.cos(attitude).T, np.sin(attitude).T
    zero = np.zeros(STEPS)
    rotation = np.array([[ct * cp, ct * sp, -st], [-sp, cp, zero], [st * cp, st * sp, ct]])
    # The language's own sine and cosine, within 2.5 units in the last place of numpy's.
    assert np.allclose(found["body"], np.einsum("ijk,kj->ki", rotation, ned), rtol=1e-13, atol=1e-15)
    wanted = np.sqrt((ned**2).sum(axis=1)) + np.maximum(ned[:, 0], 0.0) ** 2
    assert np.allclose(found["speed"], wanted, rtol=1e-14)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ("body = C * ned;\nif speed0 > 1\n body = ned;\nend", "line 8: speed0 has no value"),
        ("body = svd(C) * ned;", "line 7: svd is not computed"),
        ("for k = 1:ned(1), body = k * ned; end", "line 7: a range whose bounds are signals has no fixed size"),
        ("body = attitude(4);", "line 7: an index is beyond an array of 3 by 1"),
        ("persistent k; body = k*ned;", "line 7"),
    ],
)
def test_a_matlab_function_beyond_that_is_refused_by_its_line(tmp_path: Path, changed: str, said: str) -> None:
    (refused,) = matlab_function(tmp_path, ROTATION.replace("body = C * ned;", changed)).refused
    assert refused.path == "to body"
    assert said in refused.why


SAMPLES = os.environ.get("TWODOF_SLX_SAMPLES", "")


@pytest.mark.skipif(not SAMPLES, reason="let TWODOF_SLX_SAMPLES name the folder of the public sample models")
def test_three_pid_controllers_have_the_bits_of_mathworks_c() -> None:
    """2,000 steps: outputs, and the states of three integrators and three derivatives."""
    found = import_system(read_model(Path(SAMPLES) / "complementary_controller.slx"), "PID_Controller")
    assert found.diagram is not None

    def table(which: str) -> tuple[list[str], np.ndarray]:
        with gzip.open(Path(SAMPLES) / f"complementary_controller.PID_Controller.{which}.csv.gz", "rt") as file:
            names = file.readline().strip().split(",")[1:]
            return names, np.loadtxt(file, delimiter=",")[:, 1:]

    (_, given), (names, wanted) = table("in"), table("out")
    loops = ("PID_Pitch", "PID_Roll", "PID_Azimuth")
    states = [
        path for loop in loops for path in (f"{loop}.Discrete_Time_Integrator.x", f"{loop}.Discrete_Derivative.x")
    ]
    machine = build(found.diagram, dt=found.dt).machine()
    outputs, kept = [], []
    for row in given:
        got = machine.step(dict(zip(found.diagram.inputs, row.tolist(), strict=True)))
        outputs.append([got[name] for name in found.diagram.outputs])
        kept.append([machine.state(path) for path in states])
    assert len(wanted) == 2000
    assert np.array_equal(np.array(outputs), wanted[:, :3])
    assert np.array_equal(np.array(kept), wanted[:, 3:]), names


COURSE = """Xu=-.1068; Xq=.1192; Mu=-5.9755; Mq=-2.6478; Xd=-10.1647; Md=450.71; g=9.81; sample_time=1/250;
A = [Xu Xq -g; Mu Mq 0; 0 1 0]; B = [Xd; Md; 0]; C = [1 0 0; 0 1 0; 0 0 1; Xu Xq 0]; D = [0; 0; 0; Xd];
KP_Q=.09; KI_Q=.21; KD_Q=.0016; KF_Q=0; N_filter_rate=100; M_MAX=1; M_MIN=-1; KP_PITCH=12; Q_MAX=10; Q_MIN=-10;
KP_X_DOT=.5; KI_X_DOT=.04; KD_X_DOT=0; KF_X_DOT=0; F_X_MAX=1; F_X_MIN=-1; N_filter_vel=10; N_filter_x=10; KP_X=2;
VEL_MAX=10; VEL_MIN=-10; BASELINE_T=.4; Kt=.25; Kq=.25; b=2; delay.attitude_filter=1; delay.position_filter=1;
noise.pos_stand_dev=.0011; noise.vel_stand_dev=.01; noise.attitude_stand_dev=.33*pi/180;
noise.ang_rate_stand_dev=pi/180; noise.acc_stand_dev=.5; seed.x=1; seed.vx=2; seed.theta=3; seed.q=4; seed.ax=5;
"""


@pytest.mark.skipif(not SAMPLES, reason="let TWODOF_SLX_SAMPLES name the folder of the public sample models")
def test_the_single_axis_simulator_of_a_course_imports_whole_and_flies() -> None:
    names: dict[str, object] = {}
    assert run(COURSE, names) == []
    found = import_system(read_model(Path(SAMPLES) / "Simulator_Single_Axis.slx"), "", names, [Path(SAMPLES)])
    assert found.diagram is not None, found.refused
    assert found.dt == 0.004
    clock = DT * 0.4 * np.arange(15_000)  # 60 s at 250 Hz
    flight = (
        build(found.diagram, dt=found.dt, log=["Integrator2.y"])
        .machine()
        .run(len(clock), {"SetPoint": np.where(clock > 5.0, 1.0, 0.0), "ExcitationM": np.zeros(len(clock))})
    )
    x = flight["Integrator2.y"]
    assert np.abs(x[clock < 5.0]).max() < 0.02  # it holds its place within its noise
    assert np.abs(x[clock > 15.0] - 1.0).max() < 0.02  # and goes to the set-point
    assert x.max() < 1.2


@pytest.mark.skipif(not SAMPLES, reason="let TWODOF_SLX_SAMPLES name the folder of the public sample models")
@pytest.mark.parametrize("name", ["Attitude", "Position", "speed_control"])
def test_the_sample_controllers_import_and_give_one_answer_on_all_machines(name: str) -> None:
    model = read_model(Path(SAMPLES) / f"{name}.slx")
    names: dict[str, object] = {one: np.array([[1.0 + 0.1 * k]]) for k, one in enumerate(inspect(model).names)}
    names |= {"ctrl_type": np.array([[4.0]]), "T": np.array([[0.01]])} if name == "speed_control" else {}
    path = "Controller" if name == "speed_control" else ""
    found = import_system(model, path, names, [Path(SAMPLES)], dt=0.01)
    assert found.diagram is not None, found.refused
    draw = np.random.default_rng(1)
    given = {p.name: draw.normal(size=(STEPS, p.width) if p.width else STEPS) for p in found.diagram.inputs.values()}
    compiled = build(found.diagram, dt=0.01).machine().run(STEPS, given)
    interpreted = Reference(found.diagram, 0.01).machine().run(STEPS, given)
    assert all(np.array_equal(compiled[output], interpreted[output]) for output in found.diagram.outputs)
    assert all(np.isfinite(compiled[output]).all() for output in found.diagram.outputs)


def test_links_stand_for_blocks_of_libraries_that_link_on_and_for_subsystems_of_their_own_files(tmp_path: Path) -> None:
    inside = model([("Inport", "u", {}), ("Gain", "", {"Gain": "k_1"}), ("Outport", "y", {})], [("u", ""), ("", "y")])
    files = {
        "threefold": ("Subsystem", inside),
        "halves": ("Library", model([("Gain", "half", {"Gain": ".5"})], [])),
        "linking": (
            "Library",
            model(
                [
                    ("Reference", "mine", {"SourceBlock": "halves/half"}),
                    ("Reference", "again", {"SourceBlock": "$bdroot/mine"}),
                ],
                [],
            ),
        ),
    }
    for name, (kind, parts) in files.items():
        text = parts["simulink/blockdiagram.xml"].replace("<Model>", f"<{kind}>").replace("</Model>", f"</{kind}>")
        slx({"simulink/blockdiagram.xml": text}, tmp_path / f"{name}.slx")
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double"}),
        ("Reference", "linked", {"SourceBlock": "linking/again"}),
        ("SubSystem", "three", {"ReferencedSubsystem": "threefold"}),
        ("Outport", "y", {}),
    ]
    whole = read_model(slx(model(blocks, [("u", "linked"), ("linked", "three"), ("three", "y")]), tmp_path / "m.slx"))
    assert inspect(whole, [tmp_path]).names == {"k_1": ("three/Gain 2",)}
    given = {"k_1": np.array([[3.0]])}
    found = flown(import_system(whole, workspace=given, folders=[tmp_path], dt=DT), {"u": DRAWN[0]})
    assert np.array_equal(found["y"], 3.0 * (0.5 * DRAWN[0]))
    for path, file in (("three/part", "threefold"), ("linked", "linking/again")):
        with pytest.raises(DiagramError, match=f"{path.split('/')[0]} is a link to {file}"):
            whole.system(path)
    missing = import_system(whole, workspace=given, dt=DT).refused
    assert {line.path: line.why for line in missing} == {
        name: f"the library {file} is not found: name its folder with --path"
        for name, file in (("linked", "linking"), ("three", "threefold"))
    }


@pytest.mark.parametrize("width", [3, 7])
def test_an_algebraic_loop_of_a_vector_is_solved(tmp_path: Path, width: int) -> None:
    """y = u - A y for a full matrix A, each step; one that is longer than six elements is named."""
    matrix = np.random.default_rng(1).normal(0.0, 0.4, (width, width))
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double", "PortDimensions": str(width)}),
        ("Sum", "a", {"Ports": "[2, 1]", "Inputs": "+-"}),
        ("Bias", "more", {"Bias": "0"}),
        ("Gain", "b", {"Gain": str(matrix.tolist()).replace("], [", "; "), "Multiplication": "Matrix(K*u)"}),
        ("Outport", "y", {}),
    ]
    lines = [("u", "a:1"), ("a", "more"), ("more", "b"), ("b", "a:2"), ("a", "y")]
    found = import_system(read_model(slx(model(blocks, lines), tmp_path / "m.slx")), dt=DT)
    assert found.diagram is not None
    if width == 7:
        assert found.notes == ["an algebraic loop over a is not solved: no output of at most 6 real numbers cuts it"]
        with pytest.raises(DiagramError, match=r"algebraic loop a.y <- b.y <- more.y <- a.y"):
            build(found.diagram, dt=found.dt)
        return
    u = np.random.default_rng(2).normal(0.0, 1.0, (200, width))
    wanted = np.linalg.solve(np.eye(width) + matrix, u.T).T
    assert np.allclose(flown(found, {"u": u})["y"], wanted, rtol=0.0, atol=1e-9)


def test_what_hangs_on_a_refused_block_is_not_reached(tmp_path: Path) -> None:
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double"}),
        ("S-Function", "own", {}),
        ("Demux", "parts", {"Outputs": "2"}),
        ("Gain", "second", {"Gain": "2"}),
        ("Outport", "y", {}),
        ("Gain", "beside", {"Gain": "2"}),
        ("Outport", "z", {"Port": "2"}),
    ]
    lines = [("u", "own"), ("own", "parts"), ("parts:2", "second"), ("second", "y"), ("u", "beside"), ("beside", "z")]
    found = import_system(read_model(slx(model(blocks, lines), tmp_path / "m.slx")), dt=DT)
    assert found.diagram is None
    stood = {line.path: line.status for line in found.report}
    assert stood == {"own": "refused", "parts": "not reached", "second": "not reached"}


def test_vectors_of_parameters_go_element_by_element(tmp_path: Path) -> None:
    blocks = [
        ("Step", "step", {"Time": "[.02 .05 0]", "After": "[1; 2; 3]"}),
        ("RateLimiter", "slow", {"RisingSlewLimit": "[10 20 1e9]", "SampleTimeMode": "inherited"}),
        ("Outport", "y", {}),
    ]
    found = import_system(read_model(slx(model(blocks, [("step", "slow"), ("slow", "y")]), tmp_path / "m.slx")), dt=DT)
    y = flown(found, {}, 30)["y"]
    steps = np.arange(30)[:, None]
    ramps = (steps - [1, 4, -np.inf]) * [0.1, 0.2, 1.0]  # a slew limit of 10 is .1 a step; the first step is at tick 2
    assert np.allclose(y, np.clip(ramps, 0.0, [1.0, 2.0, 3.0]), rtol=0.0, atol=1e-14)
    (refused,) = one_block(tmp_path, "RateLimiter", {"RisingSlewLimit": "[1 2 3]"}, width=2).refused
    assert refused.why == "its vectors have 2 and 3 elements"


def test_functions_of_files_beside_the_model_are_called(tmp_path: Path) -> None:
    (tmp_path / "twice.m").write_text("% doubles\nfunction y = twice(u)\ny = helped(u) + offset_of(1);\n"
                                      "function y = helped(u)\ny = 2 * u;\n")  # fmt: skip
    (tmp_path / "offset_of.m").write_text("function k = offset_of(n)\n  if n == 1\n    k = .5;\n  end\nend\n")
    (tmp_path / "k.m").write_text("k = 7;\n")
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double"}),
        ("MATLABFcn", "f", {"MATLABFcn": "twice(u) - k"}),
        ("Outport", "y", {}),
    ]
    whole = read_model(slx(model(blocks, [("u", "f"), ("f", "y")]), tmp_path / "m.slx"))
    found = import_system(whole, workspace={"k": np.array([[3.0]])}, folders=[tmp_path], dt=DT)
    assert np.array_equal(flown(found, {"u": DRAWN[0]})["y"], 2.0 * DRAWN[0] + 0.5 - 3.0)
    (refused,) = import_system(whole, workspace={"k": np.array([[3.0]])}, dt=DT).refused
    assert "twice" in refused.why
    method = "methods\nfunction y = twice(u)\ny = 2 * u;\nend\nend"
    (tmp_path / "twice.m").write_text(f"\n% a class\nclassdef twice\n{method}\nend\n")
    (refused,) = import_system(whole, workspace={"k": np.array([[3.0]])}, folders=[tmp_path], dt=DT).refused
    assert "twice.m: there is no function in it, but a class" in refused.why


def test_blocks_share_no_memory_in_the_base_workspace(tmp_path: Path) -> None:
    (tmp_path / "before.m").write_text(
        "function y = before(u)\ny = evalin('base', 'last') + k();\nassignin('base', 'last', u);\n"
        "function y = k()\ny = evalin('base', 'start');\n"
    )
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double"}),
        ("MATLABFcn", "f", {"MATLABFcn": "before(u)"}),
        ("MATLABFcn", "g", {"MATLABFcn": "before(2 * u)"}),
        ("Outport", "y", {}),
    ]
    given = {"last": np.array([[7.0]]), "start": np.array([[0.5]])}
    lines = [("u", "f"), ("f", "y")]
    one = read_model(slx(model([*blocks[:2], blocks[3]], lines), tmp_path / "m.slx"))
    found = import_system(one, workspace=given, folders=[tmp_path], dt=DT)
    assert np.array_equal(flown(found, {"u": DRAWN[0]})["y"], np.concatenate([[7.0], DRAWN[0][:-1]]) + 0.5)
    assert "last of the base workspace" in next(line.why for line in found.report if line.path == "f")
    both = read_model(slx(model(blocks, [*lines, ("f", "g")]), tmp_path / "m.slx"))
    refused = import_system(both, workspace=given, folders=[tmp_path], dt=DT).refused
    assert {line.path: line.why for line in refused} == dict.fromkeys(
        ("f", "g"), "last of the base workspace is used by another block, too"
    )


def test_a_damaged_library_refuses_its_links_alone(tmp_path: Path) -> None:
    (tmp_path / "torn.slx").write_bytes(b"PK and then nothing")
    blocks = [
        ("Inport", "u", {"OutDataTypeStr": "double"}),
        ("Reference", "linked", {"SourceBlock": "torn/half"}),
        ("S-Function", "own", {}),
        ("Outport", "y", {}),
    ]
    whole = read_model(slx(model(blocks, [("u", "linked"), ("u", "own"), ("linked", "y")]), tmp_path / "m.slx"))
    found = import_system(whole, folders=[tmp_path], otherwise=DT)
    assert {line.path for line in found.refused} == {"linked", "own"}
    assert found.notes == ["the model says no period: 0.01 s is taken"]
