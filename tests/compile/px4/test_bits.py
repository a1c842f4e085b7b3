"""The C of a module, built with all of PX4's flags, gives the bits of the host."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.compile.differential import Case, random_cases, same
from tests.compile.px4.host import build_controller, replay
from twodof.compile import build
from twodof.compile.px4.build_files import EXACT
from twodof.compile.px4.controller import DT

STEPS = 2_000
LOGGED = 12  # of the signals of a random diagram; more do not fit into a message


def differing(case: Case, folder: Path, flags: Sequence[str] = EXACT) -> list[str]:
    """The signals of `case` in which the module's C and the host's native program are not the same, bit for bit."""
    log = list(dict.fromkeys(case.paths))[:LOGGED]
    columns = case.columns(STEPS)
    program, found = build_controller(case.diagram, log, folder, flags)
    given = replay(program, found, columns)
    expected: dict[str, NDArray[Any]] = (
        build(case.diagram, DT, "float32", log).machine().run(STEPS, {k: _float32(v) for k, v in columns.items()})
    )
    assert set(given) == set(expected)
    return [path for path in expected if not np.all(same(given[path], expected[path]))]


def _float32(column: NDArray[Any]) -> NDArray[Any]:
    with np.errstate(over="ignore"):
        return column.astype(np.float32) if column.dtype.kind == "f" else column


@pytest.mark.parametrize("seed", range(700, 710))
def test_random_diagrams_give_the_same_bits_under_px4s_flags_without_a_warning(seed: int, tmp_path: Path) -> None:
    (case,) = random_cases([seed], STEPS)
    assert differing(case, tmp_path) == []
