"""Drone: AsyncDrone for scripts and notebooks, made of it at import; drone.pyi shows it to editors and to mypy.

Written by tools/sync_stub.py: change the asynchronous classes, not this."""

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from twodof.excitation import Excitation
from twodof.gcs.active_controller import ActiveController
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.drone_state import BatteryState
from twodof.gcs.drone_state import DroneState
from twodof.gcs.drone_state import DroneVersion
from twodof.gcs.drone_state import StatusText
from twodof.gcs.excitation_player import ExcitationPlayback
from twodof.gcs.files import FileEntry
from twodof.gcs.files import LogEntry
from twodof.gcs.full_rate import BatchRows
from twodof.gcs.full_rate import TruthRows
from twodof.gcs.loop_thread import LoopThread
from twodof.gcs.recording import Recording
from twodof.gcs.sync_drone import SyncDrone
from twodof.gcs.sync_face import SyncFace
from twodof.link.statistics import LinkStatistics
from typing import Any

class DroneFiles(SyncFace):
    """Files on board: descriptions, logs, controllers. Calls raise Rejected, LinkLost and Timeout."""

    def list(self, path: str = '/', timeout: float = 10.0) -> list[FileEntry]:
        """What is in the folder `path`."""

    def read(self, path: str, timeout: float = 60.0) -> bytes:
        """What is in the file `path`."""

    def remove(self, path: str, timeout: float = 5.0) -> None:
        """Deletes the file `path`."""

    def write(
        self,
        path: str,
        content: bytes,
        timeout: float = 60.0,
        sent: Callable[[float], None] | None = None,
    ) -> None:
        """Makes `content` the file `path`, whole or not at all. `sent` is told the share that has arrived.

        Who cancels it before the share is 1 leaves what was there.
        """

class DroneLogs(SyncFace):
    """The logs on board."""

    def download(
        self,
        entry: LogEntry,
        path: str | Path,
        timeout: float = 600.0,
        progress: Callable[[int, int], None] | None = None,
        overwrite: bool = False,
    ) -> Path:
        """Bring a log down into `path`, whole or not at all; `progress(bytes, of)` is told on the way.

        Raises LogError for a file that is there, a log that is empty or too large, Timeout when nothing more comes for
        5 s, LinkLost.
        """

    def list(self, timeout: float = 5.0) -> list[LogEntry]:
        """All logs on board, the oldest first. Raises LinkLost, Timeout."""

class Drone(SyncDrone):
    """A drone, real or virtual: `with Drone.connect(url) as drone:`; leaving disarms it and lets others command.

    Times are in seconds, angles in radians. Calls that wait raise LinkLost if the drone falls silent for 3 s, Rejected
    with the drone's reason, Timeout at their deadline.
    """

    logs: DroneLogs
    files: DroneFiles

    def __init__(self, there: AsyncDrone, runner: LoopThread) -> None: ...

    def active_controller(self, timeout: float = 5.0) -> ActiveController:
        """Which parameters are not at their defaults, and which diagrams fly in place of the stock controllers.

        Raises LinkLost, Timeout.
        """

    def arm(self, timeout: float = 5.0) -> None:
        """Arm it, and see that it is. Raises Rejected with what speaks against it."""

    def batch(self, columns: Iterable[str]) -> AbstractContextManager[BatchRows]:
        """Every sample of these columns of signals.TOPICS (`imu.gyro_y`) at the full rate, for `with`.

        Raises LinkError for a column that is none.
        """

    @property
    def battery(self) -> BatteryState:
        """Voltage [V] and charge, 0 to 1; NaN while unknown."""

    def command(self, command: str, *values: float, timeout: float = 5.0) -> Any:
        """Any MAV_CMD by its name ("PREFLIGHT_STORAGE") with up to seven values; returns its COMMAND_ACK."""

    def disarm(self, timeout: float = 5.0) -> None:
        """Disarm it, and see that it is; set-points are sent no more. Needs no lease."""

    def excite(
        self,
        excitation: Excitation,
        loop: str | None = None,
        thrust: float | None = None,
        at: int | None = None,
        wait: bool = True,
        timeout: float = 5.0,
    ) -> ExcitationPlayback:
        """Play an excitation on board, added to what `loop` ("M", "q", "theta", "v", "x") follows.

        `loop` None is that of the excitation's unit; `thrust` 0 to 1, None: as it is; `at` is the tick at which it
        starts, None: at once. With `wait` the drone's time passes until it is over. Raises ExperimentError for a loop
        of another unit, Rejected with the drone's reason.
        """

    def fly_controller(
        self,
        template: str,
        diagram: str | bytes,
        timeout: float = 120.0,
        said: Callable[[str, float], None] | None = None,
    ) -> None:
        """Send a controller, a diagram's JSON, and have it fly in the place of the one of that template, in a sandbox.

        A stock controller's own diagram brings the stock one back. Before anything is sent the drone is asked whether
        it has what the sandbox takes. Raises Rejected where it lacks that, is armed, or finds a fault in the diagram;
        then what flew before flies on. `said` is told what is done and the share done. It can be cancelled until it is
        told `BUILDS`: then the drone has all, and goes on by itself.
        """

    def kill(self, timeout: float = 5.0) -> None:
        """Motors off, now, in any state and without the lease; said again until it is seen.

        It holds the drone disarmed until `release`. Raises Timeout, LinkLost if it is not seen: the drone's own
        failsafe then acts on the lost link.
        """

    def level_hold(self, timeout: float = 5.0) -> None:
        """Let it hold itself level, at the thrust THRUST_BAR; needs no set-points."""

    @property
    def messages(self) -> list[StatusText]:
        """What it said in words, the last 1000 lines."""

    def record(
        self,
        path: str | Path,
        topics: Iterable[str] | None = None,
        provenance: Mapping[str, object] | None = None,
        overwrite: bool = False,
    ) -> AbstractContextManager[Recording]:
        """Record topics (None: all) at the full rate into a new MCAP file, for `with`.

        Raises LogError for a file that is there, unless `overwrite` says that it may be lost: it is kept until the new
        one has begun in its place. A session that repeats takes new names from `flightlog.numbered`.

        The file also holds what flies: tuned parameters and, as attachments, the diagrams of the user's controllers.

        Of a drone that is not ours what it sends is recorded as it comes: `stream` asks for more of it.
        """

    def release(self, timeout: float = 5.0) -> None:
        """Let it be armed again after a kill, by us or by others. Raises Rejected where somebody else has the lease."""

    def reset(
        self,
        seed: int = 1,
        x: float = 0.0,
        noise: float = 1.0,
        rings: bool = False,
        timeout: float = 5.0,
    ) -> None:
        """Start a virtual drone anew: tick 0, at rest at `x` [m], `rings` locked or not, the noise of `seed` scaled.

        Raises Rejected for a real one, while armed, or where the drone says so.
        """

    def run(self, seconds: float) -> None:
        """Let the drone's time pass.

        Raises ParameterError for a time that is negative or infinite, LinkLost, Timeout if its time stands still,
        Rejected if a kill ends a flight.
        """

    def run_until(self, tick: int) -> None:
        """Let the drone's time pass up to a tick, which is the first not run. Raises as `run`."""

    def set_mode(self, mode: str, timeout: float = 5.0) -> None:
        """Change the mode (manual, rate, attitude, position, hold, offboard), and see that it is changed."""

    def set_moment(self, M: float, thrust: float | None = None, timeout: float = 5.0) -> None:
        """Fly a normalised pitch moment (-1 to 1) about the trim, no loop closed; `thrust` 0 to 1, None: as it is."""

    def set_pitch(self, theta: float, thrust: float | None = None, timeout: float = 5.0) -> None:
        """Follow a pitch [rad]; `thrust` 0 to 1, None: the last one given, at first the parameter THRUST_BAR."""

    def set_pitch_rate(self, q: float, thrust: float | None = None, timeout: float = 5.0) -> None:
        """Follow a pitch rate [rad/s]; `thrust` as in `set_pitch`."""

    def set_position(self, x: float, acceleration: float | None = None, timeout: float = 5.0) -> None:
        """Follow a position along the rail [m], with an acceleration [m/s^2] fed forward."""

    def set_velocity(self, v: float, acceleration: float | None = None, timeout: float = 5.0) -> None:
        """Follow a velocity along the rail [m/s], with an acceleration [m/s^2] fed forward."""

    @property
    def state(self) -> DroneState:
        """How it stands, as last heard: mode, armed, failsafe, rig, battery."""

    @property
    def statistics(self) -> LinkStatistics:
        """What the link is worth: loss, round trips, rates."""

    def stop_excitation(self, timeout: float = 5.0) -> None:
        """Stop what plays, and see that it is over; the set-point before it is held. Raises Rejected."""

    def stop_setpoints(self) -> None:
        """Send no more set-points: after .5 s the drone levels itself."""

    def stream(self, name: str, rate: float, timeout: float = 5.0) -> None:
        """Have a message (such as "ACTUATOR_CONTROL_TARGET") sent `rate` times a second; 0: as by default, < 0: not."""

    @property
    def tick(self) -> int:
        """Its control period, 4 ms each; in lockstep the first that has not been run."""

    def truth(self) -> AbstractContextManager[TruthRows]:
        """The true state of a virtual rig at the full rate, for `with`; what is on board never gets it.

        Raises Rejected by a real drone and for a program on board.
        """

    @property
    def url(self) -> str:
        """Where the link leads."""

    def version(self, timeout: float = 5.0) -> DroneVersion:
        """What flies it: autopilot, version of its program, the machine's number.

        Raises Rejected where it does not tell, LinkLost, Timeout.
        """

    def wait_until(self, condition: Callable[[], bool], timeout: float) -> None:
        """Let the drone's time pass until `condition()`, asked each 20 ms of it; Timeout after `timeout` [s] of it.

        Where its time stands still that is after as much of ours, but after 2 s at the soonest and 5 s at the latest.
        `condition` looks at what has come, and asks nothing.
        """

    def withhold_tuning(self, withhold: bool = True, timeout: float = 5.0) -> None:
        """Let nobody else change parameters while we command, or (`withhold` False) let them again, as at first.

        Raises Rejected where somebody else commands, or nobody does.
        """
