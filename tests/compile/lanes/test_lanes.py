"""Each lane has the bits of the scalar program for its own values; and the interface of many instances."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compile.differential import random_cases, same
from tests.compile.lanes import lanes_differential
from tests.compile.lanes.lanes_differential import SPECIAL, compared, lane_differences
from tests.compile.test_corners import LOGGED, corners
from twodof.blocks import Block, Diagram, Param, Port, State
from twodof.compile import CompiledProgram, build
from twodof.compile.lanes.lanes_program import SIMD, Simd, best_simd, build_lanes
from twodof.errors import CompileError, DiagramError, ParameterError
from twodof.rig.parameters import lab
from twodof.rig.rig import BASE_DT
from twodof.sim.closed_loop import closed_loop

pytestmark = pytest.mark.slow

HERE = [name for name in SIMD if list(SIMD).index(name) >= list(SIMD).index(best_simd())]
"""The vectors that this processor has."""

PRECISIONS = ("float64", "float32")
LANES = 9  # no multiple of any vector's length


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("simd", HERE)
def test_random_diagrams_have_the_scalar_bits_in_each_lane(simd: str, precision: str) -> None:
    first = 300 + 20 * HERE.index(simd)
    cases = random_cases(range(first, first + 3), 120)
    found = lane_differences(cases, precision, ("rk4", "euler")[precision == "float32"], simd, LANES)
    assert not found, "\n".join(found[:20])


@pytest.mark.parametrize(
    ("precision", "count"), [("float64", 1), *(pytest.param(p, 6, marks=pytest.mark.soak) for p in PRECISIONS)]
)
def test_zig_gives_the_same_bits(precision: str, count: int) -> None:
    cases = random_cases(range(360, 360 + count), 120)
    found = lane_differences(cases, precision, "rk4", best_simd(), LANES, "zig")
    assert not found, "\n".join(found[:20])


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_masks_of_bits_need_no_avx512(precision: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What AVX-512's intrinsics do with masks is also written in C; here for a processor without them."""
    monkeypatch.setitem(SIMD, "avx512", Simd("avx512", 64, 2, (), False))
    found = lane_differences(random_cases(range(370, 372), 120), precision, "rk4", "avx512", 19)
    assert not found, "\n".join(found[:20])


@pytest.mark.soak
@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("chunk", range(40))
def test_many_random_diagrams_have_the_scalar_bits(chunk: int, precision: str) -> None:
    cases = random_cases(range(20_000 + 10 * chunk, 20_010 + 10 * chunk), 400)
    found = lane_differences(cases, precision, ("rk4", "euler")[chunk % 2], HERE[chunk % len(HERE)], LANES)
    assert not found, "\n".join(found[:20])


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("integrator", ["rk4", "euler"])
def test_conditions_edges_and_arrays_of_each_lane_its_own(precision: str, integrator: str) -> None:
    lanes, steps = 7, 200
    program = build_lanes(corners(), 0.01, lanes, precision, LOGGED, integrator, optimise="-O1")
    alone = build(corners(), 0.01, precision, LOGGED, integrator, optimise="-O1")
    assert isinstance(alone, CompiledProgram)
    machine = program.machine()
    rng = np.random.default_rng(1)
    u = rng.normal(size=(steps, lanes))
    odd = rng.random(u.shape) < 0.05
    u[odd] = rng.choice(SPECIAL, int(odd.sum()))
    inputs: dict[str, Any] = {"u": u, "i": rng.integers(-2, 7, u.shape).astype(np.int32)}
    inputs |= {name: rng.random(u.shape) < p for name, p in (("on", 0.7), ("again", 0.1), ("awake", 0.8))}
    fractions = np.linspace(0.1, 0.9, lanes)
    machine.set("middle.inner.edged.f", fractions)
    results = machine.run(steps, inputs)
    for lane in range(lanes):
        single = alone.machine()
        single.set("middle.inner.edged.f", fractions[lane])
        want = single.run(steps, {n: np.ascontiguousarray(v[:, lane]) for n, v in inputs.items()})
        assert not compared(corners(), lane, want, results, single, machine)


@pytest.fixture(scope="module", params=["float64", "float32"])
def loops(request: pytest.FixtureRequest) -> tuple[Any, Any]:
    """The closed loop in 64 lanes and alone."""
    program = build_lanes(closed_loop(), BASE_DT, 64, request.param)
    alone = build(closed_loop(), BASE_DT, request.param)
    assert isinstance(alone, CompiledProgram)
    return program, alone


def test_64_closed_loops_fly_like_64_alone(loops: tuple[Any, Any]) -> None:
    """Seeds, masses, gains, delays and sensor rates of each its own; hundreds of steps in each of three modes."""
    program, alone = loops
    rng = np.random.default_rng(2)
    parameters: dict[str, Any] = {f"rig.{name}": [value] * 64 for name, value in lab().snapshot().items()}
    for name in ("mass_drone", "inertia", "delay", "tof_rate", "tof_age", "rail_coulomb"):
        parameters[f"rig.{name}"] = (np.array(parameters[f"rig.{name}"]) * rng.uniform(0.8, 1.2, 64)).tolist()
    parameters["rig.seed"] = list(range(64))
    parameters["rig.rings"] = [lane % 5 == 0 for lane in range(64)]
    parameters["flight.cascade.attitude.kp"] = rng.uniform(3.0, 6.0, 64).tolist()
    machine = program.machine()
    machine.set_many(parameters)
    machine.reset()
    flights = [{"mode": 3, "thrust": 0.4, "theta0": 0.1}, {"mode": 5, "x0": 0.1}, {"mode": 4, "v0": 0.2}]
    steps = 600
    columns = {name: np.repeat([f.get(name, 0.0) for f in flights], steps) for name in ("thrust", "theta0", "x0", "v0")}
    columns["mode"] = np.repeat([3, 5, 4], steps)
    columns["theta0"] = columns["theta0"][:, np.newaxis] * rng.uniform(0.5, 1.5, 64)
    results = machine.run(3 * steps, columns)
    assert np.ptp(results["true_theta"][-1]) > 1e-3, "the lanes should fly differently"
    for lane in (0, 1, 17, 40, 63):
        single = alone.machine()
        single.set_many({path: values[lane] for path, values in parameters.items()})
        single.reset()
        own = {n: c if c.ndim == 1 else np.ascontiguousarray(c[:, lane]) for n, c in columns.items()}
        want = single.run(3 * steps, own)
        assert not compared(program.flat, lane, want, results, single, machine)


def test_what_a_lane_is_given_does_not_touch_the_others(loops: tuple[Any, Any]) -> None:
    program, _ = loops
    quiet, disturbed = program.machine(), program.machine()
    disturbed.set("rig.seed", [1] * 63 + [99])
    disturbed.set_state("rig.dynamics.theta", [0.0] * 63 + [float("nan")])
    a, b = quiet.run(200, {"mode": 3, "thrust": 0.4}), disturbed.run(200, {"mode": 3, "thrust": 0.4})
    for name in a:
        assert same(np.ascontiguousarray(a[name][:, :63]), np.ascontiguousarray(b[name][:, :63])).all(), name
    assert np.isnan(b["true_theta"][1:, 63]).all()


class Accumulator(Block):
    """x += gain * u, with an integer, a flag and an array beside it."""

    inputs = (Port("u"), Port("w", width=2), Port("n", "int32"), Port("flag", "bool"))
    outputs = (Port("y"), Port("a", width=2), Port("m", "int32"), Port("not_flag", "bool"))
    params = (Param("gain", 1.0, low=0.0, high=10.0), Param("size", 3, "int32", low=1, high=5, tunable=False))
    states = (State("x", 0.0), State("mem", 0.5, width=2))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"y": x.x, "a": u.w, "m": u.n + p.size, "not_flag": ~u.flag}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"x": x.x + p.gain * u.u}


def accumulators(lanes: int, precision: str = "float64") -> Any:
    d = Diagram("accumulators")
    d.input("u")
    d.input("w", width=2)
    d.input("n", "int32")
    d.input("flag", "bool")
    d.add("acc", Accumulator(), u="u", w="w", n="n", flag="flag")
    for name in ("y", "a", "m", "not_flag"):
        d.output(name, f"acc.{name}")
    return build_lanes(d, 0.1, lanes, precision, optimise="-O1").machine()


def test_values_are_one_for_all_or_one_for_each() -> None:
    machine = accumulators(5)
    machine.set_many({"acc.gain": [1.0, 2.0, 3.0, 4.0, 5.0], "acc.size": range(1, 6)})
    assert machine.get("acc.gain").tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    out = machine.step({"u": 1.0, "w": [7.0, 8.0], "n": [1, 2, 3, 4, 5], "flag": [True, False, True, False, True]})
    assert out["a"].tolist() == [[7.0, 8.0]] * 5
    assert out["m"].tolist() == [2, 4, 6, 8, 10]
    assert out["m"].dtype == np.int32
    assert out["not_flag"].tolist() == [False, True, False, True, False]
    assert out["not_flag"].dtype == np.bool_
    assert machine.step()["y"].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert machine.state("acc.x").tolist() == [2.0, 4.0, 6.0, 8.0, 10.0]  # u keeps its value
    machine.set_state("acc.x", [0.0, 0.0, 0.0, 0.0, -1.0])
    machine.set_state("acc.mem", [[float(i), 1.0] for i in range(5)])
    assert machine.state("acc.mem").tolist() == [[float(i), 1.0] for i in range(5)]
    assert machine.tick == 2
    machine.reset()
    assert machine.tick == 0
    assert machine.state("acc.x").tolist() == [0.0] * 5


def test_inputs_of_a_run() -> None:
    steps, lanes = 600, 5  # more than one chunk of outputs
    machine = accumulators(lanes)
    u = np.arange(steps * lanes, dtype=np.float64).reshape(steps, lanes)
    w = np.stack([u, -u], axis=-1)
    out = machine.run(
        steps, {"u": u, "w": w, "n": np.arange(steps), "flag": np.array([[True, False, True, False, True]])}
    )
    assert np.array_equal(out["y"], np.vstack([np.zeros(lanes), np.cumsum(u, axis=0)[:-1]]))
    assert np.array_equal(out["a"], w)
    assert np.array_equal(out["m"], np.repeat(np.arange(steps)[:, np.newaxis] + 3, lanes, axis=1))
    assert (out["not_flag"] == [False, True, False, True, False]).all()
    assert np.array_equal(machine.step()["a"], w[-1])  # inputs keep their last values
    assert machine.run(0)["a"].shape == (0, lanes, 2)
    x = machine.state("acc.x")
    machine.skip(10)
    assert np.array_equal(machine.state("acc.x"), x + 10.0 * u[-1])
    assert machine.tick == steps + 11


def test_a_refused_value_names_its_lane_and_bound_and_changes_nothing() -> None:
    machine = accumulators(5)
    with pytest.raises(ParameterError, match=r"lane 3: 11 is outside 0 to 10"):
        machine.set_many({"acc.size": 2, "acc.gain": [1.0, 2.0, 3.0, 11.0, 5.0]})
    assert machine.get("acc.gain").tolist() == [1.0] * 5
    assert machine.get("acc.size").tolist() == [3] * 5
    with pytest.raises(ParameterError, match="differ in length"):
        machine.set("acc.gain", [[1.0], [1.0, 2.0]])
    with pytest.raises(ParameterError, match="nan is outside"):
        machine.set("acc.gain", float("nan"))
    with pytest.raises(ParameterError, match=r"shape \(4,\) for 5 lanes"):
        machine.set("acc.gain", [1.0] * 4)
    with pytest.raises(ParameterError, match="lane 0: a real is expected and '1' of type str"):
        machine.set("acc.gain", ["1", "x", "y", "z", "0"])
    with pytest.raises(ParameterError, match=r"no parameter 'acc\.gian'"):
        machine.set("acc.gian", 1.0)
    machine.step()
    with pytest.raises(ParameterError, match="fixed while the diagram runs"):
        machine.set("acc.size", 4)


def test_mistakes_of_the_caller() -> None:
    machine = accumulators(5)
    with pytest.raises(DiagramError, match="no input 'v'"):
        machine.run(3, {"v": 1.0})
    with pytest.raises(DiagramError, match=r"shape \(4, 5\)"):
        machine.run(3, {"u": np.zeros((4, 5))})
    with pytest.raises(DiagramError, match="float64"):
        machine.run(3, {"n": np.zeros(3)})
    with pytest.raises(DiagramError, match="no state"):
        machine.state("acc.z")
    with pytest.raises(DiagramError, match="values"):
        machine.run(100_000_000)
    for lanes in (0, -1, 10**6, True, 2.5):
        with pytest.raises(DiagramError, match="lanes"):
            build_lanes(corners(), 0.01, lanes)
    with pytest.raises(CompileError, match="no vectors 'mmx'"):
        build_lanes(corners(), 0.01, 4, simd="mmx")


@pytest.mark.long
def test_contraction_in_lanes_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """a * b + c in one rounding, as compilers do unless they are told not to."""
    if "fma" not in Path("/proc/cpuinfo").read_text(encoding="utf-8").split():
        pytest.skip("this processor has no FMA")
    cases = random_cases(range(230, 240), 100)
    simd = best_simd()
    assert not lane_differences(cases, "float64", "rk4", simd, LANES, optimise="-O2")
    emit = lanes_differential.emit

    def contracted(*args: Any, **named: Any) -> Any:
        programs = emit(*args, **named)
        head, _, rest = programs[0].source.partition("#if defined(__clang__)\n")
        return [replace(p, source=head + rest.partition("#endif\n")[2]) for p in programs]

    monkeypatch.setattr(lanes_differential, "emit", contracted)
    flags = SIMD[simd].flags
    monkeypatch.setitem(SIMD, simd, type(SIMD[simd])(simd, SIMD[simd].size, 2, (*flags, "-ffp-contract=fast"), True))
    assert lane_differences(cases, "float64", "rk4", simd, LANES, optimise="-O2")
