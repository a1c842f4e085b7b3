"""Files that the loader accepts compile, and run in the sandbox within their fuel with the reference's bits."""

import itertools
import random
import resource
from collections.abc import Iterator

import pytest

from tests.blocks.schema.door import connected
from tests.blocks.schema.hostile import custom, large, loops
from tests.blocks.schema.mutations import mutants, retouched
from tests.compile.differential import DT, Case, differences, emitted, reference_run
from tests.compile.random_diagrams import Maker
from tests.compile.whole_library import strange_inputs
from twodof.blocks import Diagram
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile import build
from twodof.compile.program.lower import lower
from twodof.compile.wasm.target import Wasm
from twodof.errors import DiagramError

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("own_cache")]

BASES = [to_json(Maker(seed).diagram("r")) for seed in (3, 11, 23, 42)]


def survivors(files: int, seed: int) -> Iterator[Diagram]:
    """The diagrams that load and are complete, of mutated files; each under a name of its own."""
    rng = random.Random(seed)
    gentle = (retouched(rng.choice(BASES), rng) for _ in range(files))
    for number, text in enumerate(itertools.chain(mutants(BASES, files, seed), gentle)):
        try:
            d = connected(from_json(text))
            d.name = f"m{seed}_{number}"
            lower(d, DT)
        except DiagramError:
            continue
        yield d


def check(files: int, seed: int, least: int) -> None:
    """Load mutated files; each one that loads runs in one module as on the reference."""
    found = {d.name: d for d in survivors(files, seed)}
    assert len(found) >= least
    cases = [Case(d, [], strange_inputs(d, 30, seed), {}) for d in found.values()]
    expected = [reference_run(c, "float64", "rk4") for c in cases]
    assert not differences(cases, expected, emitted(cases, "float64", "rk4"), Wasm(optimise="-O1"))


@pytest.mark.long
def test_mutated_files_that_load_run_within_their_fuel() -> None:
    check(12, 1, least=3)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(2, 42))
def test_many_mutated_files_that_load_run_within_their_fuel(seed: int) -> None:
    check(600, seed, least=100)


@pytest.mark.long
@pytest.mark.parametrize("name", ["a table of 90,000 numbers", "a state of 900,000 values", "300 outputs of one graph"])
def test_the_largest_that_is_let_in_runs_in_the_sandbox(name: str) -> None:
    d = connected(from_json(large()[name]))
    build(d, DT, target="wasm", optimise="-O1").machine().run(20)


def test_a_constant_index_is_clamped_where_the_array_is_written_out() -> None:
    """Python refuses such an index; a file can have it."""
    clamped = {-(2**31): 1.0, -1: 1.0, 2: 3.0, 3: 3.0, 2**31 - 1: 3.0}
    nodes: list[list[object]] = [["const", [], "real", float(v).hex()] for v in (1.0, 2.0, 3.0)]
    nodes += [["vector", [0, 1, 2]], ["input", [], "u"]]
    outputs = {}
    for index in clamped:
        nodes += [["const", [], "int32", index], ["select", [3, len(nodes)]], ["mul", [len(nodes) + 1, 4]]]
        outputs[f"y{len(outputs)}"] = len(nodes) - 1
    d = from_json(custom(nodes=nodes, outputs=[{"name": name} for name in outputs], output=outputs))
    for machine in (Reference(d, DT).machine(), build(d, DT).machine(), build(d, DT, target="wasm").machine()):
        assert list(machine.step({"u": 1.0}).values()) == list(clamped.values())


def test_a_million_operations_run_within_their_fuel() -> None:
    machine = build(from_json(loops([310, 310])), DT, target="wasm").machine()
    assert machine.step({"u": 1.0})["y"] > 0.0


@pytest.mark.long
def test_many_values_alive_at_once_compile_in_seconds() -> None:
    """Each of 2,500 sums is read twice, the last one first: zig's -O3 takes 18 s of processor time for it."""
    count = 2500
    nodes: list[list[object]] = [["input", [], "u"]]
    sums = []
    for k in range(count):
        nodes += [["const", [], "real", float(k + 1).hex()], ["mul", [0, len(nodes)]]]
        sums.append(len(nodes) - 1)
    total = sums[0]
    for op, several in (("add", sums[1:]), ("sub", sums[::-1])):
        for item in several:
            nodes.append([op, [total, item]])
            total = len(nodes) - 1
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    program = build(from_json(custom(nodes=nodes, output={"y": total})), DT, target="wasm")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 10
    machine = program.machine()
    assert machine.step({"u": 1.0})["y"] == 0.0
    assert machine.step({"u": 3.0})["y"] == 0.0
