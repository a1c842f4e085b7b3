"""The test signals on the ground (twodof.excitation) and on board (twodof.blocks.library) are the same signals."""

import numpy as np
import pytest

from twodof import excitation as ground
from twodof.blocks import Block, Diagram
from twodof.blocks import library as board
from twodof.compile import build

DT = 0.004
STEPS = 2500
LEAD = 0.3

HELD = [
    (ground.Impulse(0.1, 0.2, lead=LEAD), board.Pulse(amplitude=0.1, duration=0.2, start=LEAD)),
    (ground.Doublet(0.03, 0.6, lead=LEAD), board.DoubletSource(amplitude=0.03, period=0.6, start=LEAD)),
    (ground.ThreeTwoOneOne(0.05, 0.3, lead=LEAD), board.ThreeTwoOneOneSource(amplitude=0.05, step=0.3, start=LEAD)),
    *(
        (ground.Prbs(0.07, 0.06, order, seed=3, lead=LEAD), board.PrbsSource(0.06, 0.07, order, seed=3, start=LEAD))
        for order in range(3, 16)
    ),
]
SMOOTH = [
    (ground.Sweep(0.2, 0.1, 5.0, 8.0, law=law, lead=LEAD), board.SweepSource(0.1, 5.0, 8.0, 0.2, law, start=LEAD))
    for law in ("linear", "logarithmic")
]
LINES = {"harmonics": (1, 3, 7, 20), "amplitudes": (0.1, 0.05, 0.02, 0.2), "phases": (0.0, 1.0, 2.0, -3.0)}


def played(block: Block) -> np.ndarray:
    d = Diagram("signal")
    d.add("source", block)
    d.output("y", "source")
    return np.asarray(build(d, DT).machine().run(STEPS)["y"])


@pytest.mark.parametrize(("signal", "block"), HELD, ids=lambda one: type(one).__name__)
def test_held_signals_are_equal_to_the_bit(signal: ground.Excitation, block: Block) -> None:
    on_ground = signal.at(np.arange(STEPS) * DT)
    inside = np.arange(STEPS) * DT < LEAD + signal.pattern - DT / 2
    assert np.array_equal(played(block)[inside], on_ground[inside])


@pytest.mark.parametrize(("signal", "block"), SMOOTH, ids=lambda one: type(one).__name__)
def test_sweeps_agree_to_rounding(signal: ground.Excitation, block: Block) -> None:
    on_ground = signal.at(np.arange(STEPS) * DT)
    inside = np.arange(STEPS) * DT < LEAD + signal.pattern - DT / 2
    # The phase reaches 2 pi 5 * 8 / 2 = 126 rad, of which one rounding is 1.4e-14; a dozen of them, times 0.2.
    assert np.abs(played(block) - on_ground)[inside].max() < 4e-14


def test_multisines_agree_to_rounding() -> None:
    signal = ground.Multisine(4.0, *LINES.values(), lead=LEAD, repeat=2)
    on_ground = signal.at(np.arange(STEPS) * DT)
    inside = np.arange(STEPS) * DT < LEAD + 8.0 - DT / 2
    # Phases up to 2 pi 20 * 2 = 251 rad, of which one rounding is 2.8e-14; four lines of together 0.37.
    assert np.abs(played(board.MultisineSource(**LINES, period=4.0, start=LEAD)) - on_ground)[inside].max() < 1e-13
