"""A small log in the drone's layout, as its own sensors and clocks would make it."""

import numpy as np

from twodof.flightlog.log import Channel, FlightLog
from twodof.signals import BY_MAT


def channel(name: str, time: np.ndarray, value: np.ndarray) -> Channel:
    """With the unit and fields of TOPICS."""
    return Channel(time, value, BY_MAT[name].unit, BY_MAT[name].fields, name)


def attitude_steps(seed: int = 1) -> FlightLog:
    """6 s in the attitude loop, thrust on from 1 to 5 s, theta0 to 0.1 at 2 s and back at 3 s."""
    random = np.random.default_rng(seed)
    fast = 100.0 + 0.004 * np.arange(1500) + 1e-5 * random.random(1500)
    slow = 100.0 + 0.010 * np.arange(600)
    since = fast - 100.0
    theta0 = np.where((since >= 2.0) & (since < 3.0), 0.1, -0.0)
    noise = random.standard_normal((1500, 3))
    channels = {
        "acc": channel("acc", fast, noise),
        "gyr": channel("gyr", fast, 0.1 * noise),
        "dist": channel("dist", 100.0 + 0.0545 * np.arange(110), 0.5 + 0.004 * random.standard_normal(110)),
        "q": channel("q", fast + 1e-5, noise[:, 1]),
        "theta": channel("theta", fast + 2e-4, 0.01 * noise[:, 0]),
        "v": channel("v", slow, np.zeros(600)),
        "x": channel("x", slow, np.zeros(600)),
        "thrust0": channel("thrust0", fast, np.where((since >= 1.0) & (since < 5.0), -0.4, -0.0)),
        "lmnf": channel("lmnf", 100.0 + 0.5 * np.arange(3), np.zeros((3, 5))),
        "q0": channel("q0", fast + 1e-5, 11.0 * (theta0 - 0.01 * noise[:, 0])),
        "theta0": channel("theta0", fast + 1e-5, theta0),
        "v0": channel("v0", fast + 1e-5, np.zeros(1500)),
        "x0": channel("x0", fast + 1e-5, np.zeros(1500)),
        "M": channel("M", fast, 0.1 * noise[:, 2]),
        "T": channel("T", fast, np.where((since >= 1.0) & (since < 5.0), 0.4, 0.0)),
    }
    return FlightLog(channels, {"seed": seed, "rig": "synthetic"})


def same_bits(a: FlightLog, b: FlightLog) -> None:
    """Asserts that two logs hold the same channels, to the bit and to the sign of zero."""
    assert list(a) == list(b)
    for name in a:
        assert a[name].time.tobytes() == b[name].time.tobytes(), name
        assert a[name].value.tobytes() == b[name].value.tobytes(), name
        assert (a[name].unit, a[name].fields) == (b[name].unit, b[name].fields), name
