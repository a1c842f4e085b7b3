"""Programs of mixed precision and short integers, against C by hand.

The bits of each operation are compared in `test_targets.py` (`every_operator`, random diagrams).
"""

import ctypes
import subprocess
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
    exp,
    fold,
    round_half_even,
    store,
    sum,
    to_float32,
    to_float64,
    to_int16,
    to_int32,
    to_real,
    to_uint8,
)
from twodof.blocks.reference import Reference
from twodof.compile import build
from twodof.compile.machine import Stepper

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
    """Return the columns that the C above gives."""
    need("gcc")
    (folder / "hand.c").write_text(BY_HAND)
    command = ["gcc", "-O2", "-ffp-contract=off", "-shared", "-fPIC", "-o", "hand.so", "hand.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    made: dict[str, NDArray[Any]] = {port.name: np.zeros(STEPS, port.kind) for port in Sensor.outputs}
    v = measured()
    pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (v, *made.values())]
    ctypes.CDLL(str(folder / "hand.so")).run(STEPS, pointers[0], ctypes.c_double(ALPHA), *pointers[1:])
    return made


def judged(results: dict[str, NDArray[Any]], expected: dict[str, NDArray[Any]]) -> None:
    for name, want in expected.items():
        assert results[name].dtype == want.dtype
        assert results[name].tobytes() == want.tobytes(), name


@pytest.mark.parametrize("precision", PRECISIONS)
def test_mixed_precision_has_the_bits_of_c_by_hand(precision: str, tmp_path: Path) -> None:
    results = build(diagram(), 0.01, precision=precision).machine().run(STEPS, {"v": measured()})
    judged(results, by_hand(tmp_path))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_firmware_compiles_the_kinds_without_a_warning(precision: str, tmp_path: Path) -> None:
    """-Wdouble-promotion is on; a wanted conversion to double is a cast."""
    need("gcc")
    done = strictly("gcc", lean_source([diagram(), prepared()], precision), tmp_path, *LEAN, "-O1")
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
