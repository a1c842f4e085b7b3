"""How uORB topics become a controller's inputs, in the C++ of the module."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from twodof.compile.px4.names import ModuleNames, field_names
from twodof.compile.px4.template_files import fill
from twodof.compile.px4.topics import ModuleRole

# The topics that are read into a member of the class, and that member.
MEMBERS: Mapping[str, str] = MappingProxyType(
    {
        "actuator_armed": "_armed",
        "sensor_combined": "_sensors",
        "trajectory_setpoint": "_trajectory_setpoint",
        "vehicle_attitude": "_attitude",
        "vehicle_attitude_setpoint": "_attitude_setpoint",
        "vehicle_control_mode": "_mode",
        "vehicle_local_position": "_position",
        "vehicle_rates_setpoint": "_rates_setpoint",
        "vehicle_torque_setpoint": "_torque_setpoint",
    }
)

_FRESH: Mapping[str, str] = MappingProxyType(
    {
        "vehicle_attitude": "fresh(_attitude.timestamp, _now, ATTITUDE_AGE)",
        "sensor_combined": "fresh(_sensors.timestamp, _now, ATTITUDE_AGE)",
        "vehicle_local_position": "fresh(_position.timestamp, _now, POSITION_AGE) && _position.xy_valid"
        " && _position.v_xy_valid",
    }
)

# The inputs that are measured: one that is not finite makes the measurements unsound.
MEASURED = ("theta", "q", "x", "vx", "acc_x", "acc_z", "gyro_y")

# Input -> what it is, in terms of `read_inputs`. A set-point that is wanted and not there is a fault.
_VALUES: Mapping[str, str] = MappingProxyType(
    {
        "theta": "pitch_of(_attitude.q)",
        "q": "rates.xyz[1]",
        "x": "_position.x",
        "vx": "_position.vx",
        "acc_x": "_sensors.accelerometer_m_s2[0]",
        "acc_z": "_sensors.accelerometer_m_s2[2]",
        "gyro_y": "_sensors.gyro_rad[1]",
        "M_0": "setpoint(_torque_setpoint.xyz[1], _torque_setpoint.timestamp, 0.f, _armed.armed)",
        "theta_0": "setpoint(pitch_of(_attitude_setpoint.q_d), _attitude_setpoint.timestamp, 0.f,\n"
        "                _armed.armed && _mode.flag_control_attitude_enabled && !along_rail)",
        "q_0": "setpoint(_rates_setpoint.pitch, _rates_setpoint.timestamp, 0.f,\n"
        "                _armed.armed && !_mode.flag_control_attitude_enabled)",
        "x_0": "setpoint(_trajectory_setpoint.position[0], _trajectory_setpoint.timestamp, {x},\n"
        "                _armed.armed && position_wanted && !has_velocity)",
        "vx_0": "setpoint(_trajectory_setpoint.velocity[0], _trajectory_setpoint.timestamp, 0.f,\n"
        "                _armed.armed && along_rail && !has_position)",
        "ax_0": "setpoint(_trajectory_setpoint.acceleration[0], _trajectory_setpoint.timestamp, 0.f, false)",
        "thrust_0": "_thrust_setpoint",
        "FLAG_RESET_INT": "!_armed.armed || {no_thrust}",
        "FLAG_RATE_ENABLED": "_mode.flag_control_rates_enabled",
        "FLAG_ATTITUDE_ENABLED": "_mode.flag_control_attitude_enabled",
        "FLAG_VELOCITY_ENABLED": "along_rail",
        "FLAG_RESET_INT_VEL": "!_armed.armed || !along_rail",
        "FLAG_POSITION_ENABLED": "position_wanted && has_position",
    }
)


def members_text(role: ModuleRole) -> str:
    """The members that hold the topics' latest values, and the subscriptions."""
    read = [topic for topic in role.reads if topic in MEMBERS]
    lines = ["    hrt_abstime _now{0};"]
    if role.thrust_setpoint:
        lines.append("    float _thrust_setpoint{0.f};")
    lines += [f"    {topic}_s {MEMBERS[topic]}{{}};" for topic in read]
    lines += [f"    uORB::Subscription {MEMBERS[topic]}_sub{{ORB_ID({topic})}};" for topic in read]
    lines += ["", "    float setpoint(float value, hrt_abstime stamp, float neutral, bool wanted);"]
    return "\n".join(lines)


def input_fields(names: ModuleNames, role: ModuleRole) -> dict[str, str]:
    """The fields of work_item.cpp that read the topics, judge the measurements and fill the inputs."""
    read = [topic for topic in role.reads if topic in MEMBERS]
    members = dict(zip(role.inputs, field_names("in", role.inputs), strict=True))
    tests = [_FRESH[topic] for topic in read if topic in _FRESH]
    tests += [f"PX4_ISFINITE(_in.{members[name]})" for name in MEASURED if name in members]
    body = _locals(role) + _assignments(role)
    return {
        "pitch_of": fill("pitch_of.cpp", names) if "pitch_of" in body else "",
        "updates": "\n".join(f"    {MEMBERS[topic]}_sub.update(&{MEMBERS[topic]});" for topic in read),
        "thrust": fill("thrust_setpoint.cpp", names) if role.thrust_setpoint else "",
        "sound": "\n           && ".join(tests) or "true",
        "inputs": body if "rates." in body else f"    (void)rates;\n{body}",
    }


def _locals(role: ModuleRole) -> str:
    """What several inputs share."""
    values = " ".join(_VALUES[name] for name in role.inputs)
    if "FLAG_RESET_INT" in role.inputs:
        values += _no_thrust(role)
    text = ""
    if "along_rail" in values:
        text += (
            "    const bool along_rail = _mode.flag_control_velocity_enabled || _mode.flag_control_position_enabled;\n"
        )
    if "position_wanted" in values:
        text += "    const bool position_wanted = _mode.flag_control_position_enabled;\n"
    for axis in ("position", "velocity"):
        if f"has_{axis}" in values:
            text += f"    const bool has_{axis} = PX4_ISFINITE(_trajectory_setpoint.{axis}[0])\n"
            text += "                && fresh(_trajectory_setpoint.timestamp, _now, SETPOINT_AGE);\n"
    return text


def _no_thrust(role: ModuleRole) -> str:
    if not role.thrust_setpoint:
        return "!along_rail"
    # Where the diagram gives the thrust along the rail, the set-point's topic is silent there.
    own = "thrust" in role.outputs and "thrust_0" not in role.inputs
    return "(!along_rail && !(_thrust_setpoint > 0.f))" if own else "!(_thrust_setpoint > 0.f)"


def _assignments(role: ModuleRole) -> str:
    text = ""
    members = dict(zip(role.inputs, field_names("in", role.inputs), strict=True))
    for name, member in members.items():
        value = _VALUES[name]
        value = value.replace("{x}", "_position.x" if "x" in role.inputs else "0.f")
        value = value.replace("{no_thrust}", _no_thrust(role))
        text += f"    _in.{member} = {value};\n"
    return text
