"""Writes the table of hover spectra in docs/explanation/physics.md: `python -m tools.hover_spectra`.

It needs the seven public logs (TWODOF_FLIGHT_DATA) and takes a minute. The table stands between
`<!-- measured: hover -->` and `<!-- end -->`. The same rig gives the same figures.
"""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from twodof.experiment.flight import flight_log
from twodof.flight.gains import NAMED
from twodof.flightlog.files import read_log
from twodof.flightlog.log import FlightLog
from twodof.flightlog.rotor_speed import rotor_speed
from twodof.rig.parameters import load_rig
from twodof.rig.rig import velocity_gain
from twodof.signals import HOVER, MODES, OFF, PERIOD
from twodof.sim.closed_loop import ClosedLoop
from twodof.sim.drone_estimator import HISTORY, settled

Array = NDArray[np.float64]

PAGE = Path(__file__).resolve().parents[1] / "docs" / "explanation" / "physics.md"
BLOCK = re.compile(r"<!-- measured: hover -->\n.*?<!-- end -->", re.DOTALL)

BANDS = ((1, 2), (2, 4), (4, 8), (8, 15), (15, 30), (30, 60), (60, 125))
"""Bands [Hz] over which a power spectral density is averaged."""

SEEDS = 3
"""Simulated flights of each hold. Three of 20 s give the power of a band from 1 to 2 Hz to about 20 %."""

MEASURED = ("a_x", "a_z", "q", "dist")
"""Channels that hardly depend on the estimator."""

ESTIMATORS = {"joint": "flight code's", "drone": "drone's"}
"""Estimators that the rig flies with: `closed_loop`'s name, and that in the table."""


@dataclass(frozen=True)
class Hold:
    """Level flight in a log: `start` of the rotors and stretches (from, to) [s] between the excitations."""

    name: str
    gains: str
    rings: bool
    start: float
    stretches: tuple[tuple[float, float], ...]


HOLDS = (
    Hold("attitude-steps-10deg-default", "default", True, 125.92, ((126.6, 127.8), (130.6, 131.8), (134.6, 135.9))),
    Hold("attitude-steps-10deg-student", "student", True, 5.09, ((5.8, 7.0), (9.8, 11.0), (13.8, 15.1))),
    Hold("doublet-0.03", "default", True, 216.71, ((217.7, 236.6),)),
    Hold("rate-doublets-30dps-student", "student", True, 343.96, ((344.8, 346.5),)),
    Hold("velocity-doublets-0.25", "student", False, 125.64, ((127.0, 141.7),)),
    Hold("velocity-doublets-0.25", "student", False, 125.64, ((144.5, 151.1),)),  # the rail tilts elsewhere
    Hold("position-sweep-default", "default", False, 107.67, ((109.0, 127.5),)),
    Hold("position-sweep-default", "default", False, 131.97, ((161.0, 175.0),)),
)
"""The seventh log, the free response, has no hover."""


def channels(log: FlightLog) -> dict[str, tuple[Array, Array, float]]:
    """Return the time, the values and the sample period [s] of each compared channel."""
    acc = log["acc"]
    return {
        "a_x": (acc.time, acc.value[:, 0], PERIOD),
        "a_z": (acc.time, acc.value[:, 2], PERIOD),
        **{name: (log[name].time, log[name].value, PERIOD) for name in ("q", "theta", "T")},
        **{name: (log[name].time, log[name].value, 0.01) for name in ("x", "v")},
        "dist": (log["dist"].time, log["dist"].value, 1.0 / 18.35),
    }


def band_powers(log: FlightLog, stretches: Sequence[tuple[float, float]]) -> dict[str, Array]:
    """Return each channel's power spectral density, averaged over each band and the stretches, (bands,) by name.

    Welch's method with windows of 2 s, of 1 s in a stretch below 3 s, each less its linear trend. The samples are the
    channel's own: another grid takes from the highest band what its phase says. No window goes over lost samples: a
    line across 40 ms of the rotors' vibration is a blow, and doubled a_z below 8 Hz. NaN above half a channel's rate.
    """
    found = {}
    for name, (time, values, dt) in channels(log).items():
        powers, lengths = [], []
        for t0, t1 in stretches:
            inside = np.flatnonzero((time >= t0) & (time < t1))
            whole = np.split(inside, 1 + np.flatnonzero(np.round(np.diff(time[inside]) / dt) > 1.0))
            window = round((1.0 if t1 - t0 < 3.0 else 2.0) / dt)
            longest = max(map(len, whole))
            for piece in (one for one in whole if len(one) >= min(window, longest)):
                f, density = welch(values[piece], 1.0 / dt, nperseg=min(window, len(piece)), detrend="linear")
                parts = [density[(f >= low) & (f < high)] for low, high in BANDS]
                bands = zip(parts, BANDS, strict=True)
                powers.append([d.mean() if low < 0.5 / dt else np.nan for d, (low, _) in bands])
                lengths.append(len(piece))
        found[name] = np.average(powers, axis=0, weights=lengths)
    return found


def fly_hold(hold: Hold, log: FlightLog, loop: ClosedLoop, seed: int) -> dict[str, Array]:
    """Return the band powers of the rig in a hold as long as the logged one, on a rail that tilts as much.

    Its rotors turn as fast as the drone's, where the log has a clear line: how full a pack was, no log says. Its gyro
    is off by what makes the drone's estimator err in v as much as the log does.
    """
    pitch = np.concatenate([log["theta"].slice(*stretch).value for stretch in hold.stretches])
    loop.tune(NAMED[hold.gains])
    mass = loop.rig["mass_drone"] + loop.rig["mass_cart"]
    level = np.zeros(HISTORY)
    off = settled(level, level, level, velocity_bias(hold, log))
    push = 0.0 if hold.rings else mass * velocity_gain(loop.rig) * float(np.sin(pitch.mean() - off.theta))
    own = loop.rig["rotor_hz"]
    conditions = {"rings": hold.rings, "rail_force": push, "gyro_bias": -off.states["bias"]}
    loop.configure({**conditions, "noise": 1.0, "seed": seed, "rotor_hz": own})
    flown, later = _flown(hold, loop)
    begin, end = hold.stretches[0][0], hold.stretches[-1][1]
    turns = rotor_speed(log, begin, end)
    if turns is not None:
        volts = flown["voltage"].slice(begin + later, end + later).value.mean()
        full = loop.rig["voltage_full"] - loop.rig["resistance"] * loop.rig["hover_current"]
        loop.configure({"rotor_hz": turns * full / volts})
        flown, later = _flown(hold, loop)
    return band_powers(flown, [(t0 + later, t1 + later) for t0, t1 in hold.stretches])


def velocity_bias(hold: Hold, log: FlightLog) -> float:
    """Return the mean error [m/s] of the logged v over a hold, against the slope of x."""
    errors, lengths = [], []
    for t0, t1 in hold.stretches:
        x = log["x"].slice(t0, t1)
        errors.append(log["v"].slice(t0, t1).value.mean() - np.polyfit(x.time, x.value, 1)[0])
        lengths.append(t1 - t0)
    return float(np.average(errors, weights=lengths))


def _flown(hold: Hold, loop: ClosedLoop) -> tuple[FlightLog, float]:
    """Return a flight of the hold, from rest, and how much later [s] than in the log its rotors start."""
    loop.machine.reset()
    still = 1250  # in which the estimator settles
    steps = still + round((hold.stretches[-1][1] - hold.start) / PERIOD)
    mode = np.full(steps, MODES.index("attitude" if hold.rings else "position"), dtype=np.int32)
    mode[:still] = OFF
    thrust = np.where((mode != OFF) & hold.rings, HOVER, 0.0)
    flown = flight_log(loop.fly(steps, {"mode": mode, "thrust": thrust}), mode, {})
    return flown, float(flown["M"].time[still]) - hold.start


def ratios(rig: str = "lab") -> dict[tuple[str, bool, str], Array]:
    """Return the rig's power over the drone's, (bands,) by channel, whether the cart is locked, and estimator.

    The powers are summed over the logs, each by the length of its holds.
    """
    folder = Path(os.environ["TWODOF_FLIGHT_DATA"])
    found = {}
    for estimator in ESTIMATORS:
        # Without its own search for the gyro's bias: the drone's drifts as fast as that finds it.
        tuning = {"estimator.filter.k_bias": 0.0} if estimator == "drone" else {}
        loop = ClosedLoop(rig=load_rig(rig), position_filter=estimator, tuning=tuning)
        for rings in (True, False):
            real: list[Mapping[str, Array]] = []
            flown: list[Mapping[str, Array]] = []
            lengths = []
            for hold in (one for one in HOLDS if one.rings == rings):
                log = read_log(folder / f"{hold.name}.mat")
                lengths.append(sum(t1 - t0 for t0, t1 in hold.stretches))
                real.append(band_powers(log, hold.stretches))
                each = [fly_hold(hold, log, loop, seed) for seed in range(1, SEEDS + 1)]
                flown.append({name: np.mean([one[name] for one in each], axis=0) for name in real[-1]})
            for name in real[0]:
                drone, own = (
                    np.average([one[name] for one in all_], axis=0, weights=lengths) for all_ in (real, flown)
                )
                found[name, rings, estimator] = own / drone
    return found


def table(found: Mapping[tuple[str, bool, str], Array]) -> str:
    """Return the Markdown table of `ratios`. What no estimator makes has one row; with rings T is constant."""
    lines = [
        "| channel | cart | estimator | " + " | ".join(f"{low}-{high} Hz" for low, high in BANDS) + " |",
        "|---|---|---|" + "---|" * len(BANDS),
    ]
    for (name, rings, estimator), values in sorted(found.items(), key=lambda one: list(found).index(one[0])):
        measured = name in MEASURED
        if (name == "T" and rings) or (measured and estimator != "joint"):
            continue
        cells = ["" if np.isnan(value) else f"{value:.2g}" for value in values]
        by = "" if measured else ESTIMATORS[estimator]
        lines.append(f"| {name} | {'locked' if rings else 'free'} | {by} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    text = table(ratios())
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(BLOCK.sub(lambda _: f"<!-- measured: hover -->\n\n{text}\n\n<!-- end -->", page), encoding="utf-8")
