"""What is measured, as messages: each tells of the sensor's last sample, at that sample's own time."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite, nan

from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import SensorSample
from twodof.fcu.mavlink.telemetry.flight_messages import MASK_32
from twodof.link.control_period import TICK_MS, TICK_US
from twodof.link.mavlink.packing import Packed, Packer

HIGHRES_IMU, DISTANCE_SENSOR, TOF = 105, 132, 54204
IMU_FIELDS = 0x3F
"""HIGHRES_IMU_UPDATED_FLAGS of accelerometer and gyro; there is neither compass nor barometer."""
RANGE_CM = (2, 120)
"""Least and largest range that DISTANCE_SENSOR announces; the rail's are 10 to 90 cm."""
LONGEST_CM = 0xFFFF
BACKWARD = 4
"""MAV_SENSOR_ROTATION_YAW_180: the range grows as the cart goes forward."""
UNKNOWN_VARIANCE = 0xFF
OLDEST_S = 10.0


class SensorMessages:
    """The last samples, and the messages of them, which are None as long as there is none.

    `news` has, by message id, the tick of the last sample, -1: none.
    """

    def __init__(self) -> None:
        self.news: dict[int, int] = {}
        self._imu: SensorSample | None = None
        self._range: SensorSample | None = None
        self._pack_imu = Packer("HIGHRES_IMU")
        self._pack_range = Packer("DISTANCE_SENSOR")
        self._pack_tof = Packer("TWODOF_TOF")
        self._absent = (nan,) * 7
        self.messages: dict[int, Callable[[], Packed | None]] = {
            HIGHRES_IMU: self._highres_imu,
            DISTANCE_SENSOR: self._distance_sensor,
            TOF: self._tof,
        }
        self.restart()

    def observe(self, step: ControlStep) -> None:
        """Takes the samples of a step over."""
        sample = step.sample
        if sample.imu_new:
            self._imu = sample
            self.news[HIGHRES_IMU] = step.tick
        if sample.dist_new:
            self._range = sample
            self.news[DISTANCE_SENSOR] = self.news[TOF] = step.tick

    def restart(self) -> None:
        """Nothing was measured yet."""
        self._imu = self._range = None
        self.news.update(dict.fromkeys((HIGHRES_IMU, DISTANCE_SENSOR, TOF), -1))

    def _highres_imu(self) -> Packed | None:
        """Accelerometer and gyro; the sensors that do not exist are NaN."""
        if self._imu is None:
            return None
        return self._pack_imu(self.news[HIGHRES_IMU] * TICK_US, *self._imu[:6], *self._absent, IMU_FIELDS, 0)

    def _distance_sensor(self) -> Packed | None:
        """The range in whole centimetres."""
        if self._range is None:
            return None
        dist = self._range.dist
        centimetres = round(min(max(dist * 100.0, 0.0), float(LONGEST_CM))) if isfinite(dist) else LONGEST_CM
        stamp = self._range_us() // (TICK_US // TICK_MS) & MASK_32
        rest = (0, 0, BACKWARD, UNKNOWN_VARIANCE, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0)
        return self._pack_range(stamp, *RANGE_CM, centimetres, *rest)

    def _tof(self) -> Packed | None:
        """The range, not rounded."""
        if self._range is None:
            return None
        dist = self._range.dist
        return self._pack_tof(self._range_us(), self.news[TOF] & MASK_32, dist, int(isfinite(dist)))

    def _range_us(self) -> int:
        """When the range was measured [us]."""
        age = self._range.dist_age if self._range is not None else 0.0
        late = round(age * 1e6) if 0.0 <= age <= OLDEST_S else 0
        return max(0, self.news[TOF] * TICK_US - late)
