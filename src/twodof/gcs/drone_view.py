"""State, messages and latest estimates of one drone, for both faces of the API."""

from __future__ import annotations

from typing import Any

from twodof.gcs.clock import DroneClock
from twodof.gcs.drone_state import BatteryState, DroneState, StateTracker, StatusText, StatusTexts
from twodof.gcs.session import DroneSession
from twodof.link.statistics import LinkStatistics


class DroneView:
    """Latest data from one drone; `telemetry(name)` gives a signal.

    An estimate raises LinkLost if no newer one will come, and Timeout if none has come: `Drone` waits a while for the
    first one, `AsyncDrone` does not.
    """

    telemetry: Any

    def __init__(self, session: DroneSession, watcher: StateTracker, texts: StatusTexts, clock: DroneClock) -> None:
        self.session, self.watcher, self.texts, self.clock = session, watcher, texts, clock

    def __repr__(self) -> str:
        state = self.state
        stands = f"{state.mode}, {'armed' if state.armed else 'disarmed'}"
        return f"<drone {self.session.system} at {self.url}: {'closed' if self.session.closed else stands}>"

    @property
    def ours(self) -> bool:
        """True for a twodof drone, False for a plain PX4."""
        return self.session.ours

    @property
    def state(self) -> DroneState:
        """State of the drone as last heard: mode, armed, failsafe, rig, battery."""
        return self.watcher.state

    @property
    def tick(self) -> int:
        """The drone's time as a number of control periods of 4 ms; in lockstep the next one to be run."""
        return self.clock.tick

    @property
    def messages(self) -> list[StatusText]:
        """The last 1000 lines of text (STATUSTEXT) from the drone."""
        return list(self.texts.lines)

    @property
    def battery(self) -> BatteryState:
        """Voltage [V] and charge, 0 to 1; NaN while unknown."""
        return self.state.battery

    @property
    def statistics(self) -> LinkStatistics:
        """Loss, round trips and rates of the link."""
        return self.session.connection.statistics

    @property
    def url(self) -> str:
        """URL of the link."""
        return self.session.url

    @property
    def theta(self) -> float:
        """The latest estimate of the pitch [rad]."""
        return self._estimate("theta")

    @property
    def q(self) -> float:
        """The latest estimate of the pitch rate [rad/s]."""
        return self._estimate("q")

    @property
    def x(self) -> float:
        """The latest estimate of the position along the rail [m]."""
        return self._estimate("x")

    @property
    def v(self) -> float:
        """The latest estimate of the velocity along the rail [m/s]."""
        return self._estimate("v")

    def _estimate(self, name: str) -> float:
        return float(self.telemetry(f"estimate.{name}").value)
