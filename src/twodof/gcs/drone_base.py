"""What is known of a drone over one link: the parts that talk to it, and how it stands."""

from __future__ import annotations

from collections.abc import Callable

from twodof.errors import LinkLost, Rejected
from twodof.gcs.control.excitation_player import ExcitationPlayer
from twodof.gcs.control.parameters import AsyncParameters
from twodof.gcs.control.setpoints import SetpointStream
from twodof.gcs.mavlink.clock import DroneClock
from twodof.gcs.mavlink.commands import CommandSender
from twodof.gcs.mavlink.deadline import Deadline
from twodof.gcs.mavlink.events import DroneRestarted, ProgramPaused
from twodof.gcs.mavlink.files import AsyncFiles
from twodof.gcs.mavlink.lease import LeaseClient
from twodof.gcs.mavlink.log_download import AsyncLogs
from twodof.gcs.mavlink.session import DroneSession
from twodof.gcs.telemetry.drone_state import BatteryState, DroneState, DroneVersion, StateTracker, version_of
from twodof.gcs.telemetry.full_rate import FullRateSubscription
from twodof.gcs.telemetry.recording import Recordings
from twodof.gcs.telemetry.signals import Telemetry
from twodof.gcs.telemetry.status_texts import StatusText, StatusTexts
from twodof.gcs.telemetry.truth import TruthSubscription
from twodof.link.statistics import LinkStatistics

TIMEOUT_S = 5.0
_TICKS_FOR_AN_ANSWER = 250


class DroneBase:
    """The parts that talk to one drone, and what they have heard.

    `commanding`: we are to have the lease. `ours`: the drone is one of ours, not somebody else's PX4.
    """

    def __init__(self, session: DroneSession, commanding: bool) -> None:
        self.session = session
        self.commanding = commanding
        self.ours = False
        self.texts = StatusTexts(session)
        self.watcher = StateTracker(session)
        self.clock = DroneClock(session)
        self.commands = CommandSender(session, self.texts, self._one_tick)
        self.lease = LeaseClient(session, self.commands)
        self.files = AsyncFiles(session, self.texts)
        self.parameters = AsyncParameters(session, self.files, self.texts)
        self.telemetry = Telemetry(session)
        self.setpoints = SetpointStream(session, self.clock)
        self.exciter = ExcitationPlayer(session, self.clock)
        self.batches = FullRateSubscription(session, self.commands)
        self.rig_truth = TruthSubscription(session, self.commands)
        self.recordings = Recordings(session, self.batches, self.rig_truth, self.clock)
        self.logs = AsyncLogs(session)
        session.events.on(DroneRestarted, self._restarted)
        session.events.on(ProgramPaused, self._stood_still)
        self._last_thrust: float | None = None
        self._may_be_armed = False  # by us: asked for, seen or not
        self._closed = False

    def __repr__(self) -> str:
        state = self.state
        stands = f"{state.mode}, {'armed' if state.armed else 'disarmed'}"
        return f"<drone {self.session.system} at {self.session.url}: {'closed' if self._closed else stands}>"

    @property
    def state(self) -> DroneState:
        """How it stands, as last heard: mode, armed, failsafe, rig, battery."""
        return self.watcher.state

    @property
    def tick(self) -> int:
        """Its control period, 4 ms each; in lockstep the first that has not been run."""
        return self.clock.tick

    @property
    def theta(self) -> float:
        """The latest estimate of the pitch [rad]. Raises Timeout if none has come yet, LinkLost."""
        return self._scalar("estimate.theta")

    @property
    def q(self) -> float:
        """The latest estimate of the pitch rate [rad/s]; raises as `theta`."""
        return self._scalar("estimate.q")

    @property
    def x(self) -> float:
        """The latest estimate of the position along the rail [m]; raises as `theta`."""
        return self._scalar("estimate.x")

    @property
    def v(self) -> float:
        """The latest estimate of the velocity along the rail [m/s]; raises as `theta`."""
        return self._scalar("estimate.v")

    def _scalar(self, name: str) -> float:
        value = self.telemetry(name).value
        return value[0] if isinstance(value, tuple) else value

    @property
    def messages(self) -> list[StatusText]:
        """What it said in words, the last 1000 lines."""
        return list(self.texts.lines)

    @property
    def battery(self) -> BatteryState:
        """Voltage [V] and charge, 0 to 1; NaN while unknown."""
        return self.state.battery

    @property
    def statistics(self) -> LinkStatistics:
        """What the link is worth: loss, round trips, rates."""
        return self.session.connection.statistics

    @property
    def url(self) -> str:
        """Where the link leads."""
        return self.session.url

    async def version(self, timeout: float = TIMEOUT_S) -> DroneVersion:
        """What flies it: autopilot, version of its program, the machine's number.

        Raises Rejected where it does not tell, LinkLost, Timeout.
        """
        deadline = self._deadline(timeout, "asking for its version")
        got = await self.commands.request("AUTOPILOT_VERSION", deadline)
        if got is None:
            raise Rejected("it does not tell its version", deadline.where, "look at its state for what it is")
        return version_of(got, self.state.autopilot)

    def _restarted(self, _: DroneRestarted) -> None:
        """Not by a reset of ours: what was agreed is gone, for all but those who only watch."""
        what = f"the drone has restarted, after tick {self.tick}"
        self.texts.note("critical", what)
        if self.commanding:
            self._may_be_armed = False
            self.session.end(LinkLost(what, self.session.url, "connect again"))
        else:
            self.clock.restart()
            # It sends messages of our own kind to those only that have shown it that they know them.
            self.session.send_anyway(self.commands.request_of("TWODOF_RIG"))

    def _stood_still(self, pause: ProgramPaused) -> None:
        """A drone that this program flew has made itself safe in that time: it must not be surprised now."""
        if self.session.lockstep:  # the drone's time stood still too
            return
        what = f"this program stood still for {pause.seconds:.1f} s"
        self.texts.note("warning", what)
        if self.commanding and self.state.armed:
            self.session.end(
                LinkLost(f"{what}, and the drone was without its pilot", self.session.url, "connect again")
            )

    async def _see(self, condition: Callable[[], bool], deadline: Deadline, remedy: str = "") -> None:
        """Wait until the drone's heartbeat says so; in lockstep its time passes tick by tick."""
        last = self.tick + _TICKS_FOR_AN_ANSWER
        with self.session.listen("HEARTBEAT") as heard:
            while not condition():
                if self.clock.granting and self.tick < last:
                    await self._one_tick(deadline)
                elif await heard.next(deadline.end) is None:
                    raise deadline.error(remedy or "it acknowledged, but its heartbeat says otherwise")

    async def _one_tick(self, deadline: Deadline) -> None:
        if self.clock.granting:
            await self.clock.run_until(self.tick + 1, within=deadline)

    def _needs_ours(self, what: str, name: str) -> None:
        """Raise Rejected, at once, where the drone does not know the message `name`, since it is not one of ours."""
        if not self.ours:
            self.session.must_stand()
            missing = f"{what}: it is not one of ours but {self.state.autopilot}, which has no {name}"
            raise Rejected(
                missing, f"drone {self.session.system}", "docs/how-to/connect-clients.md says what works there"
            )

    def _deadline(self, timeout: float, doing: str) -> Deadline:
        return self.session.deadline(timeout, doing)
