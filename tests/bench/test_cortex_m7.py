"""The hand-written cascades compute what the compiled ones do, and a wrong coefficient would be seen."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.computing import cortex_m7
from bench.computing.cortex_m7 import (
    AGREEMENT,
    ATTITUDE_WORDS,
    CASCADE_WORDS,
    PLAIN,
    UNFUSED,
    compiled,
    difference,
    hand,
)
from tests.toolchains import need
from twodof.blocks import Diagram
from twodof.flight.cascade import cascade
from twodof.flight.starters import starter
from twodof.signals import MODES

pytestmark = pytest.mark.slow

STEPS = 1000


@pytest.fixture(autouse=True)
def tools() -> None:
    need("qemu-system-arm", "arm-none-eabi-gcc")


def peers() -> dict[str, tuple[Diagram, str, Mapping[str, int], dict[str, NDArray[Any]]]]:
    """Diagram, hand-written file, words of its structs and inputs, by what is compared."""
    made: dict[str, tuple[Diagram, str, Mapping[str, int], dict[str, NDArray[Any]]]] = {
        "attitude": (starter("stock-attitude"), "attitude", ATTITUDE_WORDS, cortex_m7.attitude_inputs(STEPS))
    }
    for mode in MODES:
        made[mode + "-mode"] = (cascade(), "cascade", CASCADE_WORDS, cortex_m7.cascade_inputs(STEPS, mode))
    return made


@pytest.mark.parametrize("name", ["attitude", *(m + "-mode" for m in MODES)])
def test_both_compute_the_same(name: str) -> None:
    diagram, file, words, inputs = peers()[name]
    program = compiled(diagram)
    gap, where = difference(program, hand(file, PLAIN, words), inputs)
    assert gap <= AGREEMENT, where
    if name in ("attitude", "rate-mode", "attitude-mode"):  # no libm in these: without contraction bit for bit
        assert difference(program, hand(file, UNFUSED, words), inputs)[0] == 0.0


@pytest.mark.parametrize("path", ["attitude.kp", "rate.kp", "rate.ki", "rate.kd", "rate.N"])
def test_a_coefficient_wrong_in_its_fifth_digit_would_be_seen(path: str) -> None:
    diagram, file, words, inputs = peers()["attitude"]
    program = compiled(diagram)
    u = cortex_m7.rows(program, inputs)
    theirs, _, _ = hand(file, PLAIN, words).run(u, program.dtypes["Y"])
    machine = program.machine()
    machine.set(path, machine.get(path) * (1.0 + 1e-4))
    machine.reset()
    ours = machine.run(STEPS, inputs)["M"]
    assert np.abs(ours - theirs["M"]).max() / np.abs(ours).max() > 2.0 * AGREEMENT


def test_without_tools_the_benchmark_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    (figure,) = cortex_m7.run(quick=True)
    assert "gcc-arm-none-eabi" in figure.remark
