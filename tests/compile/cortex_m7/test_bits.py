"""The emulated Cortex-M7 at each level of optimisation, and step by step; `test_targets.py` compares all else."""

from __future__ import annotations

import numpy as np
import pytest

from tests.blocks.library.samples import random_inputs
from tests.compile.differential import same
from tests.toolchains import need
from twodof.compile import build
from twodof.compile.cortex_m7.processor import CortexM7
from twodof.flight.core import core
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow

STEPS = 5000


@pytest.mark.parametrize("optimise", ["-O0", "-Os", *(pytest.param(o, marks=pytest.mark.soak) for o in ("-O1", "-O3"))])
def test_the_level_of_optimisation_changes_no_bit(optimise: str) -> None:
    need("qemu-system-arm", "arm-none-eabi-gcc")
    inputs = {
        name: column.astype("float32") if column.dtype.kind == "f" else column
        for name, column in random_inputs(core(), STEPS, 1, False).items()
    }
    machines = [build(core(), PERIOD, "float32", target=t).machine() for t in ("native", CortexM7("gcc", optimise))]
    here, there = (machine.run(STEPS, inputs) for machine in machines)
    assert [name for name in here if not same(here[name], there[name]).all()] == []
    for path in machines[0].program.states:
        assert same(*(np.atleast_1d(np.array(machine.state(path))) for machine in machines)).all(), path
