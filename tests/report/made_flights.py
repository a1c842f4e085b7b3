"""Records of the paper's three experiments on the paper's linear models, with white noise on the outputs."""

import numpy as np

from twodof.identify.record import Record
from twodof.models.plant import PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX
from twodof.report.characterise import Flights

DT = 0.004
Q_NOISE, V_NOISE = 0.02, 0.005


def held(steps: int, *pulses: tuple[int, int, float]) -> np.ndarray:
    signal = np.zeros(steps)
    for start, stop, level in pulses:
        signal[start:stop] = level
    return signal


def record(name: str, inputs: dict[str, np.ndarray], output: str, value: np.ndarray) -> Record:
    time = DT * np.arange(value.size)
    return Record.from_columns(time, {**inputs, output: value}, list(inputs), [output], name)


def flights(repetitions: int = 3, seed: int = 0) -> Flights:
    generator = np.random.default_rng(seed)
    pitch = PAPER_PITCH_RATE.state_space().zero_order_hold(DT)
    cart = PAPER_VELOCITY_GREYBOX.state_space().zero_order_hold(DT)
    impulse = held(5000, (100, 150, 0.02))
    doublet = held(400, (100, 175, 0.03), (175, 250, -0.03))
    theta = held(600, (100, 300, 0.26), (300, 500, -0.26))
    impulses, doublets, velocities = [], [], []
    for index in range(1, repetitions + 1):
        q = pitch.simulate(impulse)[:, 1] + generator.normal(0.0, Q_NOISE, impulse.size)
        impulses.append(record(f"impulse {index}", {"M": impulse}, "q", q))
        q = pitch.simulate(doublet)[:, 1] + generator.normal(0.0, Q_NOISE, doublet.size)
        doublets.append(record(f"doublet {index}", {"M": doublet}, "q", q))
        v = cart.simulate(theta)[:, 1] + generator.normal(0.0, V_NOISE, theta.size)
        velocities.append(record(f"velocity {index}", {"theta0": theta, "theta": theta}, "v", v))
    return Flights(impulses, doublets, velocities)
