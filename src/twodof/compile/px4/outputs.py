"""The C++ that publishes a controller's outputs, or what is safe in their place."""

from __future__ import annotations

from twodof.compile.px4.message import Fields
from twodof.compile.px4.names import ModuleNames
from twodof.compile.px4.topics import MOTORS, Role

ACTUATORS = 12  # elements of actuator_motors.control


def publications_text(role: Role) -> str:
    """The publications among the class's members."""
    return "\n".join(f"    uORB::Publication<{topic}_s> _{topic}_pub{{ORB_ID({topic})}};" for topic in role.writes)


def commands_text(names: ModuleNames, role: Role, found: Fields) -> str:
    """The functions that judge the commands and publish them."""
    c = names.class_name
    members = {f.path: f"_out.{f.name}" for f in found.outputs if f.name.startswith("out_")}
    finite = " && ".join(f"PX4_ISFINITE({members[name]})" for name in role.outputs if _used(role, name))
    body = {"torque": _torque, "attitude": _attitude, "motors": _motors}[role.commands](role, members)
    return f"""bool {c}::commands_are_finite() const
{{
    return {finite};
}}

static float limited(float value, float low, float high)
{{
    return value < low ? low : value > high ? high : value;
}}

void {c}::command(hrt_abstime sample)
{{
    const bool sound = (_faults & (STALE | NOT_FINITE)) == 0;
{body}}}
"""


def _used(role: Role, output: str) -> bool:
    return {"torque": output in ("M", "thrust"), "attitude": output != "M", "motors": output in MOTORS}[role.commands]


def _torque(role: Role, members: dict[str, str]) -> str:
    thrust = "_thrust_setpoint"
    if "thrust" in members and "thrust_0" in role.inputs:
        thrust = members["thrust"]
    elif "thrust" in members:
        thrust = (
            "(_mode.flag_control_velocity_enabled || _mode.flag_control_position_enabled)\n"
            f"                 ? {members['thrust']} : _thrust_setpoint"
        )
    return f"""    _active = sound && _armed.armed && _mode.flag_control_rates_enabled;

    if (!_mode.flag_control_rates_enabled) {{
        return; // another module commands torque and thrust, or nobody does
    }}

    const float thrust = {thrust};

    // Thrust first: the control allocator runs on the torque.
    vehicle_thrust_setpoint_s thrust_setpoint{{}};
    thrust_setpoint.timestamp_sample = sample;
    thrust_setpoint.xyz[2] = _active ? -limited(thrust, 0.f, 1.f) : 0.f;
    thrust_setpoint.timestamp = hrt_absolute_time();
    _vehicle_thrust_setpoint_pub.publish(thrust_setpoint);

    vehicle_torque_setpoint_s torque_setpoint{{}};
    torque_setpoint.timestamp_sample = sample;
    torque_setpoint.xyz[1] = _active ? _torque_scale * limited({members["M"]}, -1.f, 1.f) : 0.f;
    torque_setpoint.timestamp = hrt_absolute_time();
    _vehicle_torque_setpoint_pub.publish(torque_setpoint);
"""


def _attitude(role: Role, members: dict[str, str]) -> str:
    return f"""    const bool along_rail = _mode.flag_control_velocity_enabled || _mode.flag_control_position_enabled;
    _active = sound && _armed.armed && along_rail;
    (void)sample;

    if (!along_rail) {{
        return; // the attitude set-point is another's
    }}

    // The heading stays as it is: q_d is a turn by it, then by the pitch.
    const float heading = sqrtf(_attitude.q[0] * _attitude.q[0] + _attitude.q[3] * _attitude.q[3]);
    const float w = heading > 0.f ? _attitude.q[0] / heading : 1.f;
    const float z = heading > 0.f ? _attitude.q[3] / heading : 0.f;
    const float half = _active ? 0.5f * {members["theta_0"]} : 0.f;

    vehicle_attitude_setpoint_s attitude_setpoint{{}};
    attitude_setpoint.q_d[0] = w * cosf(half);
    attitude_setpoint.q_d[1] = -z * sinf(half);
    attitude_setpoint.q_d[2] = w * sinf(half);
    attitude_setpoint.q_d[3] = z * cosf(half);
    attitude_setpoint.thrust_body[2] = _active ? -limited({members["thrust"]}, 0.f, 1.f) : 0.f;
    attitude_setpoint.timestamp = hrt_absolute_time();
    _vehicle_attitude_setpoint_pub.publish(attitude_setpoint);
"""


def _motors(role: Role, members: dict[str, str]) -> str:
    lines = "\n".join(
        f"    motors.control[{i}] = _active ? limited({members[name]}, 0.f, 1.f) : NAN;"
        for i, name in enumerate(MOTORS)
    )
    return f"""    _active = sound && _armed.armed;

    actuator_motors_s motors{{}}; // NaN stops a motor
    motors.timestamp_sample = sample;
{lines}

    for (int i = {len(MOTORS)}; i < {ACTUATORS}; i++) {{
        motors.control[i] = NAN;
    }}

    motors.timestamp = hrt_absolute_time();
    _actuator_motors_pub.publish(motors);
"""
