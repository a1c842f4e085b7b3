"""Telemetry: encoders of every message that can be streamed or requested, with the present values.

Axes are forward-right-down. North is along the rail: heading is 0 and x points north. Motions that the rig does not
have (roll, yaw, sideways, up) are 0. The other fields follow https://mavlink.io/en/messages/common.html.
"""

import time
from collections.abc import Callable
from functools import partial
from math import cos, isfinite, nan, sin
from typing import Any, cast

from twodof.fcu.command.commander import Commander
from twodof.fcu.control.flight_code import ControllerIdentity, ControlStep
from twodof.fcu.control.hardware import SensorSample, VirtualHardware
from twodof.fcu.control.loop import FlightController
from twodof.fcu.mavlink.service import MASK_32
from twodof.flight.failsafe.causes_and_actions import BIT, CAUSES
from twodof.link.mavlink.dialect import message_id
from twodof.link.mavlink.messages import Packed, Packer
from twodof.signals import OPEN_LOOP, POSITION, RATE, TICK_MS, TICK_US, VELOCITY

LOCAL_NED, BODY_FRD, ESTIMATOR_AUTOPILOT = 1, 12, 8
PWM_OFF, PWM_LOW, PWM_SPAN = 900, 1000, 1000
# Of POSITION_TARGET_TYPEMASK: only x, vx and afx of the rig are ever flown.
_X, _VX, _AX, _ALWAYS = 1, 8, 64, 2 | 4 | 16 | 32 | 128 | 256 | 1024 | 2048
_NO_ATTITUDE, _NO_PITCH_RATE = 128, 2

LIPO, ALL_FUNCTIONS, CHARGE_OK, CHARGE_LOW, CHARGE_CRITICAL = 1, 1, 1, 2, 3
UNKNOWN_16, UNKNOWN_SIGNED_16 = 0xFFFF, 0x7FFF
LIFTED, GROUNDED = 2, 1
"""MAV_LANDED_STATE."""


def boot_ms(step: ControlStep) -> int:
    """Return time_boot_ms of a step."""
    return step.tick * TICK_MS & MASK_32


def quaternion(pitch: float) -> tuple[float, float, float, float]:
    """Return the quaternion (w, x, y, z) of a pitch [rad]; NaN if the pitch is not finite."""
    if not isfinite(pitch):
        return nan, nan, nan, nan
    return cos(pitch / 2.0), 0.0, sin(pitch / 2.0), 0.0


def millivolts(voltage: float) -> int:
    """Return a voltage [V] in whole mV, 65535 if it is not finite."""
    return round(min(max(voltage, 0.0), 65.534) * 1000.0) if isfinite(voltage) else UNKNOWN_16


def percent(charge: float) -> int:
    """Return a charge from 0 to 1 in whole percent, -1 if it is not finite."""
    return round(min(max(charge, 0.0), 1.0) * 100.0) if isfinite(charge) else -1


def _odometry(s: ControlStep) -> tuple[Any, ...]:
    """Return the pose in local NED, velocities in the body's axes, covariances unknown."""
    unknown = (nan, *(0.0,) * 20)
    tilt = s.theta if isfinite(s.theta) else nan
    forward, down = s.v * cos(tilt), s.v * sin(tilt)
    pose = s.tick * TICK_US, s.x, *quaternion(s.theta)
    return *pose, forward, down, s.q, *unknown, *unknown, LOCAL_NED, BODY_FRD, ESTIMATOR_AUTOPILOT


def _attitude_target(s: ControlStep) -> tuple[Any, ...]:
    """Return the set-points in use, thrust from 0 to 1 (upwards positive, as in PX4)."""
    mode = s.asked.mode
    mask = _NO_ATTITUDE | _NO_PITCH_RATE if mode <= OPEN_LOOP else _NO_ATTITUDE if mode == RATE else 0
    return boot_ms(s), *quaternion(s.theta0), s.q0, abs(s.T), mask


def _position_target(s: ControlStep) -> tuple[Any, ...]:
    """Return x0, v0 in use and the feed-forward; the mask marks the ones that do not fly."""
    mode = s.asked.mode
    mask = _ALWAYS | (0 if mode == POSITION else _X | _AX) | (0 if mode in (VELOCITY, POSITION) else _VX)
    return boot_ms(s), s.x0, s.v0, s.asked.ax0, mask, LOCAL_NED


def _servo_output(s: ControlStep) -> tuple[Any, ...]:
    """Return pulse widths of PX4's quadrotor x, motors 1 and 3 in front; 900 us while disarmed."""

    def width(command: float) -> int:
        if not s.armed or not isfinite(command):
            return PWM_OFF
        return PWM_LOW + round(PWM_SPAN * min(max(command, 0.0), 1.0))

    fore, aft = width(s.fore), width(s.aft)
    return s.tick * TICK_US & MASK_32, fore, aft, fore, aft


def _vfr_hud(s: ControlStep) -> tuple[Any, ...]:
    """Return the speed along the rail, and thrust in percent."""
    throttle = round(100.0 * min(abs(s.T), 1.0)) if isfinite(s.T) else 0
    return nan, abs(s.v), throttle


def _battery_status(s: ControlStep) -> tuple[Any, ...]:
    """Return the battery, with the pack's voltage in the place of the first cell's, as MAVLink wants it."""
    critical, low = (s.causes & BIT[name] for name in ("battery_critical", "battery_low"))
    state = CHARGE_CRITICAL if critical else CHARGE_LOW if low else CHARGE_OK
    cells = millivolts(s.sample.voltage), *(UNKNOWN_16,) * 9
    return -1, -1, UNKNOWN_SIGNED_16, *cells, -1, ALL_FUNCTIONS, LIPO, percent(s.sample.charge), state


def _landed_state(s: ControlStep) -> tuple[Any, ...]:
    """Return "in the air" while the motors give thrust."""
    return (LIFTED if s.armed and (s.fore > 0.0 or s.aft > 0.0) else GROUNDED,)


def _estimator_status(s: ControlStep) -> tuple[Any, ...]:
    """Return which estimates are believed."""
    lost = s.causes & (BIT["estimate_lost"] | BIT["imu_lost"])
    return s.tick * TICK_US, 0 if lost else 1 if s.causes & BIT["range_lost"] else 1 | 2 | 8


_PACK = "battery_function type battery_remaining charge_state"

STEP_MESSAGES: tuple[tuple[str, str, Callable[[ControlStep], tuple[Any, ...]]], ...] = (
    ("ATTITUDE", "time_boot_ms pitch pitchspeed", lambda s: (boot_ms(s), s.theta, s.q)),
    ("ATTITUDE_QUATERNION", "time_boot_ms q1 q2 q3 q4 pitchspeed", lambda s: (boot_ms(s), *quaternion(s.theta), s.q)),
    ("LOCAL_POSITION_NED", "time_boot_ms x vx", lambda s: (boot_ms(s), s.x, s.v)),
    (
        "ODOMETRY",
        "time_usec x q vx vz pitchspeed pose_covariance velocity_covariance frame_id child_frame_id estimator_type",
        _odometry,
    ),
    ("ATTITUDE_TARGET", "time_boot_ms q body_pitch_rate thrust type_mask", _attitude_target),
    ("POSITION_TARGET_LOCAL_NED", "time_boot_ms x vx afx type_mask coordinate_frame", _position_target),
    ("SERVO_OUTPUT_RAW", "time_usec servo1_raw servo2_raw servo3_raw servo4_raw", _servo_output),
    # What the mixer was given: M as pitch, T as thrust.
    ("ACTUATOR_CONTROL_TARGET", "time_usec controls", lambda s: (s.tick * TICK_US, 0.0, s.M, 0.0, s.T, *(0.0,) * 4)),
    ("VFR_HUD", "airspeed groundspeed throttle", _vfr_hud),
    (
        "BATTERY_STATUS",
        f"current_consumed energy_consumed temperature voltages current_battery {_PACK}",
        _battery_status,
    ),
    ("EXTENDED_SYS_STATE", "landed_state", _landed_state),
    ("ESTIMATOR_STATUS", "time_usec flags", _estimator_status),
)
"""Messages of a step, those of their fields that are not always 0, in the order of the wire, and their values."""


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
"""There is no geofence; it is reported healthy, as MAVProxy reports one that is neither as breached."""
UNHEALTHY: tuple[tuple[int, int], ...] = (
    (BIT["imu_lost"], GYRO | ACCELEROMETER),
    (BIT["range_lost"], RANGE),
    (BIT["estimate_lost"], AHRS),
    (BIT["user_failed"] | BIT["command_stuck"] | BIT["command_lost"], RATE_CONTROL | ATTITUDE_CONTROL),
    (BIT["battery_low"] | BIT["battery_critical"], BATTERY),
)
"""Causes of the failsafe, and the sensors that SYS_STATUS reports as unhealthy while they hold."""

ON_THE_GROUND = BIT["not_idle"] | BIT["tilted"]
"""Causes against arming that are normal in flight."""

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


def health(causes: int, armed: bool) -> int:
    """Return SYS_STATUS.onboard_control_sensors_health for a mask of causes; some causes are normal in flight."""
    if armed:
        causes &= ~ON_THE_GROUND
    sound = PRESENT | FENCE
    for bits, sensors in UNHEALTHY:
        if causes & bits:
            sound &= ~sensors
    return sound & ~PREARM if causes else sound


def deciding(reason: int) -> int:
    """Return the bit number of the cause in `reason` that demands the strongest action, -1 if there is none."""
    places = [place for place in range(len(CAUSES)) if reason >> place & 1]
    return max(places, key=lambda place: (CAUSES[place].action, -place), default=-1)


class TelemetryEncoders:
    """Encoders of the telemetry by message id (`messages`), fed with the latest step.

    A sensor's message has the last sample and that sample's time. `news` has the tick of that sample (-1: none yet), so
    that no sample is sent twice. `lost` returns the number of messages that clients did not take. `truth` returns the
    virtual rig's true state, None for a real rig: nothing on board uses it.
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
        sensors = "onboard_control_sensors_present onboard_control_sensors_enabled onboard_control_sensors_health"
        for name, fields, values in (
            *STEP_MESSAGES,
            ("SYS_STATUS", f"{sensors} load voltage_battery current_battery battery_remaining", self._sys_status),
            ("TWODOF_SAFETY", "", self._safety),
        ):
            self._add(name, partial(self._of_step, values), fields)
        self._add("HEARTBEAT", self._heartbeat)
        self._add("SYSTEM_TIME", lambda: (time.time_ns() // 1000, controller.tick * TICK_MS & MASK_32))
        # The middle of the rail. A rig indoors has no place on the globe: latitude and longitude are 0.
        self._add("HOME_POSITION", lambda: (1.0, 0.0, 0.0, 0.0), "q")
        imu = "time_usec xacc yacc zacc xgyro ygyro zgyro"
        self._add("HIGHRES_IMU", self._highres_imu, f"{imu} {' '.join(ABSENT)} fields_updated")
        distances = "min_distance max_distance current_distance"
        self._add("DISTANCE_SENSOR", self._distance_sensor, f"time_boot_ms {distances} orientation covariance")
        self._add("TWODOF_TOF", self._tof)
        self._pack_rig = Packer("TWODOF_RIG")
        self.add("TWODOF_RIG", self.rig)
        self._add("TWODOF_TIMING", self._timing)
        self._add("TWODOF_LEASE", self._lease, "duration_ms holder_system holder_component tuning_withheld")
        self._add("TWODOF_OPENLOOP", self._openloop, "tick M T openloop enableM enableT")
        if truth is not None:
            self._add("TWODOF_TRUTH", lambda: (controller.tick * TICK_US, *truth(), controller.tick & MASK_32))

    def add(self, name: str, encode: Callable[[], Any | None]) -> None:
        """Add a message that can be streamed and requested."""
        self._encoders[message_id(name)] = encode

    def message(self, number: int) -> Any | None:
        """Return the message with this id and the present values; None without a measurement for it yet."""
        return self._encoders[number]()

    def restart(self) -> None:
        """Restart without measurements."""
        self._step: ControlStep | None = None
        self._imu: SensorSample | None = None
        self._range: SensorSample | None = None
        self._since, self._action = 0, -1
        self.news.update(dict.fromkeys((HIGHRES_IMU, DISTANCE_SENSOR, TOF), -1))

    def observe(self, step: ControlStep) -> None:
        """Note a step as the latest one."""
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
        """Return TWODOF_RIG with the further flags `on_top`."""
        controller, what = self._controller, self._identity()
        hardware, tick = controller.hardware, controller.tick & MASK_32
        flags = (RINGS if hardware.rings else 0) | (SAFETY_OFF if hardware.safety_off else 0)
        flags |= on_top | (VIRTUAL if hardware.virtual else 0) | (LOCKSTEP if controller.lockstep else 0)
        names = hardware.name.encode()[:16], what.controller.encode()[:24]
        noise = cast(VirtualHardware, hardware).noise if hardware.virtual else 0.0
        return self._pack_rig(
            *(hardware.seed & SEED_MASK, what.diagram, tick, TICK_US, flags, *names),
            *(controller.started_as, what.changed, noise),
        )

    def _add(self, name: str, values: Callable[[], tuple[Any, ...] | None], fields: str = "") -> None:
        pack = Packer(name, *fields.split())

        def encode() -> Packed | None:
            given = values()
            return None if given is None else pack(*given)

        self.add(name, encode)

    def _of_step(self, values: Callable[[ControlStep], tuple[Any, ...]]) -> tuple[Any, ...] | None:
        return None if self._step is None else values(self._step)

    def _sys_status(self, s: ControlStep) -> tuple[Any, ...]:
        """Return health and battery; the load is the share of a control period that a step takes."""
        load = round(min(max(self._controller.timing.step_mean / TICK_US, 0.0), 1.0) * 1000.0)
        volts, charge = millivolts(s.sample.voltage), percent(s.sample.charge)
        return PRESENT, PRESENT, health(s.causes, s.armed), load, volts, -1, charge

    def _safety(self, s: ControlStep) -> tuple[Any, ...]:
        killed_by = self._commander.arming.killed_by
        killed = (0, 0, 0) if killed_by is None else (1, *killed_by)
        return s.tick & MASK_32, self._since & MASK_32, s.causes & MASK_32, s.action, deciding(s.reason), *killed

    def _heartbeat(self) -> tuple[Any, ...]:
        now = self._commander
        return now.custom_mode, QUADROTOR, PX4, now.base_mode, now.system_status, VERSION

    def _highres_imu(self) -> tuple[Any, ...] | None:
        """Return accelerometer and gyro; missing sensors are NaN."""
        if self._imu is None:
            return None
        return self.news[HIGHRES_IMU] * TICK_US, *self._imu[:6], *(nan,) * len(ABSENT), IMU_FIELDS

    def _distance_sensor(self) -> tuple[Any, ...] | None:
        """Return the range in whole centimetres."""
        tof = self._tof()
        if tof is None:
            return None
        us, _, dist, valid = tof
        centimetres = round(min(max(dist * 100.0, 0.0), float(LONGEST_CM))) if valid else LONGEST_CM
        return us // 1000 & MASK_32, *RANGE_CM, centimetres, BACKWARD, UNKNOWN_VARIANCE

    def _tof(self) -> tuple[Any, ...] | None:
        """Return the time of the last range [us], its tick, the range as measured and whether it is valid."""
        if self._range is None:
            return None
        tick, dist, age = self.news[TOF], self._range.dist, self._range.dist_age
        late = round(age * 1e6) if 0.0 <= age <= OLDEST_S else 0
        return max(0, tick * TICK_US - late), tick & MASK_32, dist, int(isfinite(dist))

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
