"""What a diagram's ports are inside PX4: port names on one side, uORB topics and their fields on the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from twodof.compile.program.flat_program import FlatProgram
from twodof.errors import DiagramError


@dataclass(frozen=True)
class Reading:
    """What is fed to an input: its type, unit, topics, and in words what it is."""

    kind: str
    unit: str
    topics: tuple[str, ...]
    text: str


# The fields of each topic that a module may touch, with their types as the .msg files write them; "or" stands between
# those of different versions.
FIELDS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "vehicle_angular_velocity": {"timestamp_sample": "uint64", "xyz": "float32[3]"},
        "vehicle_attitude": {"timestamp": "uint64", "q": "float32[4]"},
        "vehicle_local_position": {
            "timestamp": "uint64",
            "xy_valid": "bool",
            "v_xy_valid": "bool",
            "x": "float32",
            "vx": "float32",
        },
        "vehicle_attitude_setpoint": {"timestamp": "uint64", "q_d": "float32[4]", "thrust_body": "float32[3]"},
        "vehicle_rates_setpoint": {"timestamp": "uint64", "pitch": "float32", "thrust_body": "float32[3]"},
        "trajectory_setpoint": {
            "timestamp": "uint64",
            "position": "float32[3]",
            "velocity": "float32[3]",
            "acceleration": "float32[3]",
        },
        "sensor_combined": {
            "timestamp": "uint64",
            "gyro_rad": "float32[3]",
            "accelerometer_m_s2": "float32[3]",
        },
        "vehicle_control_mode": {
            "flag_control_rates_enabled": "bool",
            "flag_control_attitude_enabled": "bool",
            "flag_control_velocity_enabled": "bool",
            "flag_control_position_enabled": "bool",
        },
        "actuator_armed": {"armed": "bool"},
        "parameter_update": {"timestamp": "uint64"},
        "vehicle_thrust_setpoint": {"timestamp": "uint64", "timestamp_sample": "uint64", "xyz": "float32[3]"},
        "vehicle_torque_setpoint": {"timestamp": "uint64", "timestamp_sample": "uint64", "xyz": "float32[3]"},
        "actuator_motors": {"timestamp": "uint64", "timestamp_sample": "uint64", "control": "float32[12]"},
        "vehicle_command": {
            "timestamp": "uint64",
            "param1": "float32",
            "param2": "float32",
            "command": "uint32",
            "target_system": "uint8",
            "target_component": "uint8",
            "source_system": "uint8",
            "source_component": "uint16 or uint8",
        },
        "vehicle_status": {"system_id": "uint8", "component_id": "uint8"},
        "rate_ctrl_status": {"timestamp": "uint64"},
        "takeoff_status": {"timestamp": "uint64"},
    }
)

# A module of PX4 -> the topic that it alone advertises, from its start to its end.
SIGNS: Mapping[str, str] = MappingProxyType(
    {
        "mc_rate_control": "rate_ctrl_status",
        "mc_pos_control": "takeoff_status",
        "control_allocator": "actuator_motors",
    }
)

_ATTITUDE, _RATES = "vehicle_attitude_setpoint", "vehicle_rates_setpoint"
INPUTS: Mapping[str, Reading] = MappingProxyType(
    {
        "theta": Reading("real", "rad", ("vehicle_attitude",), "pitch, from the attitude quaternion"),
        "q": Reading("real", "rad/s", ("vehicle_angular_velocity",), "pitch rate, xyz[1]"),
        "x": Reading("real", "m", ("vehicle_local_position",), "position along the rail, which is local north"),
        "vx": Reading("real", "m/s", ("vehicle_local_position",), "velocity along the rail"),
        "acc_x": Reading("real", "m/s2", ("sensor_combined",), "specific force forward, accelerometer_m_s2[0]"),
        "acc_z": Reading("real", "m/s2", ("sensor_combined",), "specific force down, accelerometer_m_s2[2]"),
        "gyro_y": Reading("real", "rad/s", ("sensor_combined",), "measured pitch rate, gyro_rad[1]"),
        "M_0": Reading("real", "", ("vehicle_torque_setpoint",), "moment asked for by mc_rate_control, xyz[1]"),
        "theta_0": Reading("real", "rad", (_ATTITUDE,), "pitch set-point, from q_d"),
        "q_0": Reading("real", "rad/s", (_RATES,), "pitch rate set-point"),
        "x_0": Reading("real", "m", ("trajectory_setpoint",), "position set-point, position[0]"),
        "vx_0": Reading("real", "m/s", ("trajectory_setpoint",), "velocity set-point, velocity[0]"),
        "ax_0": Reading("real", "m/s2", ("trajectory_setpoint",), "acceleration set-point, acceleration[0]"),
        "thrust_0": Reading("real", "", (_ATTITUDE, _RATES), "thrust set-point 0 to 1, -thrust_body[2]"),
        "FLAG_RESET_INT": Reading("bool", "", ("actuator_armed",), "disarmed, or no thrust: integrals are reset"),
        "FLAG_RATE_ENABLED": Reading("bool", "", ("vehicle_control_mode",), "some loop is closed"),
        "FLAG_ATTITUDE_ENABLED": Reading("bool", "", ("vehicle_control_mode",), "the attitude loop is closed"),
        "FLAG_VELOCITY_ENABLED": Reading("bool", "", ("vehicle_control_mode",), "the velocity is controlled"),
        "FLAG_RESET_INT_VEL": Reading(
            "bool", "", ("actuator_armed", "vehicle_control_mode"), "disarmed, or velocity is not controlled"
        ),
        "FLAG_POSITION_ENABLED": Reading("bool", "", ("vehicle_control_mode",), "the position loop is closed"),
    }
)

MOTORS = ("motor_1", "motor_2", "motor_3", "motor_4")
OUTPUTS: Mapping[str, str] = MappingProxyType(
    {
        "M": "pitching moment, -1 to 1: vehicle_torque_setpoint.xyz[1]",
        "thrust": "thrust, 0 to 1: -vehicle_thrust_setpoint.xyz[2]",
        "theta_0": "pitch set-point [rad]: vehicle_attitude_setpoint.q_d",
        "motor_1": "front right motor, 0 to 1: actuator_motors.control[0]",
        "motor_2": "rear left motor, 0 to 1: actuator_motors.control[1]",
        "motor_3": "front left motor, 0 to 1: actuator_motors.control[2]",
        "motor_4": "rear right motor, 0 to 1: actuator_motors.control[3]",
    }
)


@dataclass(frozen=True)
class ModuleRole:
    """Where in PX4's cascade a diagram stands.

    `commands` "torque" (M, perhaps thrust), "attitude" (theta_0, thrust) or "motors"; `stops` are PX4's own modules
    that it replaces.
    """

    commands: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    stops: tuple[str, ...]

    @property
    def thrust_setpoint(self) -> bool:
        """Whether the thrust set-point of the topics is read."""
        return self.commands != "attitude"

    @property
    def reads(self) -> tuple[str, ...]:
        """The topics read, by name."""
        topics = {"vehicle_angular_velocity", "vehicle_control_mode", "actuator_armed", "parameter_update"}
        for name in self.inputs:
            topics.update(INPUTS[name].topics)
        if self.thrust_setpoint:
            topics.update((_ATTITUDE, _RATES))
        if self.commands == "attitude":
            topics.add("vehicle_attitude")
        return tuple(sorted(topics))

    @property
    def signs(self) -> dict[str, str]:
        """Topic -> who advertises it; the module does not start beside one of them.

        `vehicle_attitude_setpoint` is not among them: mavlink and mc_att_control publish it too, and never end.
        """
        signs = {SIGNS[module]: module for module in self.stops}
        others = () if self.commands == "attitude" else self.writes
        return {**dict.fromkeys(others, "another module"), **signs}

    @property
    def asides(self) -> tuple[str, ...]:
        """What else is used: to see who else commands, and to ask PX4 to disarm."""
        return tuple(sorted({*self.signs, "vehicle_command", "vehicle_status"}))

    @property
    def writes(self) -> tuple[str, ...]:
        """The topics published, in the order in which they are."""
        return {
            "torque": ("vehicle_thrust_setpoint", "vehicle_torque_setpoint"),
            "attitude": (_ATTITUDE,),
            "motors": ("actuator_motors",),
        }[self.commands]


def role(program: FlatProgram) -> ModuleRole:
    """The role of a program by the names of its ports.

    Raises DiagramError, with the known names, for an input that PX4 has nothing for. It does so for a port of another
    type, width or unit, and for outputs that command nothing or too much.
    """
    for name, signal in program.inputs.items():
        reading = INPUTS.get(name)
        if reading is None:
            raise DiagramError(
                f"PX4 has nothing for its input {name!r}", program.name, f"inputs may be {', '.join(INPUTS)}"
            )
        if (signal.kind, signal.width) != (reading.kind, None):
            width = "" if signal.width is None else f" of {signal.width}"
            raise DiagramError(
                f"its input {name!r} is {signal.kind}{width}", program.name, f"make it {reading.kind}, a scalar"
            )
        if signal.unit and reading.unit and signal.unit != reading.unit:
            raise DiagramError(f"its input {name!r} is in {signal.unit}", program.name, f"PX4 gives {reading.unit}")
    if not program.inputs:
        raise DiagramError("it has no inputs", program.name, f"give it some of {', '.join(INPUTS)}")
    found = tuple(name for name in OUTPUTS if name in program.outputs)
    for name in found:
        signal = program.outputs[name]
        if (signal.kind, signal.width) != ("real", None):
            raise DiagramError(f"its output {name!r} is not a real scalar", program.name, "make it one")
    moved = [name for name in MOTORS if name in found]
    inputs = tuple(program.inputs)
    if moved and (len(moved) < len(MOTORS) or "M" in found):
        raise DiagramError(
            f"it commands {', '.join(found)}", program.name, "command all of motor_1 to motor_4 and no M, or only M"
        )
    if moved:
        return ModuleRole("motors", inputs, found, ("control_allocator",))
    if "M" in found and "M_0" in inputs:
        raise DiagramError("it reads M_0 and gives M", program.name, "M_0 is for a diagram that commands the motors")
    if "M" in found:
        above = ("mc_pos_control",) if "thrust" in found else ()
        return ModuleRole("torque", inputs, found, ("mc_rate_control", *above))
    if "theta_0" in found and "thrust" in found:
        circular = [name for name in ("theta_0", "thrust_0") if name in inputs]
        if circular:
            raise DiagramError(
                f"it reads {' and '.join(circular)}, which it commands itself", program.name, "remove that input"
            )
        return ModuleRole("attitude", inputs, found, ("mc_pos_control",))
    raise DiagramError(
        f"its outputs ({', '.join(program.outputs) or 'none'}) command nothing in PX4",
        program.name,
        "give it M; M and thrust; thrust and theta_0; or motor_1, motor_2, motor_3, motor_4",
    )
