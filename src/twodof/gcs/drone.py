"""Drone: the synchronous face of AsyncDrone, for scripts and notebooks. The work is done by a thread of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from pathlib import Path
from typing import Any, Self

from twodof.errors import TwodofError
from twodof.gcs.async_drone import DEFAULT_URL, LEAVING_S, TIMEOUT_S, AsyncDrone
from twodof.gcs.parameters import AsyncParameters, Entry
from twodof.gcs.runner import Runner
from twodof.gcs.state import State
from twodof.gcs.telemetry import Callback, Sample, Signal, Value
from twodof.gcs.texts import Text
from twodof.link.key import Key


class Parameters(MutableMapping[str, float]):
    """The drone's parameters as a mapping, by its own names or the package's; each access asks the drone."""

    def __init__(self, there: AsyncParameters, runner: Runner) -> None:
        self._there, self._runner = there, runner

    def __getitem__(self, name: str) -> float:
        """Raises ParameterError for one that it has not, LinkLost, Timeout."""
        return self._runner.run(self._there.read(name))

    def __setitem__(self, name: str, value: float) -> None:
        """Raises ParameterError, Rejected, LinkLost, Timeout; then nothing was changed."""
        self._runner.run(self._there.set(name, value))

    def __delitem__(self, name: str) -> None:
        raise TypeError("a drone's parameter cannot be removed")

    def __iter__(self) -> Iterator[str]:
        return iter(self.all())

    def __len__(self) -> int:
        return len(self.all())

    def all(self, timeout: float = 30.0) -> dict[str, Entry]:
        """Every parameter with its type and, where the package knows it, its row: bounds, unit, text."""
        return self._runner.run(self._there.all(timeout))

    def change(self, changes: Mapping[str, float], timeout: float = TIMEOUT_S) -> None:
        """Set several, all or none. Raises ParameterError, Rejected, LinkLost, Timeout."""
        self._runner.run(self._there.update(changes, timeout))

    def update(self, changes: Any = (), /, **more: float) -> None:
        """As `change`; also takes what dict.update takes."""
        self.change({**dict(changes), **more})

    def undo(self) -> None:
        """Back to what was before the last change. Raises Rejected, LinkLost, Timeout."""
        self._runner.run(self._there.undo())


class SyncSignal:
    """One signal of the drone: latest value, next samples, callbacks."""

    def __init__(self, there: Signal, runner: Runner) -> None:
        self._there, self._runner = there, runner
        self.name = there.name
        self.unit = there.row.unit

    def __repr__(self) -> str:
        return repr(self._there)

    @property
    def latest(self) -> Sample | None:
        """The latest sample, None if none has come."""
        return self._there.latest

    @property
    def value(self) -> Value:
        """The latest value; the first one is waited for. Raises LinkLost, Timeout."""
        latest = self._there.latest
        return latest.value if latest is not None else self._runner.run(self._there.next()).value

    def next(self, timeout: float = 2.0) -> Sample:
        """The next sample. Raises LinkLost, Timeout."""
        return self._runner.run(self._there.next(timeout))

    def on(self, callback: Callback) -> Callable[[], None]:
        """Call `callback` with each sample, in the drone's thread, quickly; what is returned ends that."""
        return self._there.on(callback)


class Drone:
    """A drone, real or virtual: `with Drone.connect(url) as drone:`; leaving disarms it and lets others command.

    Times are in seconds, angles in radians. Calls that wait raise LinkLost if the drone falls silent for 3 s, Rejected
    with the drone's reason, Timeout at their deadline.
    """

    def __init__(self, there: AsyncDrone, runner: Runner) -> None:
        self.there = there
        self._runner = runner
        self.parameters = Parameters(there.parameters, runner)

    @classmethod
    def connect(
        cls,
        url: str = DEFAULT_URL,
        timeout: float = 10.0,
        system: int = 250,
        key: Key | str | Path | None = None,
        take_lease: bool = True,
        drone: int | None = None,
    ) -> Self:
        """Find the drone at `url` and, with `take_lease`, become the one who commands it. As AsyncDrone.connect."""
        runner = Runner(url)
        try:
            there = runner.run(AsyncDrone.connect(url, timeout, system, key, take_lease, drone))
        except BaseException:
            runner.close()
            raise
        made = cls(there, runner)
        runner.at_exit(made.close)
        return made

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self.close()
        except TwodofError:
            if kind is None:
                raise

    def close(self, timeout: float = LEAVING_S) -> None:
        """Disarm it if we commanded, give the lease up, close the link. Raises if it cannot be seen to be disarmed."""
        try:
            if self._runner.alive:
                self._runner.run(self.there.close(timeout))
        finally:
            self._runner.close()

    @property
    def state(self) -> State:
        """How it stands, as last heard: mode, armed, failsafe, rig, battery."""
        return self.there.state

    @property
    def tick(self) -> int:
        """Its control period, 4 ms each; in lockstep the first that has not been run."""
        return self.there.tick

    @property
    def messages(self) -> list[Text]:
        """What it said in words, the last 1000 lines."""
        return self.there.messages

    def telemetry(self, name: str) -> SyncSignal:
        """A signal by its name (`estimate.q`) or .mat channel (`q`). Raises LogError if there is none."""
        return SyncSignal(self.there.telemetry(name), self._runner)

    def command(self, command: str, *values: float, timeout: float = TIMEOUT_S) -> Any:
        """Any MAV_CMD by its name, with up to seven values; returns its COMMAND_ACK."""
        return self._runner.run(self.there.command(command, *values, timeout=timeout))

    def arm(self, timeout: float = TIMEOUT_S) -> None:
        """Arm it, and see that it is. Raises Rejected with what speaks against it."""
        self._runner.run(self.there.arm(timeout))

    def disarm(self, timeout: float = TIMEOUT_S) -> None:
        """Disarm it, and see that it is; set-points are sent no more. Needs no lease."""
        self._runner.run(self.there.disarm(timeout))

    def kill(self, timeout: float = TIMEOUT_S) -> None:
        """Motors off, now, whoever has the lease and whatever it does; said again until it is seen."""
        self._runner.run(self.there.kill(timeout))

    def set_mode(self, mode: str, timeout: float = TIMEOUT_S) -> None:
        """Change the mode (manual, rate, attitude, position, hold, offboard), and see that it is changed."""
        self._runner.run(self.there.set_mode(mode, timeout))

    def level_hold(self, timeout: float = TIMEOUT_S) -> None:
        """Let it hold itself level, at the thrust THRUST_BAR; needs no set-points."""
        self._runner.run(self.there.level_hold(timeout))

    def set_moment(self, M: float, thrust: float | None = None) -> None:
        """Fly a normalised pitch moment (-1 to 1) about the trim, no loop closed; `thrust` 0 to 1, None: as it is."""
        self._runner.run(self.there.set_moment(M, thrust))

    def set_pitch(self, theta: float, thrust: float | None = None) -> None:
        """Follow a pitch [rad]; `thrust` 0 to 1, None: as it is."""
        self._runner.run(self.there.set_pitch(theta, thrust))

    def set_pitch_rate(self, q: float, thrust: float | None = None) -> None:
        """Follow a pitch rate [rad/s]; `thrust` 0 to 1, None: as it is."""
        self._runner.run(self.there.set_pitch_rate(q, thrust))

    def set_velocity(self, v: float, acceleration: float | None = None) -> None:
        """Follow a velocity along the rail [m/s], with an acceleration [m/s^2] fed forward."""
        self._runner.run(self.there.set_velocity(v, acceleration))

    def set_position(self, x: float, acceleration: float | None = None) -> None:
        """Follow a position along the rail [m], with an acceleration [m/s^2] fed forward."""
        self._runner.run(self.there.set_position(x, acceleration))

    def stop_setpoints(self) -> None:
        """Send no more set-points: after .5 s the drone levels itself."""
        self._runner.call(self.there.stop_setpoints)

    def run(self, seconds: float) -> None:
        """Let the drone's time pass. Raises LinkLost; Timeout if it stands still."""
        self._runner.run(self.there.run(seconds))

    def run_until(self, tick: int) -> None:
        """Let the drone's time pass up to a tick, which is the first not run. Raises as `run`."""
        self._runner.run(self.there.run_until(tick))

    def wait_until(self, condition: Callable[[], bool], timeout: float) -> None:
        """Let the drone's time pass until `condition()`, asked each 20 ms of it; Timeout after `timeout` [s] of it.

        `condition` is called in the drone's thread: it may look at values that have come, and ask nothing.
        """
        self._runner.run(self.there.wait_until(condition, timeout))
