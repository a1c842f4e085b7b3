"""The same bits on every target: random diagrams, every block of the library, the flight core. Docs: docs/targets.md.

The reference runs once for a group of diagrams and a precision; each target is a test of its own. `make test` keeps a
group's tests in one process (xdist's loadgroup).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
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
from tests.compile.lanes_differential import lane_programs
from tests.compile.whole_library import library_cases, room, strange_inputs
from twodof.compile.lanes import SIMD, best_simd
from twodof.compile.target import Emitted
from twodof.flight.core import core
from twodof.sim.closed_loop import closed_loop

SMALL = 13  # diagrams in each of eight groups
LARGE = 20
ROOMS = {
    "loops": ("continuous", "delays"),
    "memory": ("discrete", "filters", "control", "playback"),
    "functions": ("functions", "logic", "sources"),
    "rest": ("math", "nonlinear", "random", "routing", "waveforms"),
}


def flight_core() -> list[Case]:
    """What flies, fed with whatever may come in."""
    d = core()
    return [Case(d, [], strange_inputs(d, STEPS, 1), {})]


def whole_loop() -> list[Case]:
    """The rig and what flies it; few steps, as it costs the reference most."""
    d = closed_loop()
    return [Case(d, [], strange_inputs(d, 2500, 2), {})]


GROUPS: dict[str, tuple[Callable[[], list[Case]], str]] = {
    **{f"small-{k}": (partial(cheap_cases, 1000 + 100 * k, SMALL, STEPS), "rk4") for k in range(8)},
    "large-rk4": (partial(random_cases, range(LARGE), 200), "rk4"),
    "large-euler": (partial(random_cases, range(20, 20 + LARGE), 200), "euler"),
    **{f"library-{k}": (partial(library_cases, rooms, STEPS, False), "rk4") for k, rooms in ROOMS.items()},
    **{f"library-{k}-more": (partial(library_cases, rooms, EMULATED_STEPS, True), "rk4") for k, rooms in ROOMS.items()},
    "flight-core": (flight_core, "rk4"),
    "closed-loop": (whole_loop, "rk4"),
}


@dataclass(frozen=True)
class InLanes:
    """Instances side by side, all with the case's inputs; that lanes do not mix is tested in test_lanes.py."""

    simd: str
    lanes: int = 5  # no multiple of any vector's length

    def differences(
        self, cases: Sequence[Case], expected: Sequence[Judgement], programs: Sequence[Emitted]
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
Judged = tuple[list[Case], list[Judgement], list[Emitted]]


@lru_cache(maxsize=1)
def judged(group: str, precision: str) -> Judged:
    """The diagrams of a group, what the reference says of them, and their C in one file."""
    make, integrator = GROUPS[group]
    cases = make()
    expected = [reference_run(c, precision, integrator, [EMULATED_STEPS]) for c in cases]
    return cases, expected, emitted(cases, precision, integrator)


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is compiled here is used once: it stays out of the user's cache."""
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path / "cache"))


@pytest.mark.parametrize("kind", ALL)
@pytest.mark.parametrize(
    ("group", "precision"),
    [
        pytest.param(group, precision, marks=pytest.mark.xdist_group(f"{group} {precision}"))
        for group in GROUPS
        for precision in ("float64", "float32")
    ],
)
def test_a_target_gives_the_bits_of_the_reference(group: str, precision: str, kind: str) -> None:
    found = ALL[kind].differences(*judged(group, precision))
    assert not found, "\n".join(found[:20])


def test_the_groups_hold_what_they_promise() -> None:
    """104 random diagrams of 20,000 steps, and every block of the library, each with its default arguments too."""
    assert sum(name.startswith("small") for name in GROUPS) * SMALL >= 100
    rooms = {room for names in ROOMS.values() for room in names}
    assert rooms == set(samples.ROOMS)
    for name in samples.LIBRARY:
        part = f"{name}_0"
        assert any(part in room(r, extra=False).parts for r in rooms), name


@pytest.mark.soak
@pytest.mark.parametrize("kind", ALL)
@pytest.mark.parametrize(
    ("chunk", "precision"),
    [
        pytest.param(chunk, precision, marks=pytest.mark.xdist_group(f"{chunk} {precision}"))
        for chunk in range(100)
        for precision in ("float64", "float32")
    ],
)
def test_thousands_of_diagrams_run_alike(chunk: int, precision: str, kind: str) -> None:
    found = ALL[kind].differences(*_thousands(chunk, precision))
    assert not found, "\n".join(found[:20])


@lru_cache(maxsize=1)
def _thousands(chunk: int, precision: str) -> Judged:
    integrator = ("rk4", "euler")[chunk % 2]
    cases = random_cases(range(10_000 + 20 * chunk, 10_000 + 20 * (chunk + 1)), 500)
    expected = [reference_run(c, precision, integrator) for c in cases]
    return cases, expected, emitted(cases, precision, integrator)
