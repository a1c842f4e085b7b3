"""What the flight controller stands on: sensors that are read and motors that are driven, once a control period."""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol


class SensorSample(NamedTuple):
    """The measurements of one tick; body axes forward-right-down.

    `imu_new` and `dist_new` say that the IMU and the range sensor gave a sample in this tick; `dist_age` is the age of
    the range [s]; `charge` goes from 0 (empty) to 1.
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


class Hardware(Protocol):
    """A drone on its rail, real or virtual. `read` and `drive` alternate, once in each control period."""

    @property
    def name(self) -> str:
        """Of the drone, or of the virtual rig's parameter set; at most 16 characters."""

    @property
    def virtual(self) -> bool:
        """Whether it is simulated."""

    @property
    def seed(self) -> int:
        """Of a virtual rig's noise; 0 for a real one."""

    @property
    def rings(self) -> bool:
        """Whether the rings lock the cart: pitch only."""

    @property
    def safety_off(self) -> bool:
        """Whether the safety switch was pressed, so that motors may turn."""

    def read(self) -> SensorSample:
        """The measurements of this tick."""

    def drive(self, fore: float, aft: float) -> None:
        """Commands the rotor pairs, 0 to 1 each, for the period that begins; a virtual rig's time runs to its end."""

    def stop(self) -> None:
        """Both pairs off until `release`, also against later commands. From any thread: the watchdog calls it."""

    def release(self) -> None:
        """Commands count again."""


class VirtualHardware(Hardware, Protocol):
    """A simulated drone: its time runs in `drive`, so it can begin again, and its true state is known."""

    @property
    def truth(self) -> tuple[float, float, float, float]:
        """Pitch [rad], pitch rate [rad/s], position [m] and velocity [m/s] at this tick."""

    def reset(
        self, seed: int | None = None, x: float = 0.0, noise: float | None = None, rings: bool | None = None
    ) -> Mapping[str, Any]:
        """Begins again at rest at `x` [m], what is None as it was.

        Returns the states, by path, in which the flight code is to begin. Raises ParameterError, and changes nothing,
        for a place beyond the rail, a seed or a noise that cannot be.
        """
