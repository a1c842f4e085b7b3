"""Records of the paper's three experiments on the paper's models, with white noise on the outputs."""

import math
from dataclasses import replace

import numpy as np

from twodof.identify.record import Record
from twodof.models.plant import PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX
from twodof.report.characterisation.characterise import ExperimentRecords

DT = 0.004
Q_NOISE, Q_NOISE_IDLE, V_NOISE, X_NOISE = 0.02, 0.002, 0.005, 0.004


def held(steps: int, *pulses: tuple[int, int, float]) -> np.ndarray:
    signal = np.zeros(steps)
    for start, stop, level in pulses:
        signal[start:stop] = level
    return signal


def record(name: str, inputs: dict[str, np.ndarray], outputs: dict[str, np.ndarray]) -> Record:
    time = DT * np.arange(len(next(iter(inputs.values()))))
    return Record.from_columns(time, {**inputs, **outputs}, list(inputs), list(outputs), name)


def travel(rate: np.ndarray) -> dict[str, np.ndarray]:
    """theta, v and x of paper equation (9) with sin(theta), for a held pitch rate; 40 Euler steps each."""
    theta = v = x = 0.0
    out: dict[str, list[float]] = {"theta": [], "v": [], "x": []}
    for q in rate:
        for name, value in (("theta", theta), ("v", v), ("x", x)):
            out[name].append(value)
        for _ in range(40):
            a = -PAPER_VELOCITY_GREYBOX.k_v * math.sin(theta) - PAPER_VELOCITY_GREYBOX.p_v * v
            x, v, theta = x + v * DT / 40, v + a * DT / 40, theta + q * DT / 40
    return {name: np.array(values) for name, values in out.items()}


def flights(repetitions: int = 3, seed: int = 0) -> ExperimentRecords:
    generator = np.random.default_rng(seed)
    pitch = PAPER_PITCH_RATE.state_space().zero_order_hold(DT)
    # Without thrust only one pair of rotors pushes, at the foot of its curve.
    idle = replace(PAPER_PITCH_RATE, mu=130.0).state_space().zero_order_hold(DT)
    impulse = held(5000, (100, 150, 0.05))
    doublet = held(400, (100, 175, 0.03), (175, 250, -0.03))
    rate = held(600, (100, 110, 6.5), (300, 310, -13.0), (500, 510, 6.5))
    theta0 = held(600, (100, 300, 0.26), (300, 500, -0.26))
    motion = travel(rate)
    impulses, doublets, velocities = [], [], []
    for index in range(1, repetitions + 1):
        q = idle.simulate(impulse)[:, 1] + generator.normal(0.0, Q_NOISE_IDLE, impulse.size)
        impulses.append(record(f"impulse {index}", {"M": impulse}, {"q": q}))
        q = pitch.simulate(doublet)[:, 1] + generator.normal(0.0, Q_NOISE, doublet.size)
        doublets.append(record(f"doublet {index}", {"M": doublet}, {"q": q}))
        inputs = {
            "theta0": theta0,
            "theta": motion["theta"],
            "q": rate,
            "M": held(rate.size),
            "T": held(rate.size) + 0.4,
        }
        outputs = {
            "v": motion["v"] + generator.normal(0.0, V_NOISE, rate.size),
            "x": motion["x"] + generator.normal(0.0, X_NOISE, rate.size),
        }
        velocities.append(record(f"velocity {index}", inputs, outputs))
    return ExperimentRecords(impulses, doublets, velocities)
