"""The calibration: its unknowns, what it ships, and that it finds it again."""

from pathlib import Path

import numpy as np
import pytest

from twodof.calibrate import FLIGHTS, PRIOR_WEIGHT, UNKNOWNS, calibrate, find_flights, to_rig
from twodof.errors import IdentificationError, LogError
from twodof.parameters import ParameterSet
from twodof.rig.parameters import CALIBRATED, TABLE, lab
from twodof.rig.rig import moment_gain, stiffness, velocity_damping, velocity_gain
from twodof.sim.resimulation import resimulation_loop

pytestmark = pytest.mark.slow


def means() -> dict[str, float]:
    return {u.name: u.mean for u in UNKNOWNS}


def shipped() -> dict[str, float]:
    """The unknowns that the shipped set stands for."""
    rig = lab()
    inertia, mass = rig["inertia"], rig["mass_drone"] + rig["mass_cart"]
    same = ("delay", "lag", "wake_lag", "wake_fade", "tof_age", "imu_below")
    return {name: rig[name] for name in same} | {
        "b": rig["arm"] * rig["pair_thrust"] / inertia,
        "a": rig["curve"],
        "k": rig["offset"] * rig["mass_drone"] * 9.81 / inertia,
        "k_run": stiffness(rig) / inertia,
        "k3": rig["hardening"] / inertia,
        "c_idle": rig["viscous_idle"] / inertia,
        "f_idle": rig["coulomb_idle"] / inertia,
        "c_run": rig["viscous_run"] / inertia,
        "f_run": rig["coulomb_run"] / inertia,
        "k_v": velocity_gain(rig),
        "p_v": velocity_damping(rig),
        "f_v": rig["rail_coulomb"] / mass,
        "trim_start": rig["trim_start"] / inertia,
    }


def test_the_unknowns_are_the_ratios_they_are_called() -> None:
    u = means()
    rig = ParameterSet(to_rig(u), TABLE)
    assert set(to_rig(u)) == set(CALIBRATED)
    assert moment_gain(rig, 0.4) == pytest.approx(2.0 * u["b"] * (1.0 - u["a"] + 0.8 * u["a"]), rel=1e-12)
    assert velocity_gain(rig) == pytest.approx(u["k_v"], rel=1e-12)
    assert velocity_damping(rig) == pytest.approx(u["p_v"], rel=1e-12)
    again = to_rig(shipped())
    for name, value in again.items():
        assert value == pytest.approx(lab()[name], rel=1e-12)


def test_priors_lie_within_bounds() -> None:
    for u in UNKNOWNS:
        assert u.low <= u.mean <= u.high
        assert u.deviation > 0.0


@pytest.mark.long
def test_the_shipped_set_is_a_minimum(flight_data: Path) -> None:
    """No step of a fifth of a prior's deviation in a single unknown makes the misfit smaller by more than 1e-4."""
    logged = find_flights(flight_data)
    loop = resimulation_loop()
    best = shipped()

    def cost(u: dict[str, float]) -> float:
        rig = ParameterSet(lab().snapshot() | to_rig(u), TABLE).snapshot()
        total = sum(PRIOR_WEIGHT**2 * ((u[q.name] - q.mean) / q.deviation) ** 2 for q in UNKNOWNS)
        for flight, data in logged.items():
            simulated = data.simulate(loop, rig)
            for name, weight in FLIGHTS[flight].items():
                y = data.logged[name]
                total += weight**2 * float(np.sum((y - simulated[name]) ** 2) / np.sum((y - y.mean()) ** 2))
        return total

    least = cost(best)
    for q in UNKNOWNS:
        for sign in (-1.0, 1.0):
            moved = best[q.name] + sign * 0.2 * q.deviation
            if q.low <= moved <= q.high:
                assert cost({**best, q.name: moved}) > least * (1.0 - 1e-4), q.name


def test_it_reports_progress_and_can_be_stopped(flight_data: Path) -> None:
    seen: list[tuple[str, float]] = []

    class Enough(Exception):
        pass

    def progress(what: str, share: float) -> None:
        seen.append((what, share))
        if len(seen) > 25:
            raise Enough

    with pytest.raises(Enough):
        calibrate(flight_data, progress=progress, flights=["attitude-steps-10deg-default"])
    shares = [share for _, share in seen]
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] <= shares[-1] < 1.0
    assert seen[0][0] == "all flights"


def test_missing_logs_are_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="free-response-impulse"):
        calibrate(tmp_path)
    with pytest.raises(IdentificationError, match="no flight"):
        calibrate(tmp_path, flights=())


@pytest.mark.soak
def test_it_finds_the_shipped_set_again(flight_data: Path) -> None:
    found = calibrate(flight_data, leave_one_out=True)
    assert found.converged
    for name in CALIBRATED:
        assert found.rig[name] == pytest.approx(lab()[name], rel=2e-3), name
    # Flights of a kind that others show are predicted nearly as well as they are fitted.
    for name, channel, loss in (
        ("attitude-steps-10deg-default", "theta", 0.2),
        ("attitude-steps-10deg-default", "q", 0.3),
        ("attitude-steps-10deg-student", "theta", 0.3),
        ("rate-doublets-30dps-student", "q", 0.3),
        ("velocity-doublets-0.25", "v", 2.0),
        ("velocity-doublets-0.25", "theta", 3.0),
        ("position-sweep-default", "theta", 2.0),
        ("position-sweep-default", "x", 1.5),
        ("position-sweep-default", "v", 2.0),
    ):
        assert found.left_out[name][channel] >= found.fit[name][channel] - loss, (name, channel)
    # What the project asks of flights left out. Before the rotors took stiffness away they were 88 and 14. The free
    # response rests on priors, as no other window has the rotors at rest.
    assert found.left_out["rate-doublets-30dps-student"]["theta"] >= 92.0
    assert found.left_out["free-response-impulse"]["q"] >= 85.0
    # The doublet has a wake that has hardly begun to build up: flights that stay pitched show that moment too.
    assert found.left_out["doublet-0.03"]["q"] >= 70.0
    counted = [
        found.left_out[name][channel]
        for name, weights in FLIGHTS.items()
        for channel in (("theta", "q", "x", "v") if "x" in weights else ("theta", "q"))
        if (name, channel) != ("free-response-impulse", "theta")
    ]
    assert len(counted) == 17
    assert np.mean(counted) >= 86.3  # half a point below what it is, 86.8
    for fits in found.ceiling.values():
        assert 0.0 < fits["q"] < 100.0
