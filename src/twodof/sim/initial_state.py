"""Start: where a simulated flight begins, as parameters and states of the rig and states of the flight code."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from twodof.errors import ExperimentError
from twodof.flight.failsafe.state_machine import FLYING
from twodof.rig.rig import BASE_DT, SAMPLE
from twodof.rig.rotors import RING
from twodof.signals import HOVER, PERIOD
from twodof.sim.drone_estimator import HISTORY, settled

SETTLE_STEPS = 25_000
"""Steps at rest after which the estimator's covariances stand: the gyro's bias settles within some tens of seconds."""

FILTERS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "joint": ("estimator.filter", "estimator.filter"),
        "fixed-gain": ("estimator.pitch", "estimator.position"),
        "drone": ("estimator.filter", "estimator.filter"),
        "kalman": ("estimator.pitch", "estimator.position"),
    }
)
"""Paths in the flight code of the blocks that estimate pitch and position, by the position filter's name."""

_COVARIANCE = re.compile(r"\.(P_\w+|\w*variance)$").search
_ARMED = 1000  # more than any count of samples that the flight code waits for after arming


@dataclass(frozen=True)
class InitialState:
    """Where a simulated flight starts: the rig's state, the estimates (None: as the truth) and what flew before.

    `commands` are (M, T) of the control steps before the start, the latest last. The rotors and the delay line are
    filled with them. Without any the rotors stand, or with `hover` they run at T = .4 and no integral is in reset.
    `states` overwrites single states by path, such as "flight.cascade.rate.sum".
    """

    theta: float = 0.0
    q: float = 0.0
    x: float = 0.0
    v: float = 0.0
    estimates: Mapping[str, float] = field(default_factory=dict)
    commands: tuple[tuple[float, float], ...] = ()
    hover: bool = False
    wake: float | None = None
    states: Mapping[str, Any] = field(default_factory=dict)

    @property
    def running(self) -> bool:
        """Return whether the rotors run."""
        return self.hover or (bool(self.commands) and self.commands[-1][1] > 0.0)

    def check(self, pitch_stop: float, rail_stop: float) -> None:
        """Check that the start is within the stops [rad, m]. Raises ExperimentError."""
        for name, bound in (("theta", pitch_stop), ("x", rail_stop)):
            if not abs(getattr(self, name)) <= bound:
                raise ExperimentError(
                    f"{name} = {getattr(self, name):g} is beyond the stop at {bound:g}", "start", "start inside"
                )

    def rig_parameters(self) -> dict[str, float]:
        """Parameters of the rig, to be set before it is reset."""
        wake = self.wake if self.wake is not None else float(self.running)
        return {
            "theta_start": self.theta,
            "q_start": self.q,
            "x_start": self.x,
            "v_start": self.v,
            "wake_start": wake,
        }

    def rig_states(self, delay: float, lag: float) -> dict[str, Any]:
        """Return the states of the rig to set after its reset.

        The delay lines [s] hold the commands of before, and the rotors' lag [s] has run over them.
        """
        states: dict[str, Any] = {"battery.load": float(self.running)}
        commands = self.commands or (((0.0, HOVER),) if self.hover else ())
        if not commands:
            return states
        held = np.repeat(np.asarray(commands, dtype=np.float64), SAMPLE[0], axis=0)
        back = max(1, round(delay / BASE_DT))
        decay = float(np.exp(-BASE_DT / lag)) if lag > 0.0 else 0.0
        for name, sign in (("fore", 1.0), ("aft", -1.0)):
            command = np.clip(held[:, 1] + sign * held[:, 0], 0.0, 1.0)
            speed = command[0]
            for arrived in command[: max(0, len(command) - back)]:
                speed = arrived + decay * (speed - arrived)
            ring = np.full(RING, command[0])
            recent = command[-RING:]
            ring[RING - len(recent) :] = recent  # place 0 is written next, so the latest stands last
            states |= {f"rotors.{name}": float(speed), f"rotors.{name}_ring": ring.tolist()}
        return states

    def flight_states(self, position_filter: str, known: Iterable[str]) -> dict[str, Any]:
        """States of the flight code, to be set once it was reset, of those that it has (`known`)."""
        known = frozenset(known)
        estimate = {"theta": self.theta, "x": self.x, "v": self.v} | dict(self.estimates)
        pitch, position = FILTERS[position_filter]
        states: dict[str, Any] = {
            "previous.theta": estimate["theta"],
            f"{pitch}.theta": estimate["theta"],
            f"{position}.x": estimate["x"],
            f"{position}.v": estimate["v"],
            "estimator.publisher.x": estimate["x"],
            "estimator.publisher.v": estimate["v"],
        }
        states |= {path: True for path in (f"{pitch}.started", f"{position}.started") if path in known}
        if position_filter == "drone":
            ago = PERIOD * np.arange(-HISTORY, 0)
            level = np.full(HISTORY, estimate["theta"])
            own = settled(level, estimate["x"] + estimate["v"] * ago, np.full(HISTORY, estimate["v"]))
            states |= {f"{position}.{name}": value for name, value in own.states.items()}
        if f"{position}.x_filter" in known:
            states[f"{position}.x_filter"] = estimate["x"]
        if self.running:
            states["arming.count"] = _ARMED
        if self.running and "failsafe.machine.state" in known:
            thrust = self.commands[-1][1] if self.commands else HOVER
            states |= {"failsafe.machine.state": FLYING, "failsafe.safe.thrust": thrust}
            # What flew before had sensors and a link: an axis whose first sample is 0 has not stood still.
            alive = ("imu", "axis", "range", "range_stuck", "link")
            states |= dict.fromkeys((f"failsafe.{name}.count" for name in alive), 0)
        return states


def covariances(known: Iterable[str]) -> list[str]:
    """Of the paths of the flight code's states those of the estimator's covariances.

    A flight does not start with a doubtful pitch: they are what they settle to at rest.
    """
    return [path for path in sorted(known) if path.startswith("estimator.") and _COVARIANCE(path)]
