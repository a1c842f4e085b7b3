"""An experiment over MAVLink in lockstep is the experiment in the compiled simulator: bit for bit on board, and rounded
to the wire's float32 on the ground. And a flight that goes wrong says so.
"""

import functools
import os
import signal
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.experiment.drones import drone_process, drone_thread
from tests.patience import PATIENCE_S
from twodof.errors import ExperimentError, LinkLost, Rejected, Timeout
from twodof.experiment.experiments import EXPERIMENTS, Experiment, Script, experiment, script
from twodof.experiment.flight import COLUMNS, NAMES, Flight, Laboratory, ReceivedSamples, data_checks, received
from twodof.experiment.fly import fly
from twodof.flight.failsafe.causes_and_actions import ACTIONS, named_causes
from twodof.flightlog.log import FlightLog
from twodof.flightlog.steps import BOOT
from twodof.flightlog.ulog_file import scan_ulog
from twodof.gcs.drone import Drone
from twodof.rig.parameters import load_rig
from twodof.signals import PERIOD
from twodof.sim.virtual_drone import VirtualDrone

pytestmark = pytest.mark.slow

SEED = 5
EACH_KIND = ("doublet", "position-sweep", "attitude-steps")
"""One in open loop about the trim, one with the cart free, one in the rings; the soak flies them all."""

Signals = Mapping[str, NDArray[Any]]
TRUE = ("theta_true", "q_true", "x_true", "v_true")
NOT_ON_BOARD = ("true_theta", "true_q", "true_x", "true_v", "load")
ASKED = ("mode", "arm", "x0", "v0", "theta0", "q0", "thrust", "M_open", "use_trim")


@dataclass(frozen=True)
class Lab:
    """A virtual drone in lockstep, the client that flies it, and the simulator of the same rig and precision."""

    drone: Drone
    laboratory: Laboratory
    folder: Path

    def fly(self, name: str) -> tuple[Flight, Signals]:
        """Flies an experiment; returns it and the on-board log of every step."""
        before = set(self.folder.rglob("*.ulg"))
        flight = fly(name, self.drone, seed=SEED, laboratory=self.laboratory)
        self.drone.logs.list()  # which waits for what is being written
        (path,) = set(self.folder.rglob("*.ulg")) - before
        rows = scan_ulog(path.read_bytes(), name).topic("twodof_step")
        return flight, rows

    def simulate(self, name: str, x_start: float) -> tuple[Script, Signals]:
        """The same in the simulator."""
        plan = script(EXPERIMENTS[name], x_start)
        return plan, self.laboratory.signals(EXPERIMENTS[name], plan, x_start, SEED)


@dataclass
class Both:
    """An experiment as it was flown over MAVLink and as it was simulated."""

    name: str
    flight: Flight
    on_board: Signals
    plan: Script
    simulated: Signals
    laboratory: Laboratory


def make_lab(
    folder: Path, rig: str, precision: str, controllers: Sequence[str] = (), options: Sequence[str] = ()
) -> Iterator[Lab]:
    laboratory = Laboratory(rig, precision=precision, controllers=controllers, failsafe=True)
    with (
        drone_process(folder, rig, "--lockstep", "--precision", precision, *options) as (_, url),
        Drone.connect(url) as drone,
    ):
        drone.parameters["SDLOG_MODE"] = 2  # log from the first tick on
        yield Lab(drone, laboratory, folder)


@functools.cache
def both(lab: Lab, name: str) -> Both:
    flight, on_board = lab.fly(name)
    return Both(name, flight, on_board, *lab.simulate(name, flight.x_start), lab.laboratory)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    yield from make_lab(tmp_path_factory.mktemp("drone"), "lab", "float64")


@pytest.fixture(scope="module", params=EACH_KIND)
def flown(request: pytest.FixtureRequest, lab: Lab) -> Both:
    return both(lab, request.param)


def differing(on_board: Signals, plan: Script, simulated: Signals) -> dict[str, int]:
    """Steps in which a signal or a command does not have the very bits of the simulation; by name."""
    wanted = {name: values for name, values in simulated.items() if name not in NOT_ON_BOARD}
    asked = {**plan.setpoints, "arm": plan.arm}
    wanted |= {f"asked_{name}": asked.get(name, np.zeros(plan.steps)) for name in ASKED}
    count = {}
    for name, values in wanted.items():
        have = np.asarray(on_board[name], dtype=np.float64)[: plan.steps]
        want = np.asarray(values, dtype=np.float64)
        assert have.shape == want.shape, f"{name}: {len(have)} steps on board, {len(want)} simulated"
        different = have.view(np.uint64) != want.view(np.uint64)
        if different.any():
            count[name] = int(different.sum())
    return count


@pytest.mark.long
def test_the_on_board_log_has_the_bits_of_the_simulation(flown: Both) -> None:
    assert flown.flight.good, flown.flight.checks
    np.testing.assert_array_equal(flown.on_board["tick"][: flown.plan.steps], np.arange(flown.plan.steps))
    assert len(flown.simulated) > 25
    assert differing(flown.on_board, flown.plan, flown.simulated) == {}


@pytest.mark.long
def test_the_ground_log_is_the_simulators_rounded_to_the_wires_float32(flown: Both) -> None:
    simulated = flown.laboratory.fly(flown.name, SEED).log
    assert_rounded(flown.flight.log, simulated)


@pytest.mark.long
def test_the_ground_hears_what_the_failsafe_does(flown: Both) -> None:
    told, on_board = flown.flight.log["safety"], flown.on_board
    ticks = np.rint((told.time - BOOT) / PERIOD).astype(int)
    assert np.diff(ticks).max() <= 250  # once a second, and at each change
    np.testing.assert_array_equal(told.field("action"), on_board["action"][ticks])
    np.testing.assert_array_equal(told.field("causes"), on_board["causes"][ticks])
    # Of the causes that made it act the one that decides.
    reasons = told.field("reasons").astype(int)
    assert not np.any(reasons & ~on_board["reason"][ticks].astype(int))


def assert_rounded(ground: FlightLog, simulated: FlightLog) -> None:
    """Every channel, stamps and all: no sample more, none less, each the simulator's in the wire's type.

    That is float32, and float64 for the truth, which comes past what flies. What the failsafe does is told too.
    """
    assert sorted(ground) == sorted([*simulated, "safety"])
    assert set(TRUE) <= set(ground)
    for name in simulated:
        np.testing.assert_array_equal(ground[name].time, simulated[name].time, name)
        wire = simulated[name].value if name in TRUE else simulated[name].value.astype(np.float32).astype(np.float64)
        np.testing.assert_array_equal(ground[name].value, wire, name)


@pytest.mark.long
def test_what_a_flight_is_judged_by_is_the_same(flown: Both) -> None:
    simulated = {check.name: check.passed for check in flown.laboratory.fly(flown.name, SEED).checks}
    judged = {check.name: check.passed for check in flown.flight.checks}
    assert simulated.items() <= judged.items()
    assert set(judged) - set(simulated) == {"flown to its end", "failsafe silent", "samples received"}
    # By the truth, which has all its bits on the ground too, so in the same words.
    for flight in (flown.flight, flown.laboratory.fly(flown.name, SEED)):
        seen = {
            check.name: check.seen
            for check in flight.checks
            if check.name in ("clear of the pitch stop", "clear of the rail stop")
        }
        assert seen == by_truth(flight.log, flown.plan, flight.experiment.rings, flown.laboratory.parameters)


def by_truth(log: FlightLog, plan: Script, rings: bool, rig: Mapping[str, float]) -> dict[str, str]:
    """Return the words for pitch and place, from the true channels."""
    theta, x = (np.abs(log[f"{name}_true"].value[plan.begin : plan.end]).max() for name in ("theta", "x"))
    stops = np.degrees(rig["pitch_stop"]), rig["rail_stop"]
    swing = f"|theta| up to {np.degrees(theta):.1f} deg, true values; stop at {stops[0]:.1f} deg"
    way = f"|x| up to {x:.3f} m, true values; stop at {stops[1]:.3f} m"
    return {"clear of the pitch stop": swing} | ({} if rings else {"clear of the rail stop": way})


@pytest.mark.long
@pytest.mark.parametrize("spoilt", ["place by one ulp", "arming one tick late", "excitation one tick late", "seed"])
def test_a_difference_of_one_ulp_or_one_tick_is_seen(lab: Lab, spoilt: str) -> None:
    """The comparison itself: each of these makes another flight, and it says so."""
    name = "position-sweep"
    flown = both(lab, name)
    plan = flown.plan
    assert differing(flown.on_board, plan, flown.simulated) == {}
    seed, setpoints = SEED, dict(plan.setpoints)
    if spoilt == "place by one ulp":
        x0 = np.asarray(setpoints["x0"], dtype=np.float64).copy()
        x0[plan.begin + 1000] = np.nextafter(x0[plan.begin + 1000], 1.0)
        plan = replace(plan, setpoints=setpoints | {"x0": x0})
    elif spoilt == "arming one tick late":
        plan = replace(plan, armed=plan.armed + 1)
    elif spoilt == "excitation one tick late":
        x0 = np.asarray(setpoints["x0"]).copy()
        x0[plan.begin + 1 : plan.end] = x0[plan.begin : plan.end - 1]
        plan = replace(plan, setpoints=setpoints | {"x0": x0})
    else:
        seed += 1
    other = lab.laboratory.signals(EXPERIMENTS[name], plan, flown.flight.x_start, seed)
    # Not by what was asked for alone: the signals show it.
    assert differing(flown.on_board, plan, other).keys() - {f"asked_{name}" for name in ASKED}


@pytest.mark.soak
@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("rig", ["paper", "lab"])
def test_every_experiment_on_both_rigs_in_both_precisions(tmp_path: Path, rig: str, precision: str) -> None:
    for lab in make_lab(tmp_path, rig, precision):
        for name in EXPERIMENTS:
            found = both(lab, name)
            assert found.flight.good, (name, found.flight.checks)
            assert differing(found.on_board, found.plan, found.simulated) == {}, name
            assert_rounded(found.flight.log, lab.laboratory.fly(name, SEED).log)


@pytest.mark.soak
@pytest.mark.parametrize("starters", [("lqr-attitude",), ("pid-attitude", "pid-position"), ("direct-motor",)])
@pytest.mark.parametrize("trusted", [True, False])
def test_so_do_controllers_of_ones_own(tmp_path: Path, starters: tuple[str, ...], trusted: bool) -> None:
    """In a sandbox too, except the rate set-point that is shown before and after the flight: it is the stock loop's."""
    options = [option for name in starters for option in ("--controller", name)] + (["--trust"] if trusted else [])
    for lab in make_lab(tmp_path, "lab", "float64", starters, options):
        for name in ("velocity-doublet", "attitude-steps"):
            found = both(lab, name)
            assert found.flight.good, (name, found.flight.checks)
            different = differing(found.on_board, found.plan, found.simulated)
            standing = found.plan.steps - int(found.plan.arm.sum())
            assert different == {} or (not trusted and different.keys() == {"q0"} and different["q0"] <= standing)


@pytest.mark.soak
def test_in_real_time_the_same_experiments_give_good_data(tmp_path: Path) -> None:
    with drone_process(tmp_path, "lab") as (_, url), Drone.connect(url) as drone:
        for name in ("attitude-steps", "velocity-doublet"):
            flight = fly(name, drone, seed=SEED)
            assert flight.good, flight.checks
            plan = script(flight.experiment, flight.x_start)
            # The excitation begins at its tick; what is commanded from the ground before is late by the way there.
            played = flight.experiment.excitation.at(np.arange(plan.end - plan.begin) * PERIOD)
            theta0 = flight.log["theta0"].value[plan.begin : plan.end]
            np.testing.assert_array_equal(theta0, played.astype(np.float32))


# A real drone has no reset and no seed, and its rings are set by hand.


def real(drone: VirtualDrone) -> None:
    """From now on it says that it is none of the virtual ones."""
    drone.rig.virtual = False


@pytest.mark.long
def test_a_real_drone_flies_to_its_start_during_the_hold() -> None:
    with drone_thread(real) as url, Drone.connect(url) as drone:
        drone.run(1.0)  # its time began before we came
        flight = fly("velocity-doublets", drone, seed=7)
        assert flight.good, flight.checks
        assert flight.seed == 0
        assert flight.x_start < -0.1
        x = flight.log["x"].value
        begin = script(flight.experiment).begin
        assert abs(x[0]) < 0.01
        assert abs(x[round(0.4 * begin)] - flight.x_start) < 0.05  # x comes at 100 Hz
        assert flight.log.provenance["flown"]["virtual"] is False
        assert (flight.log.provenance["parameters"], flight.log.provenance["controllers"]) == ({}, {})
        # Nobody knows its truth, and nobody asked: it is judged by what it estimates.
        assert not set(TRUE) & set(flight.log)
        assert (
            "m, estimated values; stop" in {check.name: check.seen for check in flight.checks}["clear of the rail stop"]
        )
        with pytest.raises(Rejected), drone.truth():
            pass


def test_a_real_drone_off_its_start_is_not_excited() -> None:
    with drone_thread(real) as url, Drone.connect(url) as drone:
        flight = fly(experiment("velocity-doublets", hold=0.3), drone)
        assert_failed(flight, "the drone does not hold its position: the cart is at")
        assert not np.any(flight.log["v0"].value[-1:])
        assert not drone.state.armed


def test_rings_that_are_set_wrongly_are_found_before_anything_moves() -> None:
    with drone_thread(real) as url, Drone.connect(url) as drone:
        with pytest.raises(ExperimentError, match="needs the cart locked, and it is free"):
            fly("doublet", drone)
        assert drone.tick == 0


# What goes wrong in flight is data: a result with a reason, and the drone is disarmed.


def short(name: str, **changes: object) -> Experiment:
    return experiment(name, hold=1.0, **changes)


def assert_failed(flight: Flight, reason: str) -> None:
    assert reason in flight.reason
    assert not flight.good
    assert not {check.name: check.passed for check in flight.checks}["flown to its end"]


def test_a_drone_that_refuses_to_arm_is_named_with_its_reason() -> None:
    with drone_thread(safety_off=False) as url, Drone.connect(url) as drone:
        flight = fly(short("attitude-steps"), drone)
        assert_failed(flight, "safety switch")
        assert not drone.state.armed
        assert not flight.log["T"].value.any()


def test_a_drone_that_armed_without_being_heard_to_is_disarmed(monkeypatch: pytest.MonkeyPatch) -> None:
    with drone_thread() as url, Drone.connect(url) as drone:
        arm = drone.arm

        def unheard() -> None:
            arm()
            raise Timeout("arming: no answer within 5 s", "drone 1", "")

        monkeypatch.setattr(drone, "arm", unheard)
        assert_failed(fly(short("attitude-steps"), drone), "no answer")
        assert not drone.state.armed


def test_a_flight_in_which_the_failsafe_acted_is_broken_off() -> None:
    """The IMU freezes in the excitation: the failsafe stops the motors, and the flight says why."""

    def freeze(drone: VirtualDrone) -> None:
        seen: list[Any] = []

        def distort(sample: Any) -> Any:
            seen.append(sample)
            late = seen[500] if len(seen) > 500 else sample
            return sample._replace(acc_x=late.acc_x, acc_z=late.acc_z, gyro_y=late.gyro_y)

        drone.rig.distort = distort

    with drone_thread(freeze) as url, Drone.connect(url) as drone:
        flight = fly(short("attitude-steps"), drone)
        assert_failed(flight, "imu_lost")
        assert "the IMU is silent" in flight.reason
        assert not drone.state.armed
        assert len(flight.log["theta"]) < script(flight.experiment).steps
        assert ", longest gap" not in {check.name: check.seen for check in flight.checks}["samples received"]
        # What the failsafe did is in the log, with the deciding cause, and what the drone said, on the log's clock.
        told = flight.log["safety"]
        acted = told.field("action") == ACTIONS.index("off")
        why = {name for mask in told.field("reasons")[acted] for name in named_causes(int(mask))}
        assert why == {"imu_lost"}
        texts = flight.log.provenance["texts"]
        assert any("imu_lost" in text for _, _, text in texts)
        start, end = flight.log.span
        assert all(start - 1.0 < time < end + 5.0 for time, _, _ in texts)


def test_a_start_too_near_the_rails_end_ends_early() -> None:
    with drone_thread() as url, Drone.connect(url) as drone:
        flight = fly(short("velocity-doublets"), drone, x_start=0.29)
        assert not flight.good
        assert flight.reason
        assert not drone.state.armed


@pytest.mark.long
def test_a_link_that_dies_in_the_middle_leaves_what_had_come(tmp_path: Path) -> None:
    flights: list[Flight] = []
    with pytest.raises(RuntimeError, match="status -9"):
        fly_until_killed(tmp_path, flights)
    (flight,) = flights
    assert_failed(flight, "")
    # All came up to where it ended; of what was flown after nobody knows.
    checks = {check.name: check for check in flight.checks}
    assert checks["samples received"].passed
    assert checks["data"].seen == "not judged: the flight was broken off"
    assert "clear of the pitch stop" not in checks
    steps = script(flight.experiment).steps
    assert 0.4 * steps < len(flight.log["theta"]) < 0.9 * steps


def fly_until_killed(folder: Path, flights: list[Flight]) -> None:
    with drone_process(folder, "lab", "--lockstep") as (program, url):
        drone = Drone.connect(url)

        def pull(text: str, share: float) -> None:
            if share > 0.5 and program.process.poll() is None:
                os.kill(program.process.pid, signal.SIGKILL)
                program.process.wait(PATIENCE_S)

        flights.append(fly(short("attitude-steps"), drone, progress=pull))
        with pytest.raises(LinkLost):
            drone.close()


@pytest.mark.long
def test_a_kill_by_somebody_else_ends_the_flight() -> None:
    with drone_thread() as url, Drone.connect(url) as drone, Drone.connect(url, system=251, take_lease=False) as other:
        killed: list[float] = []

        def kill(text: str, share: float) -> None:
            if share > 0.5 and not killed:
                killed.append(share)
                other.kill()

        flight = fly(short("attitude-steps"), drone, progress=kill)
        assert killed
        assert_failed(flight, "killed by system 251")
        thrust = flight.log["T"].value
        assert thrust[len(thrust) // 2] > 0.0
        assert thrust[-1] == 0.0


@pytest.mark.long
def test_ctrl_c_disarms_and_hands_over_what_was_flown() -> None:
    kept: list[Flight] = []

    def interrupt(text: str, share: float) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with drone_thread() as url, Drone.connect(url) as drone:
        with pytest.raises(KeyboardInterrupt):
            fly(short("attitude-steps"), drone, progress=interrupt, interrupted=kept.append)
        assert not drone.state.armed
        assert 0 < drone.tick < script(short("attitude-steps")).steps
    (flight,) = kept
    assert (flight.reason, flight.good) == ("interrupted", False)
    flown = int(np.isfinite(flight.log["theta"].value).sum())
    assert (
        0.45 < flown / script(short("attitude-steps")).steps < 0.65
    )  # it was stopped past the half, in tenths of a second


@pytest.mark.long
def test_lost_samples_are_gaps_and_fail_the_check() -> None:
    plan = script(experiment("attitude-steps"))
    values = np.zeros((plan.steps, len(COLUMNS)))
    values[:, NAMES.index("dist")] = np.nan
    ticks = np.arange(plan.steps)

    def judged(kept: NDArray[np.bool_]) -> tuple[bool, int]:
        samples = ReceivedSamples.of(ticks[kept], values[kept], 0, plan.steps)
        return received(plan, samples.on_grid(0, plan.steps)[1]).passed, len(samples.log({})["theta"])

    def without(start: int, stop: int, every: int = 1) -> NDArray[np.bool_]:
        lost = np.zeros(plan.steps, dtype=bool)
        lost[start:stop:every] = True
        return ~lost

    assert judged(without(0, 0)) == (True, plan.steps)
    assert judged(without(plan.begin, plan.begin + 10)) == (True, plan.steps - 10)  # 40 ms
    assert judged(without(plan.begin, plan.begin + 11)) == (False, plan.steps - 11)
    assert judged(without(0, plan.begin, 100))[0]
    assert not judged(without(0, plan.steps, 50))[0]


@pytest.mark.long
def test_lost_truth_is_judged_by_the_estimates() -> None:
    plan = script(experiment("attitude-steps"))
    values = np.zeros((plan.steps, len(COLUMNS)))
    values[:, NAMES.index("theta")] = 0.2
    ticks, true = np.arange(plan.steps), np.full((plan.steps, 4), 0.1)
    known = (ticks < plan.begin) | (ticks >= plan.begin + 3)
    samples = ReceivedSamples.of(ticks, values, 0, plan.steps, ticks[known], true[known])
    assert len(samples.log({})["theta_true"]) == plan.steps - 3
    out, _ = samples.on_grid(0, plan.steps)
    (pitch,) = (
        check
        for check in data_checks(experiment("attitude-steps"), plan, out, load_rig("lab"))
        if check.name == "clear of the pitch stop"
    )
    flown = plan.end - plan.begin
    assert f"up to {np.degrees(0.2):.1f} deg, true values except in 3 of {flown} steps; stop at" in pitch.seen


@pytest.mark.long
def test_rows_are_sorted_without_copies() -> None:
    values = np.arange(4.0)[:, None] * np.ones(len(COLUMNS))
    samples = ReceivedSamples.of([12, 10, 12, 3], values, first=10, steps=3)
    np.testing.assert_array_equal(samples.ticks, [10, 12])
    out, have = samples.on_grid(10, 3)
    np.testing.assert_array_equal(have, [True, False, True])
    assert out["q"][0] == 1.0
    assert np.isnan(out["q"][1])


@pytest.mark.long
def test_what_cannot_be_flown_is_refused_before_anything_moves() -> None:
    with drone_thread() as url, Drone.connect(url) as drone:
        with pytest.raises(ExperimentError, match=r"still: the motors are off for 0\.1 s only"):
            fly(experiment("doublet", still=0.1), drone)
        with pytest.raises(ExperimentError, match="no experiment called 'doublt'"):
            fly("doublt", drone)
        with pytest.raises(ExperimentError, match=r"x = 5 m is not a valid start.*of the rail's middle"):
            fly("velocity-doublet", drone, x_start=5.0)
        assert drone.tick == 0
        assert not drone.state.armed
