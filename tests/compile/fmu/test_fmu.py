"""FMUs in fmpy: valid descriptions, the bits of the native target, parameters that change, and instances apart."""

import io
import math
import re
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.compile.differential import Case, same
from tests.compile.examples import loop
from tests.compile.fmu.importer import Imported
from tests.compile.test_matrices import language_page_filter, total
from tests.compile.typed_signals import bused, enumerated
from tests.compile.whole_library import room, strange_inputs
from tests.toolchains import need
from twodof.blocks import Block, Diagram, Param, Port, sum
from twodof.compile import build
from twodof.compile.fmu.export import make_fmu
from twodof.compile.fmu.variables import MOST_SCALARS
from twodof.errors import CompileError, DiagramError, LogError
from twodof.flight.starters import starter

from fmpy.validation import validate_fmu  # isort: skip - after `importer`, which skips this file without fmpy

pytestmark = pytest.mark.slow

DT = 0.01
LONG, SHORT = 10_000, 200
BOTH = ("3.0", "2.0")


@dataclass(frozen=True)
class Example:
    """A diagram, its precision, and the versions of FMI that it is compared in."""

    make: Callable[[], Diagram]
    precision: str
    versions: tuple[str, ...] = BOTH


EXAMPLES = {
    "stock-attitude": Example(lambda: starter("stock-attitude"), "float32"),
    "lqr-attitude": Example(lambda: starter("lqr-attitude"), "float64"),
    "pid-position": Example(lambda: starter("pid-position"), "float32"),
    "stock-motor": Example(lambda: starter("stock-motor"), "float64"),
    "loop": Example(loop, "float64"),
    "filters": Example(lambda: room("filters", False), "float64"),
    "nonlinear": Example(lambda: room("nonlinear", False), "float32"),
    "continuous": Example(lambda: room("continuous", False), "float64"),
    "kalman": Example(language_page_filter, "float64"),
    "matrices": Example(lambda: total(shape=(2, 3)), "float32"),
    "enumerations": Example(lambda: enumerated().case.diagram, "float32"),
    "buses": Example(lambda: bused().case.diagram, "float64"),
}


@pytest.fixture(autouse=True)
def compiler() -> None:
    need("gcc")


def written(diagram: Diagram, folder: Path, version: str, precision: str = "float64", dt: float = DT) -> Path:
    file = folder / f"{diagram.name}-{version}.fmu"
    make_fmu(diagram, dt, precision, version).write(file, overwrite=True)
    return file


def inputs(d: Diagram, steps: int) -> dict[str, NDArray[Any]]:
    """Columns of the inputs, of the shape (steps, elements), matrices row after row."""
    columns = Case(d, [], strange_inputs(d, steps, 5), {}).columns(steps)
    for name, port in d.inputs.items():
        if port.enum is not None:
            columns[name] = np.random.default_rng(6).choice(list(port.enum.members.values()), columns[name].shape)
    return {name: column.reshape(steps, -1) for name, column in columns.items()}


def native(d: Diagram, precision: str, columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the outputs of the native target."""
    steps = len(next(iter(columns.values())))
    shaped = {
        n: c.reshape(steps, *(d.inputs[n].shape or ((-1,) if d.inputs[n].width else ()))) for n, c in columns.items()
    }
    outputs = build(d, DT, precision).machine().run(steps, shaped)
    return {name: np.asarray(column).reshape(steps, -1) for name, column in outputs.items()}


def apart(version: str, columns: dict[str, NDArray[Any]], shapes: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """Return the columns by the names of the FMU: in FMI 2.0 an element is a variable of its own."""
    if version == "3.0":
        return columns
    found = {}
    for name, column in columns.items():
        for k, index in enumerate(np.ndindex(*shapes[name])):
            element = f"{name}[{','.join(str(i + 1) for i in index)}]" if index else name
            found[element] = column[:, k : k + 1]
    return found


def renamed(output: str, d: Diagram) -> str:
    return f"{output}_out" if output in d.inputs else output


def compare(example: Example, version: str, steps: int, folder: Path) -> None:
    d, precision = example.make(), example.precision
    columns = inputs(d, steps)
    expected = native(d, precision, columns)
    lowered = make_fmu(d, DT, precision).variables
    shapes = {v.name: v.shape for v in lowered}
    file = written(d, folder, version, precision)
    assert validate_fmu(str(file)) == []
    with Imported(file) as one:
        got = one.run(steps, DT, apart(version, columns, shapes))
    wanted = apart(version, {renamed(name, d): column for name, column in expected.items()}, shapes)
    assert got.keys() == wanted.keys()
    for name, column in wanted.items():
        equal = same(column, got[name].astype(column.dtype))
        assert equal.all(), (name, int(np.argmin(equal)))


@pytest.mark.parametrize("version", BOTH)
@pytest.mark.parametrize("name", ["stock-attitude", "matrices"])
def test_an_fmu_has_the_bits_of_the_native_target(name: str, version: str, tmp_path: Path) -> None:
    compare(EXAMPLES[name], version, SHORT, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize(("name", "version"), [(n, v) for n, e in EXAMPLES.items() for v in e.versions])
def test_the_bits_are_native_over_ten_thousand_steps(name: str, version: str, tmp_path: Path) -> None:
    compare(EXAMPLES[name], version, LONG, tmp_path)


@pytest.mark.parametrize("version", BOTH)
def test_parameters_are_tuned_between_two_steps(version: str, tmp_path: Path) -> None:
    judge = build(loop(), DT).machine()
    judge.set_many({"sum.start": 0.25, "pendulum.theta0": 0.3})
    judge.reset()  # both are initial states
    r = np.full((50, 1), 0.4)
    with Imported(written(loop(), tmp_path, version), {"sum.start": 0.25, "pendulum.theta0": 0.3}) as one:
        for values in ({}, {"k": 3.0}, {"pendulum.omega": 3.5, "pendulum.zeta": 0.2}, {"sum.limit": 0.01}):
            judge.set_many(values)
            for name, value in values.items():
                one.set(name, value)
                assert one.get(name) == value
            got, want = one.run(50, DT, {"r": r}), judge.run(50, {"r": r[:, 0]})
            for name, column in want.items():
                assert np.array_equal(got[name][:, 0], column), (values, name)


def test_a_value_beyond_its_bounds_is_refused_with_a_message(tmp_path: Path) -> None:
    with Imported(written(loop(), tmp_path, "3.0")) as one:
        for bad in (10.5, math.nan):
            with pytest.raises(Exception, match="fmi3SetFloat64"):
                one.set("k", bad)
        assert one.get("k") == 2.0
        with pytest.raises(Exception, match="fmi3SetFloat64"):
            one.set("theta", 0.1)
    assert one.messages == ["k: 10.5 is not within 0 and 10", "k: nan is not within 0 and 10", "theta cannot be set"]


def test_only_members_of_an_enumeration_are_accepted(tmp_path: Path) -> None:
    with Imported(written(enumerated().case.diagram, tmp_path, "3.0")) as one:
        one.set("asked", -(2**31))
        with pytest.raises(Exception, match="fmi3SetInt32"):
            one.set("asked", 2)
        assert one.get("asked") == -(2**31)
        assert "5: flying" in one.variables["asked"].description
    assert one.messages == ["asked: 2 is not a member of its enumeration: see modelDescription.xml"]


def test_a_float32_bound_itself_is_allowed(tmp_path: Path) -> None:
    """0.12 in float32 is below 0.12, and .3 is above: the bounds are rounded like the values."""
    with Imported(written(starter("stock-attitude"), tmp_path, "3.0", "float32")) as one:
        one.set("rate.kp", 0.12)
        assert one.get("rate.kp") == np.float32(0.12)
        one.set("rate.kd", 0.003)
        with pytest.raises(Exception, match="fmi3SetFloat32"):
            one.set("rate.kd", 0.00301)


@pytest.mark.parametrize("version", BOTH)
def test_two_instances_share_nothing(version: str, tmp_path: Path) -> None:
    file = written(loop(), tmp_path, version)
    r = np.random.default_rng(3).normal(size=(100, 1))
    with Imported(file) as alone:
        expected = alone.run(100, DT, {"r": r})
    with Imported(file) as one, Imported(file, {"k": 9.0}) as other:
        for k in range(100):
            for each, column in ((one, r), (other, -5.0 * r)):
                each.run(1, DT, {"r": column[k : k + 1]})
            assert one.get("theta") == expected["theta"][k]
        assert other.get("theta") != one.get("theta")
        assert (one.get("k"), other.get("k")) == (2.0, 9.0)


@pytest.mark.parametrize("version", BOTH)
def test_a_step_may_be_several_periods_and_nothing_else(version: str, tmp_path: Path) -> None:
    r = np.ones((12, 1))
    with Imported(written(loop(), tmp_path, version)) as one:
        expected = one.run(12, DT, {"r": r})["theta"]
    with Imported(written(loop(), tmp_path, version)) as one:
        for size, tick in ((3 * DT, 2), (DT, 3), (0.07999999999999999, 11)):
            for bad in (0.5 * DT, 1.05 * size, 0.0, -DT, math.nan, math.inf, 1.00001 * size):
                with pytest.raises(Exception, match="DoStep"):
                    one.fmu.doStep(one.time, bad)
            one.set("r", 1.0)
            one.step(size)
            assert one.get("theta") == expected[tick]
    if version == "3.0":
        assert one.messages[0] == (
            "doStep: 0.005 s is not a whole number of periods of 0.01 s: step by a multiple of them, at most 1e+08"
        )


@pytest.mark.parametrize("version", BOTH)
def test_reset_and_a_kept_state_give_the_same_run_again(version: str, tmp_path: Path) -> None:
    r = np.random.default_rng(4).normal(size=(40, 1))
    with Imported(written(loop(), tmp_path, version)) as one:
        fmu = one.fmu
        get, put, free = (getattr(fmu, f"{verb}FMU{'S' if one.newer else 's'}tate") for verb in ("get", "set", "free"))
        first = one.run(40, DT, {"r": r})["theta"]
        state = get()
        data = (fmu.serializeFMUState if one.newer else fmu.serializeFMUstate)(state)
        then = one.run(40, DT, {"r": r})["theta"]
        put(state)
        assert np.array_equal(one.run(40, DT, {"r": r})["theta"], then)
        free(state)
        fmu.reset()
        one.begin()
        assert np.array_equal(one.run(40, DT, {"r": r})["theta"], first)
    with Imported(written(loop(), tmp_path, version)) as other:
        read = other.fmu.deserializeFMUState if other.newer else other.fmu.deSerializeFMUstate
        setter = other.fmu.setFMUState if other.newer else other.fmu.setFMUstate
        setter(read(data))
        assert np.array_equal(other.run(40, DT, {"r": r})["theta"], then)
        with pytest.raises(Exception, match="erializeFMU"):
            read(b"x" * len(data))


def test_outputs_before_the_first_step_are_those_of_the_first_tick(tmp_path: Path) -> None:
    d = total(shape=(2, 3))
    with Imported(written(d, tmp_path, "3.0"), begin=False) as one:
        one.set("m", range(6))
        assert one.get("y") == 15.0
        one.begin(start=7.5)
        assert one.get("y") == 15.0
        assert one.get("m_out").tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
        assert one.get("time") == 7.5
        one.step(3 * DT)
        assert one.get("time") == 7.5 + 3 * DT


class Weights(Block):
    """Parameters of several kinds, one of them fixed."""

    outputs = (Port("y"),)
    params = (
        Param("w", [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], shape=(2, 3), unit="N*m", text='weights <of> "rows" & columns'),
        Param("n", 3, "int16", unit="samples", low=-5, high=500),
        Param("seed", 7, "uint32", tunable=False),
        Param("on", True, "bool"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return sum(p.w)


def weighed() -> Diagram:
    d = Diagram("weighed", "weights \x01 & more")
    d.add("weights", Weights())
    d.output("y", "weights")
    return d


def test_the_description_says_units_bounds_and_texts(tmp_path: Path) -> None:
    file = written(weighed(), tmp_path, "3.0", dt=0.004)
    assert validate_fmu(str(file)) == []
    with Imported(file) as one:
        w, n, seed, on = (one.variables[f"weights.{name}"] for name in ("w", "n", "seed", "on"))
        assert one.description.coSimulation.fixedInternalStepSize == "0.004"
        assert one.description.description == "weights & more"
        assert (w.unit, w.description, w.variability) == ("N*m", 'weights <of> "rows" & columns', "tunable")
        assert (w.start, [d.start for d in w.dimensions]) == ("1.0 2.0 3.0 4.0 5.0 6.0", [2, 3])
        assert (n.type, n.min, n.max, n.description) == ("Int16", "-5", "500", "[samples]")
        assert (seed.type, seed.variability, seed.start) == ("UInt32", "fixed", "7")
        assert (on.type, on.start) == ("Boolean", "true")
        one.set("weights.w", [1.0, 1.0, 1.0, 1.0, 1.0, 2.0])
        one.step(0.004)
        assert one.get("y") == 7.0
        with pytest.raises(Exception, match="fmi3SetUInt32"):
            one.set("weights.seed", 8)
    assert one.messages == ["weights.seed is fixed after the initialization"]


@pytest.mark.parametrize("version", BOTH)
def test_a_loop_around_the_fmu_is_no_algebraic_one(version: str, tmp_path: Path) -> None:
    file = written(total(shape=(2, 3)), tmp_path, version)
    assert validate_fmu(str(file)) == []
    with Imported(file) as one:
        assert all(unknown.dependencies == [] for unknown in one.description.outputs)
        assert all(unknown.dependencies is None for unknown in one.description.initialUnknowns)
        element = "m" if version == "3.0" else "m[1,1]"
        one.set(element, [1.0] * one.size(element))
        one.step(DT)
        before = one.get("y")
        one.set(element, [5.0] * one.size(element))
        assert one.get("y") == before


def test_what_fmi_cannot_hold_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DiagramError, match=r"weights\.seed: FMI 2\.0 has no uint32.*--fmi 3\.0"):
        make_fmu(weighed(), DT, version="2.0")
    wide = Diagram("wide")
    wide.input("v", width=MOST_SCALARS + 1)
    wide.output("y", "v")
    with pytest.raises(DiagramError, match="no arrays"):
        make_fmu(wide, DT, version="2.0")
    with pytest.raises(DiagramError, match=r"FMI '1\.0' is not supported.*use 3\.0 or 2\.0"):
        make_fmu(loop(), DT, version="1.0")


def test_the_same_diagram_gives_the_same_file(tmp_path: Path) -> None:
    first, second = (written(loop(), tmp_path, "3.0").read_bytes() for _ in range(2))
    assert first == second
    with zipfile.ZipFile(io.BytesIO(first)) as archive:
        assert {*archive.namelist()} >= {"sources/loop.c", "resources/diagram.json", "modelDescription.xml"}
    with pytest.raises(LogError, match="is there already"):
        make_fmu(loop(), DT).write(tmp_path / "loop-3.0.fmu")


def test_the_program_of_the_page_prints_the_first_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "export-an-fmu.md").read_text()
    (program,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    monkeypatch.chdir(tmp_path)
    d = starter("lqr-attitude")
    make_fmu(d, 0.004).write("lqr.fmu")
    exec(program, {})
    judge = build(d, 0.004).machine()
    judge.set("k_theta", 1.2)
    moment = judge.step({"FLAG_ATTITUDE_ENABLED": True, "theta_0": 0.1})["M"]
    assert moment > 0.0
    assert capsys.readouterr().out == f"M {moment:.4f} in the first period\n"


def test_a_computer_without_a_name_in_fmi_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    with pytest.raises(CompileError, match=r"FMI has no name for the platform \w+ riscv64.*Linux x86_64"):
        make_fmu(loop(), DT).files()
