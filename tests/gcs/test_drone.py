"""Synchronous Drone with a virtual drone over TCP: verbs, recordings, and every end of a script."""

import errno
import os
import secrets
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from math import radians
from pathlib import Path

import numpy as np
import pytest

from tests.gcs.virtual import OnBoard, on_board
from tests.patience import PATIENCE_S
from twodof.errors import ExperimentError, LinkError, LinkLost, LogError, ParameterError, RecordingError, Rejected
from twodof.excitation import Doublet, Impulse
from twodof.flightlog import read_log, recover, write_log
from twodof.gcs import session
from twodof.gcs.drone import Drone
from twodof.gcs.recording import TOGETHER
from twodof.signals import TOPICS

pytestmark = pytest.mark.slow


@pytest.fixture
def there() -> Iterator[OnBoard]:
    """A virtual drone in lockstep, rings locked."""
    with on_board(lockstep=True, conditions={"rings": True}) as made:
        yield made


def test_a_flight_by_its_verbs(there: OnBoard) -> None:
    with Drone.connect(there.url) as drone:
        assert drone.state.rig.virtual
        drone.run(0.5)
        drone.arm()
        drone.level_hold()
        drone.run(2.0)
        assert abs(drone.theta) < 0.05
        drone.set_pitch(radians(10.0))
        drone.wait_until(lambda: drone.telemetry("theta").latest.value > radians(8.0), timeout=2.0)
        drone.set_pitch_rate(0.0)
        drone.run(0.1)
        drone.set_pitch(0.0)
        drone.run(1.0)
        assert drone.state.armed
        assert drone.state.mode == "offboard"
        with pytest.raises(Rejected, match="armed"):
            drone.reset()
        drone.disarm()
        assert not drone.state.armed
        drone.reset(seed=7, rings=True)
        assert (drone.tick, drone.state.rig.seed) == (0, 7)


def test_streamed_setpoints_reach_the_controller_at_their_ticks(there: OnBoard) -> None:
    with Drone.connect(there.url) as drone:
        drone.run(0.5)
        drone.arm()
        start = drone.tick
        drone.set_pitch(0.1)
        drone.run(1.0)
        drone.stop_setpoints()
        drone.run(1.0)
        safety = drone.state.safety
    asked = {step.tick: step.asked for step in there.steps}
    assert asked[start + 1].theta0 == pytest.approx(0.1, rel=1e-6)  # float32 on the wire
    fresh = [tick - start for tick in range(start, start + 250) if asked[tick].setpoint_new]
    assert np.diff(fresh).tolist() == [5] * (len(fresh) - 1)
    assert len(fresh) == 50
    # The failsafe acts .5 s after the last set-point; it is said in words.
    assert (safety.action, safety.reason) == ("level", "setpoint_lost")


def test_parameters_by_both_names_together_and_back(there: OnBoard) -> None:
    with Drone.connect(there.url) as drone:
        assert drone.parameters["RATE_KP"] == 0.0854
        drone.parameters["FC_PARAM_4"] = 0.07
        assert drone.parameters["RATE_KP"] == 0.07
        drone.parameters.update({"RATE_KP": 0.05, "ATT_KP": 6.0})
        assert drone.parameters["ATT_KP"] == 6.0
        with pytest.raises(ParameterError, match="outside"):
            drone.parameters.update({"RATE_KP": 0.06, "ATT_KP": 60.0})
        assert drone.parameters["RATE_KP"] == 0.05
        drone.parameters.undo()
        assert drone.parameters["RATE_KP"] == 0.07
        rows = drone.parameters.all()
        assert rows["ATT_KP"].row.unit == "1/s"
        assert len(rows) > 50


def test_parameters_are_a_mapping(there: OnBoard) -> None:
    with Drone.connect(there.url) as drone:
        assert "ATT_KP" in drone.parameters
        assert drone.parameters.get("ATT_KP") == drone.parameters["ATT_KP"]
        assert "NOPE" not in drone.parameters
        assert 7 not in drone.parameters
        assert drone.parameters.get("NOPE", 1.5) == 1.5
        assert "drone 1" in repr(drone.parameters)


@pytest.mark.long
def test_a_recording_is_the_drones_own_log(there: OnBoard, tmp_path: Path) -> None:
    """Channel for channel: the stamps of the on-board log, its values rounded to float32, no sample missing."""
    file = tmp_path / "flight.mcap"
    with Drone.connect(there.url) as drone:
        drone.reset(seed=3, rings=True)
        there.steps.clear()
        with drone.record(file, provenance={"experiment": "doublet"}) as recording:
            drone.run(0.5)
            drone.arm()
            drone.level_hold()
            drone.run(3.0)
            played = drone.excite(Doublet(0.03, 0.6, settle=0.1), loop="M")
            drone.disarm()
            drone.run(0.5)
        assert played.done
        assert recording.lost == 0
    log, own = read_log(file), there.channels()
    assert log.provenance["lost"] == 0
    assert log.provenance["drone"]["seed"] == 3
    assert log.provenance["drone"]["virtual"]
    # lmnf's messages are 50 a second from its first sample on in both; theta_true and the like are the rig's.
    assert set(own) <= set(log.channels)
    assert {row.mat for row in TOPICS} <= set(log.channels)
    for name, channel in own.items():
        got = log[name].slice(channel.time[0] - 1e-6, channel.time[-1] + 1e-6)
        assert len(got) == len(channel), name
        assert np.abs(got.time - channel.time).max() < 1e-8, name  # whole nanoseconds
        assert np.array_equal(got.value, channel.value.astype(np.float32).astype(np.float64)), name
    for suffix in (".mat", ".parquet"):
        write_log(log, tmp_path / f"flight{suffix}")
        back = read_log(tmp_path / f"flight{suffix}")
        assert all(np.array_equal(back[name].value, log[name].value) for name in log.channels), suffix


def test_a_recording_refuses_existing_files_and_unknown_topics(there: OnBoard, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_text("mine")
    with Drone.connect(there.url) as drone:
        with pytest.raises(LogError, match="already"), drone.record(tmp_path / "a.mcap"):
            pass
        with pytest.raises(LogError, match="no such signal"), drone.record(tmp_path / "b.mcap", ["nothing"]):
            pass
    assert (tmp_path / "a.mcap").read_text() == "mine"


def test_a_full_disk_ends_the_recording_only(there: OnBoard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def record(drone: Drone) -> None:
        with drone.record(tmp_path / "flight.mcap") as recording:
            drone.run(1.0)
            recording.recorder.flush()
            monkeypatch.setattr("twodof.flightlog.append_only_file.os.write", full)
            drone.run(2.0)
            with pytest.raises(RecordingError):
                recording.recorder.flush()
            drone.run(1.0)
            assert recording.failure is not None
            assert drone.tick == 1000

    with Drone.connect(there.url) as drone:
        with pytest.raises(RecordingError, match="No space left"):
            record(drone)
        monkeypatch.undo()
        drone.arm()
    # What was acknowledged of the first second: twelve topics at 250 Hz, all but what waited to be handed on.
    assert recover(tmp_path / "flight.mcap").samples > 12 * (250 - 2 * TOGETHER)


def test_rows_come_at_every_tick(there: OnBoard) -> None:
    with Drone.connect(there.url) as drone:
        with drone.batch(["imu.gyro_y", "estimate.q"]) as rows:
            drone.run(1.0)
        assert rows.lost == 0
        assert rows.ticks.tolist() == list(range(250))
        assert rows.values.shape == (250, 2)
    q = np.array([step.q for step in there.steps], dtype=np.float32)
    assert np.array_equal(rows.values[:, 1], q[:250])


def test_an_impulse_flies_without_thrust(there: OnBoard) -> None:
    with Drone.connect(there.url) as drone:
        drone.run(0.5)
        drone.arm()
        with drone.batch(["command.M", "command.T", "estimate.q"]) as rows:
            played = drone.excite(Impulse(0.1, 0.2, settle=0.5), thrust=0.0)
        assert played.done
        assert played.end_tick - played.start_tick == 175
        flown = (rows.ticks >= played.start_tick) & (rows.ticks < played.start_tick + 50)
        assert np.all(rows.values[flown, 0] == np.float32(0.1))
        assert np.all(rows.values[:, 1] == 0.0)
        assert rows.values[:, 2].max() > 0.5


def test_a_kill_in_lockstep_holds_until_released(there: OnBoard) -> None:
    """In lockstep too, where nothing is seen unless time passes; a reset and leaving release nothing."""
    with Drone.connect(there.url) as drone:
        drone.run(0.5)
        drone.arm()
        drone.set_pitch(0.05)
        drone.run(0.5)
        drone.kill()
        assert (drone.state.armed, drone.state.killed) == (False, True)
        mine = drone.there.session.connection.system
        with pytest.raises(Rejected, match=f"the drone was killed by system {mine}, component 190"):
            drone.set_pitch(0.05)
        drone.reset(rings=True)
        drone.run(0.5)
        with pytest.raises(Rejected, match="killed"):
            drone.arm()
    with Drone.connect(there.url) as drone:
        assert "killed" in str(drone.state)
        with pytest.raises(Rejected, match="killed"):
            drone.arm()
        drone.release()
        assert not drone.state.killed
        drone.arm()


def test_wrong_excitations_columns_and_recordings_raise_at_once(there: OnBoard, tmp_path: Path) -> None:
    with Drone.connect(there.url) as drone:
        with pytest.raises(ExperimentError, match="3 is not an excitation"):
            drone.excite(3)
        with pytest.raises(LinkError, match="nix"):
            drone.batch(["nix"])
        with pytest.raises(LogError, match="MCAP"):
            drone.record(tmp_path / "flight.mat")


def test_two_clients_of_which_one_commands(there: OnBoard) -> None:
    with Drone.connect(there.url, system=250) as first:
        with pytest.raises(Rejected, match="250/190 holds the lease"):
            Drone.connect(there.url, system=251)
        with Drone.connect(there.url, system=251, take_lease=False) as second:
            with pytest.raises(Rejected, match="holds the lease"):
                second.arm(timeout=PATIENCE_S)
            first.run(0.5)
            first.arm()
            second.kill()
            first.run(0.1)
            assert not first.state.armed
        assert not first.state.armed
    with Drone.connect(there.url, system=251):
        pass


def test_a_cart_that_the_rings_lock_is_said_to_be(there: OnBoard) -> None:
    """Every time, in offboard too, where set-points have no answer; what flew before flies on, and `state` says it."""
    with Drone.connect(there.url) as drone:
        drone.run(0.5)
        drone.arm()
        assert "rings locked" in str(drone.state)
        for fly in (drone.set_position, drone.set_velocity, drone.set_position):
            with pytest.raises(Rejected, match=r"it moves the cart, and the rings lock it \(.*reset\(rings=False\)"):
                fly(0.1)
            drone.set_pitch(0.0)
        drone.run(1.0)
        assert (drone.state.mode, drone.state.safety.action) == ("offboard", "none")
        drone.disarm()
        drone.reset(rings=False)
        assert "rings" not in str(drone.state)
        drone.run(0.5)
        drone.arm()
        drone.set_position(0.1)


@pytest.mark.parametrize("same", [False, True], ids=["any draw", "the same draw"])
def test_two_clients_that_choose_no_id_are_two(there: OnBoard, monkeypatch: pytest.MonkeyPatch, same: bool) -> None:
    """The second is refused, and that it was there and goes disarms nothing, even if both draw the same at first."""
    with Drone.connect(there.url) as first:
        first.run(0.5)
        first.arm()
        mine = first.there.session.connection.system
        if same:
            monkeypatch.setattr(session, "OWN_SYSTEMS", (mine, mine + 1))
            monkeypatch.setattr(secrets, "choice", lambda rows: rows[0])
        with pytest.raises(Rejected, match=f"{mine}/190 holds the lease"):
            Drone.connect(there.url, timeout=PATIENCE_S)
        with Drone.connect(there.url, take_lease=False) as other:
            assert other.there.session.connection.system != mine
            with pytest.raises(Rejected, match="holds the lease"):
                other.set_mode("hold", timeout=PATIENCE_S)
        first.run(0.2)
        assert first.state.armed
        assert there.drone.commander.lease.holder == (mine, 190)


def test_leaving_disarms_whatever_ends_it(there: OnBoard) -> None:
    def leave(error: type[BaseException]) -> None:
        with Drone.connect(there.url) as drone:
            drone.run(0.5)
            drone.arm()
            raise error

    for error in (KeyboardInterrupt, ZeroDivisionError):
        with pytest.raises(error):
            leave(error)
        assert not there.drone.commander.armed
        assert there.drone.commander.lease.holder is None
    before = set(threading.enumerate())
    with Drone.connect(there.url) as drone:
        (thread,) = [one for one in threading.enumerate() if one not in before and one.name.startswith("drone ")]
    assert not thread.is_alive()
    with pytest.raises(LinkLost, match="closed"):
        drone.arm()


def test_a_callback_that_asks_the_drone_is_told_so(there: OnBoard) -> None:
    with Drone.connect(there.url) as drone, pytest.raises(RuntimeError, match="cannot wait"):
        drone.wait_until(lambda: drone.parameters["RATE_KP"] > 0.0, timeout=1.0)


SCRIPT = """
import sys
from twodof.gcs import session
from twodof.gcs.drone import Drone
drone = Drone.connect(sys.argv[1])
drone.run(0.3)
drone.arm()
drone.set_pitch(0.0)
print("flying", flush=True)
if sys.argv[2] == "end":
    sys.exit()
drone.run(60.0)
"""


@pytest.mark.parametrize("how", ["end", "interrupt"])
def test_a_script_that_ends_without_leaving_disarms(how: str) -> None:
    """Without `with`: at its end, and by Ctrl-C, the process ends at once and the drone is disarmed by it."""
    with on_board(conditions={"rings": True}) as there:
        child = subprocess.Popen(
            [sys.executable, "-c", SCRIPT, there.url, how], stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == b"flying\n"
            if how == "interrupt":
                child.send_signal(signal.SIGINT)
            child.communicate(timeout=PATIENCE_S)
        finally:
            child.kill()
            child.wait(timeout=PATIENCE_S)
        assert not there.drone.commander.armed
        assert there.drone.commander.lease.holder is None


def test_a_recording_goes_on_over_a_reset(there: OnBoard, tmp_path: Path) -> None:
    with Drone.connect(there.url) as drone:
        drone.run(0.1)
        with drone.record(tmp_path / "twice.mcap") as recording:
            drone.run(2.0)
            drone.reset(seed=7)
            drone.run(1.0)
    assert recording.lost == 0
    log = read_log(tmp_path / "twice.mcap")
    assert sum(len(log[name]) for name in log) == recording.samples
    # The truth of a tick is known before it is run: of the present one at once, at the end of one that never ran.
    for name, samples in (("q", 750), ("q_true", 751)):
        assert len(log[name]) == samples
        np.testing.assert_allclose(np.diff(log[name].time), 0.004, atol=1e-8)  # stamps are whole nanoseconds


def test_a_drone_that_goes_is_a_lost_link() -> None:
    with on_board(lockstep=True) as there:
        drone = Drone.connect(there.url)
        drone.run(0.1)
    with pytest.raises(LinkLost):
        drone.run(0.1)
    drone.close()
