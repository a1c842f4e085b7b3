"""The same bits on every target: random diagrams, every block of the library, the flight core.

See docs/explanation/targets.md.

A test is a group of diagrams in one precision on all targets: the reference, which takes longest, runs once for them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.blocks.library import samples
from tests.compile.differential import (
    EMULATED_STEPS,
    KINDS,
    STEPS,
    Case,
    Judgement,
    cheap_cases,
    emitted,
    random_cases,
    reference_run,
    same,
)
from tests.compile.lanes.lanes_differential import lane_programs
from tests.compile.whole_library import library_cases, room, strange_inputs
from tests.toolchains import missing, need
from twodof.compile.lanes.lanes_program import SIMD, best_simd
from twodof.compile.target import EmittedProgram
from twodof.flight.core import core
from twodof.sim.closed_loop import closed_loop

ROOMS = {
    "loops": ("continuous", "delays"),
    "memory": ("discrete", "filters", "control", "playback"),
    "functions": ("functions", "logic", "sources"),
    "rest": ("math", "nonlinear", "random", "routing", "waveforms"),
}


def flight_core(steps: int) -> list[Case]:
    """What flies, fed with any input it may get."""
    d = core()
    return [Case(d, [], strange_inputs(d, steps, 1), {})]


def whole_loop(steps: int) -> list[Case]:
    """The rig and what flies it; few steps, as it costs the reference most."""
    d = closed_loop()
    return [Case(d, [], strange_inputs(d, steps, 2), {})]


@dataclass(frozen=True)
class Extent:
    """How many diagrams a group has, and how many steps they run."""

    small: int
    large: int
    steps: int
    more: int
    loop: int

    def groups(self) -> dict[str, tuple[Callable[[], list[Case]], str]]:
        """What makes the diagrams of a group, and the integrator; by name."""
        made: dict[str, tuple[Callable[[], list[Case]], str]] = {
            f"small-{k}": (partial(cheap_cases, 1000 + 100 * k, self.small, self.steps), "rk4") for k in range(8)
        }
        for k, rooms in ROOMS.items():
            made[f"library-{k}"] = (partial(library_cases, rooms, self.steps, False), "rk4")
            made[f"library-{k}-more"] = (partial(library_cases, rooms, self.more, True), "rk4")
        made["large-rk4"] = (partial(random_cases, range(self.large), 200), "rk4")
        made["large-euler"] = (partial(random_cases, range(20, 20 + self.large), 200), "euler")
        made["flight-core"] = (partial(flight_core, self.steps), "rk4")
        made["closed-loop"] = (partial(whole_loop, self.loop), "rk4")
        return made


EACH_DAY = Extent(small=7, large=10, steps=1_500, more=600, loop=800)
LONG = Extent(small=13, large=20, steps=STEPS, more=EMULATED_STEPS, loop=2_500)
GROUPS, LONG_GROUPS = EACH_DAY.groups(), LONG.groups()
PRECISIONS = ("float64", "float32")


@dataclass(frozen=True)
class InLanes:
    """Instances side by side, all with the case's inputs; that lanes do not mix is tested in test_lanes.py."""

    simd: str
    lanes: int = 5  # no multiple of any vector's length
    needs: tuple[str, ...] = ()

    def differences(
        self, cases: Sequence[Case], expected: Sequence[Judgement], programs: Sequence[EmittedProgram]
    ) -> list[str]:
        """Every signal and state of a lane that differs from the reference."""
        found = []
        made = lane_programs(cases, programs[0].precision, programs[0].flat.integrator, self.lanes, self.simd)
        for case, want, program in zip(cases, expected, made, strict=True):
            machine, steps = program.machine(), len(case.rows)
            results = machine.run(steps, case.columns(steps))
            pairs = [(path, column, results[path]) for path, column in want.signals.items()]
            last = [(f"state {path}", np.atleast_1d(np.array(v)), path) for path, v in want.states[steps].items()]
            for lane in range(self.lanes):
                where = f"{case.diagram.name} lane {lane}"
                wrong = [path for path, a, b in pairs if not same(a, np.ascontiguousarray(b[:, lane])).all()]
                for path, a, state in last:
                    b = np.atleast_1d(machine.state(state)[lane])
                    if not same(a.astype(b.dtype), b).all():
                        wrong.append(path)
                found += [f"{where} {path}: not the bits of the reference" for path in wrong]
        return found


WIDTHS = list(SIMD)[list(SIMD).index(best_simd()) :]
ALL = {**KINDS, **{f"lanes-{simd}": InLanes(simd) for simd in WIDTHS}}
FIRST = ("gcc-O3-native", "wasm", "m7-gcc")
OTHERS = tuple(name for name in ALL if name not in FIRST)


def kinds_for(group: str, precision: str) -> list[str]:
    """The targets on which a group runs each day: the three that fly, and the others by turns."""
    if group in ("flight-core", "closed-loop"):
        return [*ALL]
    sort = group.partition("-")[0]
    alike = [name for name in GROUPS if name.startswith(sort)]
    turn = alike.index(group) + PRECISIONS.index(precision)
    return [*FIRST, *(name for k, name in enumerate(OTHERS) if (k - turn) % min(4, len(alike)) == 0)]


def compare(cases: list[Case], precision: str, integrator: str, kinds: Sequence[str] = tuple(ALL)) -> None:
    """Assert that targets give the reference's bits; in the end skip or fail, saying why, if one could not run."""
    expected = [reference_run(c, precision, integrator, [EMULATED_STEPS]) for c in cases]
    programs = emitted(cases, precision, integrator)
    found, absent = [], []
    for name in kinds:
        kind = ALL[name]
        if missing(*kind.needs):
            absent.append(name)
            continue
        found += [f"{name}: {line}" for line in kind.differences(cases, expected, programs)[:5]]
    assert not found, "\n".join(found)
    for name in absent:
        need(*ALL[name].needs)


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is compiled here is used once: it stays out of the user's cache."""
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path / "cache"))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("group", GROUPS)
def test_every_target_gives_the_bits_of_the_reference(group: str, precision: str) -> None:
    make, integrator = GROUPS[group]
    compare(make(), precision, integrator, kinds_for(group, precision))


def test_the_groups_hold_what_they_promise() -> None:
    """104 random diagrams of 20,000 steps in the long version, and every block of the library in each."""
    assert LONG.small * sum(name.startswith("small") for name in LONG_GROUPS) >= 100
    rooms = {room for names in ROOMS.values() for room in names}
    assert rooms == set(samples.ROOMS)
    for name in samples.LIBRARY:
        part = f"{name}_0"
        assert any(part in room(r, extra=False).parts for r in rooms), name


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("sort", ["small", "library", "large"])
def test_by_turns_every_target_runs_each_sort_of_diagram(sort: str, precision: str) -> None:
    assert {kind for name in GROUPS if name.startswith(sort) for kind in kinds_for(name, precision)} == set(ALL)


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
