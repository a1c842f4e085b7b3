"""Programs of mixed precision and short integers against C by hand, against numpy, and on every target.

The bits of each operation are compared in `test_targets.py` (`every_operator`, random diagrams).
"""

from __future__ import annotations

import ctypes
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.compile.c.test_emitter import LEAN, lean_source, strictly
from tests.toolchains import need
from twodof.blocks import (
    Block,
    Diagram,
    Param,
    Port,
    State,
    array_of,
    atan2,
    exp,
    fold,
    minimum,
    round_half_even,
    store,
    sum,
    to_float32,
    to_float64,
    to_int8,
    to_int16,
    to_int32,
    to_real,
    to_uint8,
    to_uint16,
    where,
)
from twodof.blocks.library import Convert, Maximum, Sum, UnitDelay
from twodof.blocks.reference import Reference
from twodof.blocks.schema import from_json, to_json
from twodof.compile import build
from twodof.compile.builder import emit_program
from twodof.compile.linear.linearize import linearize
from twodof.compile.stepper import Stepper
from twodof.compile.wasm.module import compile_module
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow

PRECISIONS = ("float64", "float32")
STEPS = 300
ALPHA = 0.0317


class Sensor(Block):
    """A 16-bit sensor, a filter in doubles, its sum in singles, and a counter of 8 bits."""

    inputs = (Port("v", "float64"),)
    outputs = (Port("raw", "int16"), Port("smooth", "float64"), Port("total", "float32"), Port("count", "uint8"))
    states = (State("smooth", 0.0, "float64"), State("total", 0.1, "float32"), State("count", "first", "uint8"))
    params = (Param("alpha", ALPHA, "float64"), Param("first", 250, "uint8"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        raw = to_int16(round_half_even(u.v * 1000.0), overflow="saturate")
        smooth = x.smooth + p.alpha * (to_float64(raw) * 0.001 - x.smooth)
        total = x.total * 0.999 + to_float32(smooth)
        return {"raw": raw, "smooth": smooth, "total": total, "count": to_uint8(x.count + 7, overflow="wrap")}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        given = self.output(u, x, p, t)
        return {name: given[name] for name in ("smooth", "total", "count")}


BY_HAND = """
#include <math.h>
#include <stdint.h>
void run(int n, const double *v, double alpha, int16_t *raw, double *smooth, float *total, uint8_t *count)
{
    double s = 0.0;
    float sum = 0.1f;
    uint8_t c = 250;
    for (int k = 0; k < n; k++) {
        const double scaled = rint(v[k] * 1000.0);
        raw[k] = isnan(scaled) ? 0 : scaled > 32767 ? 32767 : scaled < -32768 ? -32768 : (int16_t)scaled;
        smooth[k] = s = s + alpha * (raw[k] * 0.001 - s);
        total[k] = sum = sum * 0.999f + (float)s;
        count[k] = c += 7;
    }
}
"""


def diagram() -> Diagram:
    d = Diagram("mixed")
    d.input("v", "float64")
    d.add("sensor", Sensor(), v="v")
    for port in Sensor.outputs:
        d.output(port.name, f"sensor.{port.name}")
    return d


def measured() -> NDArray[np.float64]:
    """A signal with saturated values, halves, NaN and infinities."""
    v = np.random.default_rng(1).normal(0.0, 15.0, STEPS)
    v[::7] = np.round(v[::7], 1) + 0.0005
    v[20:24] = np.nan, np.inf, -np.inf, -0.0
    return v


def by_hand(folder: Path) -> dict[str, NDArray[Any]]:
    """What the C above gives, compiled by gcc."""
    need("gcc")
    (folder / "hand.c").write_text(BY_HAND)
    command = ["gcc", "-O2", "-ffp-contract=off", "-shared", "-fPIC", "-o", "hand.so", "hand.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    made: dict[str, NDArray[Any]] = {port.name: np.zeros(STEPS, port.kind) for port in Sensor.outputs}
    v = measured()
    pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (v, *made.values())]
    ctypes.CDLL(str(folder / "hand.so")).run(STEPS, pointers[0], ctypes.c_double(ALPHA), *pointers[1:])
    return made


def with_numpy() -> dict[str, NDArray[Any]]:
    """The same with numpy's scalars."""
    made: dict[str, NDArray[Any]] = {port.name: np.zeros(STEPS, port.kind) for port in Sensor.outputs}
    smooth, total, count = np.float64(0.0), np.float32(0.1), np.uint8(250)
    for k, v in enumerate(measured()):
        raw = np.int16(np.clip(np.rint(np.nan_to_num(v, posinf=1e9, neginf=-1e9) * 1000.0), -32768, 32767))
        smooth = smooth + np.float64(ALPHA) * (np.float64(raw) * 0.001 - smooth)
        total = np.float32(total * np.float32(0.999) + np.float32(smooth))
        with np.errstate(over="ignore"):
            count = np.uint8(count + np.uint8(7))
        for name, value in (("raw", raw), ("smooth", smooth), ("total", total), ("count", count)):
            made[name][k] = value
    return made


def judged(results: dict[str, NDArray[Any]], expected: dict[str, NDArray[Any]]) -> None:
    for name, want in expected.items():
        assert results[name].dtype == want.dtype
        assert results[name].tobytes() == want.tobytes(), name


@pytest.mark.parametrize("precision", PRECISIONS)
def test_mixed_precision_has_the_bits_of_c_by_hand_and_of_numpy_in_both_builds(precision: str, tmp_path: Path) -> None:
    results = build(diagram(), 0.01, precision=precision).machine().run(STEPS, {"v": measured()})
    judged(results, by_hand(tmp_path))
    judged(results, with_numpy())


class Everything(Block):
    """Functions, arrays, loops, choices and states of the kinds beside real."""

    inputs = (Port("a", "float32"), Port("b", "float64"), Port("i", "int8"), Port("v", "float32", 3))
    outputs = (
        Port("angle", "float32"),
        Port("power", "float64"),
        Port("w", "float32", 3),
        Port("ring", "int8", 20),
        Port("m", "float64", shape=(2, 2)),
    )
    states = (State("ring", 0, "int8", 20), State("at", 0, "uint16"))
    params = (Param("gain", [[0.1, 0.2], [0.3, 0.4]], "float64", shape=(2, 2)), Param("low", -5, "int8"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {
            "angle": atan2(u.a, where(u.i < 0, 0.5, u.a * 3.0)),
            "power": exp(u.b) + to_float64(t.dt),
            "w": array_of(3, lambda k: u.v[k] * u.a + minimum(u.v[2 - k], 0.25)),
            "ring": x.ring,
            "m": p.gain @ p.gain.T * u.b,
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        value = where(u.i < p.low, p.low, u.i)
        return {
            "ring": store(x.ring, x.at, to_int8(value * 3, overflow="wrap")),
            "at": to_uint16((x.at + 1) % 20, overflow="wrap"),
        }


def everything() -> Diagram:
    d = Diagram("everything")
    for port in Everything.inputs:
        d.input(f"in_{port.name}", port.kind, port.width)
    d.add("all", Everything(), **{port.name: f"in_{port.name}" for port in Everything.inputs})
    for port in Everything.outputs:
        d.output(port.name, f"all.{port.name}")
    return d


def columns(steps: int) -> dict[str, NDArray[Any]]:
    rng = np.random.default_rng(2)
    return {
        "in_a": rng.normal(size=steps),
        "in_b": rng.normal(size=steps),
        "in_i": rng.integers(-128, 128, steps),
        "in_v": rng.normal(size=(steps, 3)),
    }


def reference(d: Diagram, precision: str, inputs: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return Reference(d, 0.01, precision).machine().run(len(next(iter(inputs.values()))), inputs)


RUNS: dict[str, Callable[[Diagram, str, dict[str, NDArray[Any]]], dict[str, Any]]] = {
    "native": lambda d, precision, u: build(d, 0.01, precision=precision).machine().run(40, u),
    "wasm": lambda d, precision, u: build(d, 0.01, precision=precision, target="wasm").machine().run(40, u),
}
TARGETS = ["native", "wasm"]


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("target", TARGETS)
def test_arrays_loops_and_functions_of_all_kinds_have_the_bits_of_the_reference(target: str, precision: str) -> None:
    inputs = columns(40)
    expected = reference(everything(), precision, inputs)
    for name, column in RUNS[target](everything(), precision, inputs).items():
        assert np.array_equal(column, expected[name]), name


def test_a_file_keeps_the_kinds() -> None:
    loaded = from_json(to_json(everything()))
    assert [port.kind for port in loaded.parts["all"].item.outputs] == [port.kind for port in Everything.outputs]
    assert to_json(loaded) == to_json(everything())
    inputs = columns(10)
    for name, column in reference(loaded, "float32", inputs).items():
        assert np.array_equal(column, reference(everything(), "float32", inputs)[name])


def test_a_file_that_converts_to_what_is_not_there_is_refused() -> None:
    text = to_json(everything())
    for kind in ("int64", "bool"):
        other, count = re.subn(r'(\[\s*"convert",\s*\[\s*\d+\s*\],\s*)"int8"', rf'\1"{kind}"', text)
        assert count
        with pytest.raises(DiagramError, match="no such operation"):
            from_json(other)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_firmware_compiles_the_kinds_without_a_warning(precision: str, tmp_path: Path) -> None:
    """A float of another precision becomes a double by name, of which -Wdouble-promotion does not warn."""
    need("gcc")
    done = strictly("gcc", lean_source([diagram(), everything()], precision), tmp_path, *LEAN, "-O1")
    assert done.returncode == 0, done.stderr


def test_parameters_states_and_inputs_keep_to_their_kinds() -> None:
    machine = build(diagram(), 0.01, precision="float32").machine()
    machine.set("sensor.alpha", 0.1)
    assert machine.get("sensor.alpha") == 0.1  # a double, in a build of singles
    with pytest.raises(Exception, match=r"256.*255"):
        machine.set("sensor.first", 256)
    machine.set_state("sensor.count", 257)  # what is written to a state wraps around
    assert machine.state("sensor.count") == 1
    assert machine.state("sensor.total") == float(np.float32(0.1))
    stepper = Stepper(machine, ["v"], ["raw", "smooth", "total", "count"])
    assert stepper.step([40.0]) == (32767, 0.1 * (32767 * 0.001), pytest.approx(3.3766, abs=1e-4), 8)


def test_a_scalar_of_one_byte_has_its_place_in_every_struct() -> None:
    """It is not the byte of a struct without members."""
    program = emit_program(diagram(), 0.01)
    assert program.places["P"]["sensor_first"][1] == program.places["S"]["sensor_count"][1] == 1
    assert "count" in program.places["Y"]
    assert [o["type"] for o in compile_module([program]).interface("mixed")["outputs"]][-1] == "uint8"


def test_library_blocks_of_the_kinds() -> None:
    d = Diagram("library")
    d.input("a", "float32")
    d.input("n", "uint8")
    d.add("double", Convert("float32", "float64"), u="a")
    d.add("sum", Sum("+-", "float64"), a="double", b="memory")
    d.add("memory", UnitDelay(0.1, "float64"), u="sum")
    d.add("short", Convert("float64", "int8", "half_even", overflow="saturate"), u="sum")
    d.add("low", Convert("float64", "uint8", overflow="wrap"), u="sum")
    d.add("most", Maximum(2, "uint8"), a="n", b="low")
    for part in ("sum", "short", "most"):
        d.output(f"{part}_y", part)
    inputs = {"a": np.array([2.5, 300.25, -1e12, np.nan]), "n": np.array([3, 200, 7, 9])}
    results = build(d, 0.01, precision="float32").machine().run(4, inputs)
    first = np.float64(np.float32(2.5)) - 0.1
    assert results["sum_y"][:2].tolist() == [first, 300.25 - first]
    assert results["short_y"].tolist() == [2, 127, -128, 0]
    assert results["most_y"].tolist() == [3, 200, 7, 9]
    with pytest.raises(DiagramError, match=r"Convert: a real may not fit int8.*'wrap' or 'saturate'"):
        Convert("real", "int8")


def test_the_linear_model_of_a_filter_in_singles() -> None:
    """It leaves the roundings out, as it does those of a build."""

    class Singles(Block):
        inputs = (Port("u"),)
        outputs = (Port("y"),)
        states = (State("x", 0.0, "float32"),)

        def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
            return to_real(x.x) * 0.5

        def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
            return x.x * 0.75 + to_float32(u.u) * 0.25

    d = Diagram("singles")
    d.input("u")
    d.add("filter", Singles(), u="u")
    d.output("y", "filter")
    model = linearize(d, 0.01)
    assert (model.a, model.b, model.c, model.d) == ([[0.75]], [[0.25]], [[0.5]], [[0.0]])


class Prepared(Block):
    """Derived parameters of all shapes: a number, arrays from vectors, stores and loops, a matrix, an integer."""

    inputs = (Port("u"),)
    outputs = (
        Port("smooth"),
        Port("scaled", width=3),
        Port("replaced", width=3),
        Port("sums", width=6),
        Port("cube", shape=(2, 2)),
        Port("whole", "int32"),
    )
    params = (
        Param("tau", 0.1),
        Param("z", [1.1, 2.2, 3.3], width=3),
        Param("A", [[1.0, 0.1], [0.2, 1.0]], shape=(2, 2)),
        Param("single", 0.3, "float32"),
    )
    derived = outputs

    def prepare(self, p: Any, t: Any) -> Any:
        smooth = 1.0 - exp(-t.dt / p.tau)
        return {
            "smooth": smooth + to_real(p.single),
            "scaled": p.z * smooth / 3.0,
            "replaced": store(p.z, 1, smooth),
            "sums": array_of(6, lambda i: fold(3, [p.tau], lambda j, s: [s + p.z[j] * to_real(i)])[0] + sum(p.z)),
            "cube": p.A @ p.A.T @ p.A,
            "whole": to_int32(p.tau * 1e9),
        }

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {port.name: p[port.name] for port in self.outputs}


def prepared() -> Diagram:
    d = Diagram("prepared")
    d.input("u")
    d.add("block", Prepared(), u="u")
    for port in Prepared.outputs:
        d.output(port.name, f"block.{port.name}")
    return d


def in_doubles() -> dict[str, Any]:
    """The derived parameters of a build of singles: numpy's doubles from the stored singles, rounded once."""
    tau = np.float64(np.float32(0.1))
    z, A = (np.array(v, np.float32).astype(np.float64) for v in ([1.1, 2.2, 3.3], [[1.0, 0.1], [0.2, 1.0]]))
    smooth = 1.0 - np.exp(-0.01 / tau)
    return {
        "smooth": smooth + np.float64(np.float32(0.3)),
        "scaled": z * smooth / 3.0,
        "replaced": [z[0], smooth, z[2]],
        "sums": [((tau + z[0] * i) + z[1] * i) + z[2] * i + ((z[0] + z[1]) + z[2]) for i in range(6)],
        "cube": A @ A.T @ A,
    }


def test_derived_parameters_are_rounded_once_in_a_build_of_singles() -> None:
    """In singles throughout, most of these numbers have another last bit."""
    machine = Reference(prepared(), 0.01, "float32").machine()
    given = machine.step({"u": 0.0})
    for name, exact in in_doubles().items():
        assert np.array_equal(np.float32(given[name]), np.float32(exact)), name
    assert given["whole"] == int(np.float64(np.float32(0.1)) * 1e9)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("target", TARGETS)
def test_derived_parameters_have_the_bits_of_the_reference(target: str, precision: str) -> None:
    inputs = {"u": np.zeros(40)}
    expected = reference(prepared(), precision, inputs)
    for name, column in RUNS[target](prepared(), precision, inputs).items():
        assert np.array_equal(column, expected[name]), name


def test_a_parameter_that_is_tuned_is_prepared_in_doubles_on_board() -> None:
    native, judge = (
        p.machine() for p in (build(prepared(), 0.01, precision="float32"), Reference(prepared(), 0.01, "float32"))
    )
    for machine in (native, judge):
        machine.step({"u": 0.0})
        machine.set("block.tau", 0.037)
    assert native.step({"u": 0.0}) == judge.step({"u": 0.0})
