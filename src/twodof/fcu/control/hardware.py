"""Hardware that is measured and driven, and the inputs of the flight code in a control period."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from twodof.link.mavlink.setpoints import SetPoint
from twodof.signals import ATTITUDE, OFF, OPEN_LOOP, RATE


class SensorSample(NamedTuple):
    """The measurements of one tick; body axes forward-right-down.

    `imu_new` and `dist_new` are True if the IMU and the range sensor gave a sample in this tick. Units: m/s2, rad/s and
    m; `dist_age` is the age of the range [s], `voltage` in V, `charge` from 0 (empty) to 1.
    """

    acc_x: float
    acc_y: float
    acc_z: float
    gyro_x: float
    gyro_y: float
    gyro_z: float
    imu_new: bool
    dist: float
    dist_new: bool
    dist_age: float
    voltage: float
    charge: float


class ControlInput(NamedTuple):
    """Inputs of the flight code that are requested, not measured: mode, set-points in use, flags.

    Names and units as in `flight.declarations.INPUTS`; `mode` is an index into `signals.MODES`.
    """

    mode: int = OFF
    arm: bool = False
    x0: float = 0.0
    v0: float = 0.0
    ax0: float = 0.0
    theta0: float = 0.0
    q0: float = 0.0
    thrust: float = 0.0
    M_open: float = 0.0
    use_trim: bool = False
    in_reset: bool = False
    setpoint_new: bool = False
    link_new: bool = False

    @property
    def flown(self) -> int:
        """Return the loop that flies: OFF for rate and attitude without thrust, when PX4's mixer gives no moment."""
        return OFF if self.mode in (RATE, ATTITUDE) and not self.thrust > 0.0 else self.mode

    @property
    def idle(self) -> bool:
        """Return whether nothing is asked of the motors, by the same rule as the failsafe's `not_idle`."""
        loop = self.flown
        return loop == OFF or (loop == OPEN_LOOP and not self.thrust and not self.M_open)

    def with_number(self, name: str, value: float) -> ControlInput:
        """Return a copy in which the field `name` has this value."""
        return ControlInput._make(value if own == name else old for own, old in zip(self._fields, self, strict=True))

    def with_setpoint(self, setpoint: SetPoint) -> ControlInput:
        """Return a copy with the loop and the numbers of a set-point, without those that are None."""
        loop, *numbers = setpoint
        mode = self.mode if loop is None else loop
        kept = (old if new is None else new for new, old in zip(numbers, self[2:9], strict=True))
        return ControlInput._make((mode, self.arm, *kept, *self[9:]))


class Hardware(Protocol):
    """A drone on its rail, real or virtual. `read` and `drive` alternate, once in each control period."""

    @property
    def name(self) -> str:
        """Return the name of the drone, or of the virtual rig's parameter set; at most 16 characters."""

    @property
    def virtual(self) -> bool:
        """Return whether the drone is simulated."""

    @property
    def seed(self) -> int:
        """Return the seed of a virtual rig's noise; 0 for a real one."""

    @property
    def rings(self) -> bool:
        """Return whether the rings lock the cart: pitch only."""

    @property
    def safety_off(self) -> bool:
        """Return whether the safety switch was pressed, so that motors may turn."""

    def read(self) -> SensorSample:
        """Return the measurements of this tick."""

    def drive(self, fore: float, aft: float) -> None:
        """Command the rotor pairs, 0 to 1 each, for the period that begins; a virtual rig's time runs to its end."""

    def stop(self) -> None:
        """Stop both pairs until `release`, against later commands too. From any thread: the watchdog calls it."""

    def release(self) -> None:
        """Obey commands again."""


class VirtualHardware(Hardware, Protocol):
    """Simulated drone: its time runs in `drive`, so it can restart, and its true state is known."""

    @property
    def truth(self) -> tuple[float, float, float, float]:
        """Return pitch [rad], pitch rate [rad/s], position [m] and velocity [m/s] at this tick."""

    @property
    def noise(self) -> float:
        """Return the scale of the noise."""

    def reset(
        self, seed: int | None = None, x: float = 0.0, noise: float | None = None, rings: bool | None = None
    ) -> Mapping[str, Any]:
        """Restart at rest at `x` [m]; None leaves a value as it was.

        Return the initial states of the flight code, by path. Raises ParameterError, and changes nothing, for a place
        beyond the rail and for an invalid seed or noise.
        """
