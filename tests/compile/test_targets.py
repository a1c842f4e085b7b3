"""The same bits on every target: every operator, random diagrams, every block of the library, the flight core.

See docs/explanation/targets.md.

A test is a group of diagrams in one precision on all targets: the reference, which takes longest, runs once for them.
"""

import itertools
import random
from collections.abc import Callable, Sequence
from functools import partial

import pytest

from tests.blocks.library import samples
from tests.compile.differential import (
    DT,
    EMULATED_STEPS,
    KINDS,
    STEPS,
    Case,
    cheap_cases,
    emitted,
    random_cases,
    reference_run,
)
from tests.compile.every_operator import KINDS as OPERANDS
from tests.compile.every_operator import every_operator
from tests.compile.machine_cases import array_case, machine_case
from tests.compile.semantics import resetting
from tests.compile.typed_signals import TOLD
from tests.compile.whole_library import library_cases, room, strange_inputs
from tests.toolchains import missing, need
from twodof.blocks.elementary.functions import ARGUMENTS
from twodof.blocks.expressions.graph import walk
from twodof.blocks.expressions.numbers import FLOATS, STORED
from twodof.compile.c.operators import OPERATORS, PLAIN, row
from twodof.compile.program.lower import lower
from twodof.flight.core import core
from twodof.sim.closed_loop import closed_loop

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("own_cache")]

ROOMS = {
    "loops": ("continuous", "delays"),
    "memory": ("discrete", "filters", "control", "estimation", "playback"),
    "functions": ("functions", "logic", "sources"),
    "rest": ("math", "nonlinear", "routing", "waveforms"),
}


def flight_core(steps: int) -> list[Case]:
    """Make the flight core with hostile inputs."""
    d = core()
    return [Case(d, [], strange_inputs(d, steps, 1), {})]


def whole_loop(steps: int) -> list[Case]:
    """The rig and what flies it; few steps, as it costs the reference most."""
    d = closed_loop()
    return [Case(d, [], strange_inputs(d, steps, 2), {})]


MACHINES = (9, 12)
"""Seeds of random state machines."""

Group = tuple[Callable[[], list[Case]], str]
"""What makes the diagrams of a group, and the integrator."""


def operators() -> list[Case]:
    """Every operation of the language with all pairs of special values; a compiler takes longest for long functions."""
    rooms = (("real", "bool"), ("float32", "int32", "uint32"), ("float64",), STORED)
    assert {kind for kinds in rooms for kind in kinds} == OPERANDS.keys()
    return [every_operator(kinds, f"operators_{k}") for k, kinds in enumerate(rooms)]


def semantics() -> list[Case]:
    """Parts that act at times, and state machines; test_semantics.py and test_state_machine.py say what they do."""
    machines = [machine_case(random.Random(seed), f"machine{seed}", 60)[0] for seed in MACHINES]
    return [*(make().case for make in TOLD.values()), resetting("float64").case, *machines, array_case(60)]


def mixed(first: int, small: int, steps: int, large: int) -> list[Case]:
    """A few small random diagrams of many steps, and a few large ones of few."""
    return [*cheap_cases(1000 + first, small, steps), *random_cases(range(first, first + large), 50)]


def library_groups(steps: int, more: int) -> dict[str, Group]:
    """Each block of the library with its default arguments, and with others."""
    made: dict[str, Group] = {}
    for name, rooms in ROOMS.items():
        made[f"library-{name}"] = (partial(library_cases, rooms, steps, False), "rk4")
        made[f"library-{name}-more"] = (partial(library_cases, rooms, more, True), "rk4")
    return made


GROUPS: dict[str, Group] = {
    "operators": (operators, "rk4"),
    "random-rk4": (partial(mixed, 0, 2, 200, 2), "rk4"),
    "random-euler": (partial(mixed, 20, 2, 200, 2), "euler"),
    **library_groups(100, 50),
    "semantics": (semantics, "rk4"),
    "flight-core": (partial(flight_core, 100), "rk4"),
    "closed-loop": (partial(whole_loop, 80), "rk4"),
}
LONG_GROUPS: dict[str, Group] = {
    **{f"small-{k}": (partial(cheap_cases, 1000 + 100 * k, 13, STEPS), "rk4") for k in range(8)},
    **library_groups(STEPS, EMULATED_STEPS),
    "large-rk4": (partial(random_cases, range(20), 200), "rk4"),
    "semantics": (semantics, "rk4"),
    "large-euler": (partial(random_cases, range(20, 40), 200), "euler"),
    "flight-core": (partial(flight_core, STEPS), "rk4"),
    "closed-loop": (partial(whole_loop, 2_500), "rk4"),
}
PRECISIONS = ("float64", "float32")


FLYING = {
    "operators": {"float64": ("gcc-O3-native", "wasm"), "float32": ("m7-gcc",)},
    "random": {"float64": ("gcc-O3-native", "wasm"), "float32": ("m7-gcc",)},
    "library": {"float64": ("gcc-O3-native",), "float32": ()},
    "flight": {"float64": ("gcc-O3-native", "wasm"), "float32": ("m7-gcc",)},
    "closed": {"float64": ("gcc-O3-native", "wasm"), "float32": ("m7-gcc",)},
    "semantics": {"float64": ("gcc-O0",), "float32": ("gcc-O0", "wasm", "m7-gcc")},
}
"""By sort of diagram and precision, the targets on which its groups run each day whatever their turn."""
BLOCKS = {"float64": ("gcc-O3-native", "wasm"), "float32": ("m7-gcc",)}
"""The same for every block of the library with its default arguments."""
ONCE = {
    "random-rk4": "float64",
    "random-euler": "float32",
    "library-loops-more": "float64",
    "library-functions-more": "float32",
    "library-rest-more": "float64",
    "library-memory-more": "float32",
}
"""The precision in which a group runs each day; the soak runs all in both."""
SLOTS = [(group, precision) for group in GROUPS for precision in PRECISIONS if ONCE.get(group, precision) == precision]


def kinds_for(group: str, precision: str) -> list[str]:
    """The targets on which a group runs each day: those that fly, and each other one in its turn."""
    sort = group.partition("-")[0]
    always = FLYING[sort][precision]
    if sort == "library" and not group.endswith("more"):
        always = BLOCKS[precision]
    alike = [slot for slot in SLOTS if slot[0].startswith(sort)]
    turn = alike.index((group, precision))
    flying = {name for names in FLYING[sort].values() for name in names}
    if sort == "library":
        flying |= {name for names in BLOCKS.values() for name in names}
    others = [name for name in KINDS if name not in flying]
    dealt = [name for k, name in enumerate(others) if k % len(alike) == turn and sort not in ("closed", "semantics")]
    return [name for name in KINDS if name in dealt or name in always]


def compare(cases: list[Case], precision: str, integrator: str, kinds: Sequence[str] = tuple(KINDS)) -> None:
    """Assert that targets give the reference's bits; in the end skip or fail, saying why, if one could not run."""
    expected = [reference_run(c, precision, integrator, [EMULATED_STEPS]) for c in cases]
    programs = emitted(cases, precision, integrator)
    found, absent = [], []
    for name in kinds:
        kind = KINDS[name]
        if missing(*kind.needs):
            absent.append(name)
            continue
        found += [f"{name}: {line}" for line in kind.differences(cases, expected, programs)[:5]]
    assert not found, "\n".join(found)
    for name in absent:
        need(*KINDS[name].needs)


@pytest.mark.long
@pytest.mark.parametrize(("group", "precision"), [slot for slot in SLOTS if kinds_for(*slot)])
def test_every_target_gives_the_bits_of_the_reference(group: str, precision: str) -> None:
    make, integrator = GROUPS[group]
    compare(make(), precision, integrator, kinds_for(group, precision))


def test_the_groups_hold_what_they_promise() -> None:
    """104 small random diagrams in the long version, and every block of the library in both."""
    small = [make for name, (make, _) in LONG_GROUPS.items() if name.startswith("small")]
    assert sum(make.args[1] for make in small if isinstance(make, partial)) >= 100
    rooms = {room for names in ROOMS.values() for room in names}
    assert rooms == set(samples.ROOMS)
    parts = {part for r in rooms for part in room(r, extra=False).parts}
    assert {f"{name}_0" for name in samples.LIBRARY} <= parts


def test_every_operator_is_compared() -> None:
    """On its own; the plain arithmetic of loop counters is compared in `test_loops.py`."""
    program = lower(every_operator().diagram, DT)
    found = {e for n in program.nodes for e in walk(n.trace.outputs.values()) if e.args}
    rows = {row(e, e.args[0].kind) for e in found if e.op != "call"}
    # The bits of a float are read by the elementary functions alone, which each of its kinds has.
    within = {f"{kind}_{word}" for kind in PRECISIONS for word in ("word_0", "word_1", "from_bits", "from_word")}
    assert OPERATORS.keys() - rows == within | set(PLAIN.values())
    assert {(e.kind, e.data) for e in found if e.op == "call"} >= set(itertools.product(FLOATS, ARGUMENTS))


@pytest.mark.parametrize("sort", ["operators", "random", "library", "flight"])
def test_by_turns_every_target_runs_each_sort_of_diagram(sort: str) -> None:
    found = {kind for slot in SLOTS if slot[0].startswith(sort) for kind in kinds_for(*slot)}
    assert found == {*KINDS}


@pytest.mark.parametrize("target", ["gcc-O3-native", "wasm", "m7-gcc"])
def test_what_flies_runs_every_block_and_the_closed_loop(target: str) -> None:
    run = {group for group, precision in SLOTS if target in kinds_for(group, precision)}
    assert run >= {"closed-loop", *(f"library-{name}" for name in ROOMS)}


@pytest.mark.soak
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("group", LONG_GROUPS)
def test_every_target_gives_the_bits_of_the_reference_for_long(group: str, precision: str) -> None:
    make, integrator = LONG_GROUPS[group]
    compare(make(), precision, integrator)


@pytest.mark.soak
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("chunk", range(100))
def test_thousands_of_diagrams_run_alike(chunk: int, precision: str) -> None:
    cases = random_cases(range(10_000 + 20 * chunk, 10_000 + 20 * (chunk + 1)), 500)
    compare(cases, precision, ("rk4", "euler")[chunk % 2])
