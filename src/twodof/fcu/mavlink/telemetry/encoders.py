"""Telemetry: every message that can be streamed or asked for, as of now."""

import time
from collections.abc import Callable
from math import isfinite, nan
from typing import Any

from twodof.fcu.command.commander import Commander
from twodof.fcu.control.controllers import ControllerIdentity
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import SensorSample
from twodof.fcu.control.loop import FlightController
from twodof.fcu.mavlink.telemetry.flight_messages import STEP_MESSAGES, StepMessage, millivolts, percent
from twodof.fcu.mavlink.wire_tick import MASK_32
from twodof.flight.failsafe.causes_and_actions import BIT, CAUSES
from twodof.link.mavlink.dialect import message_id
from twodof.link.mavlink.messages import Packed, Packer
from twodof.signals import TICK_MS, TICK_US

HEARTBEAT, HIGHRES_IMU, DISTANCE_SENSOR = 0, 105, 132
OPENLOOP, TOF, RIG, LEASE, SAFETY = 54200, 54204, 54206, 54209, 54210
"""Ids of messages."""

QUADROTOR, PX4, VERSION = 2, 12, 3
"""HEARTBEAT: MAV_TYPE_QUADROTOR, MAV_AUTOPILOT_PX4 and MAVLink's version."""

# MAV_SYS_STATUS_SENSOR
GYRO, ACCELEROMETER, RANGE, RATE_CONTROL, ATTITUDE_CONTROL, POSITION_CONTROL = 1, 2, 256, 1024, 2048, 16384
MOTORS, AHRS, BATTERY, PREARM = 32768, 2097152, 33554432, 268435456
PRESENT = (
    GYRO | ACCELEROMETER | RANGE | RATE_CONTROL | ATTITUDE_CONTROL | POSITION_CONTROL | MOTORS | AHRS | BATTERY | PREARM
)
FENCE = 1048576
"""There is none; said to be sound, as MAVProxy takes one that is neither there nor sound for breached."""
UNHEALTHY: tuple[tuple[int, int], ...] = (
    (BIT["imu_lost"], GYRO | ACCELEROMETER),
    (BIT["range_lost"], RANGE),
    (BIT["estimate_lost"], AHRS),
    (BIT["own_failed"] | BIT["command_stuck"] | BIT["command_lost"], RATE_CONTROL | ATTITUDE_CONTROL),
    (BIT["battery_low"] | BIT["battery_critical"], BATTERY),
)
"""Causes of the failsafe, and what SYS_STATUS calls unhealthy while they hold."""

ON_THE_GROUND = BIT["not_idle"] | BIT["tilted"]
"""Causes that keep from arming, and in flight are as they should be."""

IMU_FIELDS = 0x3F
"""HIGHRES_IMU_UPDATED_FLAGS of accelerometer and gyro; there is neither compass nor barometer."""
ABSENT = ("xmag", "ymag", "zmag", "abs_pressure", "diff_pressure", "pressure_alt", "temperature")
RANGE_CM = (2, 120)
"""Least and largest range that DISTANCE_SENSOR announces; the rail's are 10 to 90 cm."""
LONGEST_CM = 0xFFFF
BACKWARD = 4
"""MAV_SENSOR_ROTATION_YAW_180: the range grows as the cart goes forward."""
UNKNOWN_VARIANCE = 0xFF
OLDEST_S = 10.0

RINGS, SAFETY_OFF, VIRTUAL, LOCKSTEP = 1, 2, 4, 8
"""TWODOF_RIG_FLAG."""
SEED_MASK = 0xFFFFFFFFFFFFFFFF
NOBODY = (0, 0)


def hindering(step: ControlStep) -> int:
    """The causes that would keep from arming, or in flight are not as they should be."""
    return step.causes & ~ON_THE_GROUND if step.armed else step.causes


def health(causes: int) -> int:
    """onboard_control_sensors_health for a mask of causes."""
    sound = PRESENT | FENCE
    for bits, sensors in UNHEALTHY:
        if causes & bits:
            sound &= ~sensors
    return sound & ~PREARM if causes else sound


def deciding(reason: int) -> int:
    """Which cause of a mask decides: the place of the one that asks for the strongest action, -1 if there is none."""
    places = [place for place in range(len(CAUSES)) if reason >> place & 1]
    return max(places, key=lambda place: (CAUSES[place].action, -place), default=-1)


class TelemetryEncoders:
    """The latest step, and an encoder for each of `messages`, by message id.

    A sensor's message tells of the last sample, at that sample's own time. `news` has the tick of that sample, -1: none
    yet, so that none is sent twice. `lost` counts messages that clients did not take. `truth` is the virtual rig's
    state, None for a real one: it comes from the rig, past everything on board.
    """

    def __init__(
        self,
        controller: FlightController,
        commander: Commander,
        identity: Callable[[], ControllerIdentity] = ControllerIdentity,
        lost: Callable[[], int] = lambda: 0,
        truth: Callable[[], tuple[float, float, float, float]] | None = None,
    ) -> None:
        self._controller, self._commander = controller, commander
        self._identity, self._lost = identity, lost
        self._encoders: dict[int, Callable[[], Any | None]] = {}
        self.messages = self._encoders.keys()
        self.news: dict[int, int] = {}
        self.restart()
        for row in (*STEP_MESSAGES, *self._judged()):
            self._add_of_step(row)
        self._add("HEARTBEAT", self._heartbeat)
        self._add("SYSTEM_TIME", lambda: (time.time_ns() // 1000, controller.tick * TICK_MS & MASK_32))
        # The middle of the rail. A rig indoors has no place on the globe: latitude and longitude are 0.
        self._add("HOME_POSITION", lambda: (1.0, 0.0, 0.0, 0.0), "q")
        imu = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro")
        self._add("HIGHRES_IMU", self._highres_imu, "time_usec", *imu, *ABSENT, "fields_updated")
        distances = ("min_distance", "max_distance", "current_distance")
        self._add("DISTANCE_SENSOR", self._distance_sensor, "time_boot_ms", *distances, "orientation", "covariance")
        self._add("TWODOF_TOF", self._tof)
        self._pack_rig = Packer("TWODOF_RIG")
        self.add("TWODOF_RIG", self.rig)
        self._add("TWODOF_TIMING", self._timing)
        self._add("TWODOF_LEASE", self._lease, "duration_ms", "holder_system", "holder_component", "tuning_withheld")
        self._add("TWODOF_OPENLOOP", self._openloop, "tick", "M", "T", "openloop", "enableM", "enableT")
        if truth is not None:
            self._add("TWODOF_TRUTH", lambda: (controller.tick * TICK_US, *truth(), controller.tick & MASK_32))

    def add(self, name: str, encode: Callable[[], Any | None]) -> None:
        """Another message that can be streamed and asked for."""
        self._encoders[message_id(name)] = encode

    def message(self, number: int) -> Any | None:
        """A message of `messages` as of now; None if nothing of the kind was measured yet."""
        return self._encoders[number]()

    def restart(self) -> None:
        """Time begins anew: nothing was measured yet."""
        self._step: ControlStep | None = None
        self._imu: SensorSample | None = None
        self._range: SensorSample | None = None
        self._since, self._action = 0, -1
        self.news.update(dict.fromkeys((HIGHRES_IMU, DISTANCE_SENSOR, TOF), -1))

    def observe(self, step: ControlStep) -> None:
        """Takes a step over."""
        self._step, sample = step, step.sample
        if sample.imu_new:
            self._imu = sample
            self.news[HIGHRES_IMU] = step.tick
        if sample.dist_new:
            self._range = sample
            self.news[DISTANCE_SENSOR] = self.news[TOF] = step.tick
        if step.action != self._action:
            self._action, self._since = step.action, step.tick

    def rig(self, on_top: int = 0) -> Packed:
        """TWODOF_RIG, with flags that come on top."""
        controller, what = self._controller, self._identity()
        hardware, tick = controller.hardware, controller.tick & MASK_32
        flags = (RINGS if hardware.rings else 0) | (SAFETY_OFF if hardware.safety_off else 0)
        flags |= on_top | (VIRTUAL if hardware.virtual else 0) | (LOCKSTEP if controller.lockstep else 0)
        names = hardware.name.encode()[:16], what.controller.encode()[:24]
        return self._pack_rig(
            hardware.seed & SEED_MASK, what.diagram, tick, TICK_US, flags, *names, controller.started_as, what.changed
        )

    def _add(self, name: str, values: Callable[[], tuple[Any, ...] | None], *fields: str) -> None:
        pack = Packer(name, *fields)

        def encode() -> Packed | None:
            given = values()
            return None if given is None else pack(*given)

        self.add(name, encode)

    def _add_of_step(self, row: StepMessage) -> None:
        self._add(row.name, lambda: None if self._step is None else row.values(self._step), *row.fields)

    def _judged(self) -> tuple[StepMessage, ...]:
        """Messages of a step and of more than that."""
        sensors = tuple(f"onboard_control_sensors_{part}" for part in ("present", "enabled", "health"))
        power = ("load", "voltage_battery", "current_battery", "battery_remaining")
        return (
            StepMessage("SYS_STATUS", (*sensors, *power), self._sys_status),
            StepMessage("TWODOF_SAFETY", (), self._safety),
        )

    def _sys_status(self, s: ControlStep) -> tuple[Any, ...]:
        """The load is the part of a control period that a step takes. No current is measured."""
        load = round(min(max(self._controller.timing.step_mean / TICK_US, 0.0), 1.0) * 1000.0)
        volts, charge = millivolts(s.sample.voltage), percent(s.sample.charge)
        return PRESENT, PRESENT, health(hindering(s)), load, volts, -1, charge

    def _safety(self, s: ControlStep) -> tuple[Any, ...]:
        killed_by = self._commander.arming.killed_by
        killed = (0, 0, 0) if killed_by is None else (1, *killed_by)
        return s.tick & MASK_32, self._since & MASK_32, s.causes & MASK_32, s.action, deciding(s.reason), *killed

    def _heartbeat(self) -> tuple[Any, ...]:
        now = self._commander
        return now.custom_mode, QUADROTOR, PX4, now.base_mode, now.system_status, VERSION

    def _highres_imu(self) -> tuple[Any, ...] | None:
        """Accelerometer and gyro; the sensors that do not exist are NaN."""
        if self._imu is None:
            return None
        return self.news[HIGHRES_IMU] * TICK_US, *self._imu[:6], *(nan,) * len(ABSENT), IMU_FIELDS

    def _distance_sensor(self) -> tuple[Any, ...] | None:
        """The range in whole centimetres."""
        if self._range is None:
            return None
        dist = self._range.dist
        centimetres = round(min(max(dist * 100.0, 0.0), float(LONGEST_CM))) if isfinite(dist) else LONGEST_CM
        stamp = self._range_us(self._range) // 1000 & MASK_32
        return stamp, *RANGE_CM, centimetres, BACKWARD, UNKNOWN_VARIANCE

    def _tof(self) -> tuple[Any, ...] | None:
        """The range, not rounded."""
        if self._range is None:
            return None
        dist = self._range.dist
        return self._range_us(self._range), self.news[TOF] & MASK_32, dist, int(isfinite(dist))

    def _range_us(self, sample: SensorSample) -> int:
        """When the range was measured [us]."""
        late = round(sample.dist_age * 1e6) if 0.0 <= sample.dist_age <= OLDEST_S else 0
        return max(0, self.news[TOF] * TICK_US - late)

    def _timing(self) -> tuple[Any, ...]:
        now = self._controller.timing
        counts = now.overruns, now.missed, self._lost() & MASK_32
        return self._controller.tick & MASK_32, *counts, now.step_mean, now.step_worst, now.late_worst

    def _lease(self) -> tuple[Any, ...]:
        now = self._commander.lease
        return min(now.left * TICK_MS, MASK_32), *(now.holder or NOBODY), int(now.tuning_withheld)

    def _openloop(self) -> tuple[Any, ...]:
        now = self._commander.openloop
        return now.tick & MASK_32, now.M, now.T, int(now.openloop), int(now.enableM), int(now.enableT)
