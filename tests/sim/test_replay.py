"""The compiled flight code gives the real flights' outputs back; what a log lacks is left out, what is wrong shows."""

import functools
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from twodof.blocks.reference.interpreter import Reference
from twodof.compile import build
from twodof.flight.cascade import cascade
from twodof.flight.gains import DEFAULT, STUDENT, Gains
from twodof.flightlog.files import read_log
from twodof.flightlog.log import Channel, FlightLog
from twodof.signals import ATTITUDE, OFF, POSITION
from twodof.sim.replay import replay

pytestmark = pytest.mark.slow

# log -> gains flown, channels whose loop was active
FLIGHTS = {
    "doublet-0.03": (DEFAULT, {"M", "q0"}),
    "attitude-steps-10deg-default": (DEFAULT, {"M", "q0"}),
    "attitude-steps-10deg-student": (STUDENT, {"M", "q0"}),
    "rate-doublets-30dps-student": (STUDENT, {"M", "q0"}),
    "velocity-doublets-0.25": (STUDENT, {"M", "q0", "theta0", "T"}),
    "position-sweep-default": (DEFAULT, {"M", "q0", "theta0", "T"}),
}


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("name", FLIGHTS)
def test_what_is_compiled_is_what_flew(flight_data: Path, name: str, precision: str) -> None:
    gains, channels = FLIGHTS[name]
    result = replay(read_log(flight_data / f"{name}.mat"), gains, precision)
    assert set(result.nrms) == channels
    # A logged float32 alone is uncertain by 3e-8 of its size. Of float32 5e-6 is asked; with the compensated sum of the
    # integrals it stays with float64.
    assert max(result.nrms.values()) <= 3e-7
    assert min(result.coverage.values()) >= 0.9


@pytest.mark.parametrize(
    ("wrong", "channel", "least"),
    [
        (Gains(STUDENT.rate, 6.2, STUDENT.velocity, 0.7), "q0", 1e-4),
        (Gains((0.0651, 0.3501, 0.000896), STUDENT.attitude, STUDENT.velocity, 0.7), "M", 1e-5),
        (Gains(STUDENT.rate, STUDENT.attitude, (2.19, 1.461), 0.7), "theta0", 1e-5),
        (DEFAULT, "M", 0.1),
    ],
)
def test_a_gain_that_did_not_fly_shows(flight_data: Path, wrong: Gains, channel: str, least: float) -> None:
    log = read_log(flight_data / "velocity-doublets-0.25.mat")
    assert replay(log, wrong).nrms[channel] > least


def test_an_open_loop_flight_has_nothing_to_compare(flight_data: Path) -> None:
    result = replay(read_log(flight_data / "free-response-impulse.mat"))
    assert result.to_json() == {"nrms": {}, "coverage": {}, "windows_s": []}


# Without a plant behind it the loop does not settle: integrals so weak that M stays within its limits.
WEAK = Gains((0.0651, 0.01, 0.000896), 6.1986, (2.19, 0.1), 0.7)


@functools.cache
def made_up(seed: int, mode: int = POSITION, seconds: float = 8.0, interpreted: bool = False) -> FlightLog:
    """A flight of our own cascade on random measurements: off, armed with three samples of reset, reset at the end.

    `interpreted`: by the interpreter in place of the compiled code, which has the same bits and is faster.
    """
    rng = np.random.default_rng(seed)
    n = round(seconds / 0.004)
    slow = np.repeat(np.arange(n), np.resize([2, 3], n))[:n]

    def smooth(size: float) -> NDArray[np.float64]:
        walk = np.cumsum(rng.standard_normal(n))
        return size * (walk - walk.mean()) / np.abs(walk).max()

    # A pitch of 1 rad before arming would wind an integral up that is not held in reset.
    armed = np.arange(n) >= 250
    theta, q = np.where(armed, smooth(0.02), 1.0), smooth(0.1)
    x, v = smooth(0.01)[slow], smooth(0.01)[slow]
    in_reset = (np.arange(n) < 253) | (np.arange(n) >= n - 40)
    program = Reference(cascade(WEAK), 0.004) if interpreted else build(cascade(WEAK), 0.004)
    out = program.machine().run(
        n,
        {"mode": mode, "in_reset": in_reset, "x0": 0.05, "theta0": 0.02, "x": x, "v": v, "theta": theta, "q": q}
        | {"thrust": 0.4},
    )
    t = 50.0 + 0.004 * np.arange(n) + rng.uniform(-1e-4, 1e-4, n)
    changed = np.flatnonzero(np.diff(slow, prepend=-1))
    channels = {name: Channel(t, out[name]) for name in ("M", "q0", "theta0", "v0")}
    channels |= {
        "T": Channel(t, np.where(armed, out["T"], 0.0)),
        "q": Channel(t - 4e-4, q),
        "theta": Channel(t - 3.7e-3, theta),
        "v": Channel(t[changed] - 2.5e-3, v[changed]),
    }
    return FlightLog(channels)


def without(log: FlightLog, name: str, samples: list[int]) -> FlightLog:
    old = log[name]
    cut = Channel(np.delete(old.time, samples), np.delete(old.value, samples))
    return FlightLog(log.channels | {name: cut})


@pytest.mark.long
def test_a_flight_of_our_own_is_given_back_exactly() -> None:
    result = replay(made_up(1, interpreted=True), WEAK)
    # Nothing was rounded to float32: what is left is the order of sums and the tangent that undoes the projection.
    assert max(result.nrms.values()) < 1e-14
    assert min(result.coverage.values()) > 0.98
    within = np.any([(a <= result.time) & (result.time <= b) for a, b in result.windows], axis=0)
    assert np.array_equal(within, np.any([*result.compared.values()], axis=0))


@pytest.mark.parametrize("name", ["M", "q", "q0", "theta", "theta0", "v", "v0", "T"])
def test_a_flight_with_samples_missing_is_given_back_where_it_can_be(name: str) -> None:
    dropped = [430, 900, 901, 902] if name != "v" else [200, 400, 401]
    log = without(made_up(2), name, dropped)
    result = replay(log, WEAK)
    # What the derivative made of the missing error is found from twelve samples of M, whose rounding is 1e-17.
    assert max(result.nrms.values()) < 1e-13
    assert 0.95 < min(result.coverage.values()) < 1.0


@pytest.mark.parametrize("first", [1955, 1960, 1961, 1965, 1990, 1997])
def test_a_missing_sample_may_hide_the_reset_at_the_end(first: int) -> None:
    log = without(made_up(6), "q", [first, first + 1])
    result = replay(log, WEAK)
    assert max(result.nrms.values()) < 1e-13
    assert min(result.coverage.values()) > 0.9


def damaged(log: FlightLog, seed: int) -> FlightLog:
    """The log with bursts of one to twelve samples missing from each channel, at random."""
    rng = np.random.default_rng(seed)
    channels = dict(log.channels)
    for name in ("M", "q0", "theta0", "v0", "T", "q", "theta", "v"):
        starts = rng.integers(0, len(log[name]) - 20, rng.poisson(2))
        drop = [k for start in starts for k in range(start, start + rng.integers(1, rng.choice([2, 12])))]
        old = log[name]
        channels[name] = Channel(np.delete(old.time, drop), np.delete(old.value, drop))
    return FlightLog(channels)


def check_damaged(folder: Path, name: str, seed: int) -> None:
    gains, channels = FLIGHTS[name]
    result = replay(damaged(read_log(folder / f"{name}.mat"), seed), gains)
    assert set(result.nrms) == channels
    assert max(result.nrms.values()) <= 3e-7
    assert min(result.coverage.values()) >= 0.85


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", FLIGHTS)
def test_a_real_flight_with_more_samples_missing(flight_data: Path, name: str, seed: int) -> None:
    check_damaged(flight_data, name, seed)


@pytest.mark.soak
@pytest.mark.parametrize("name", FLIGHTS)
def test_a_real_flight_with_more_samples_missing_many_times(flight_data: Path, name: str) -> None:
    for seed in range(3, 200):
        check_damaged(flight_data, name, seed)


def test_a_log_that_begins_in_flight(flight_data: Path) -> None:
    log = read_log(flight_data / "position-sweep-default.mat").slice(140.0, 155.0)
    result = replay(log, DEFAULT)
    assert max(result.nrms.values()) <= 3e-7
    assert min(result.coverage.values()) >= 0.95


def test_a_sample_that_is_wrong_is_not_hidden() -> None:
    log = made_up(3)
    value = log["q"].value.copy()
    value[1000] += 0.1
    result = replay(FlightLog(log.channels | {"q": Channel(log["q"].time, value)}), WEAK)
    assert result.nrms["M"] > 1e-4


def test_in_attitude_mode_no_outer_loop_is_compared() -> None:
    result = replay(made_up(4, ATTITUDE), WEAK)
    assert set(result.nrms) == {"M", "q0"}
    assert max(result.nrms.values()) < 1e-14


def test_a_log_that_never_armed_has_nothing_to_compare() -> None:
    assert replay(made_up(5, OFF), WEAK).nrms == {}
