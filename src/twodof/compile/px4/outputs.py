"""The C++ that publishes a controller's outputs, or what is safe in their place."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from twodof.compile.px4.message import MessageFields
from twodof.compile.px4.names import ModuleNames
from twodof.compile.px4.topics import MOTORS, ModuleRole

ACTUATORS = 12  # elements of actuator_motors.control


# What the commands are in use for: the vehicle is armed, and its mode leaves them to this controller.
_WANTED: Mapping[str, str] = MappingProxyType(
    {
        "torque": "armed.armed && mode.flag_control_rates_enabled",
        "attitude": "armed.armed && (mode.flag_control_velocity_enabled || mode.flag_control_position_enabled)",
        "motors": "armed.armed",
    }
)


def output_class(names: ModuleNames) -> str:
    """The class of a topic that is commanded."""
    return f"""/**
 * A topic of the commands. PX4 has one flag for all who publish a topic: whoever of them ends clears it, and then
 * nobody reads what the others publish.
 */
template<typename T>
class {names.class_name}Output
{{
public:
    explicit {names.class_name}Output(const orb_metadata *topic) : _topic(topic), _pub(topic), _sub(topic) {{}}

    bool advertise() {{ return _pub.advertise(); }}

    /** Publishes; false if another has published since the last time, or has cleared the flag, which is set again. */
    bool publish(const T &value, hrt_abstime now)
    {{
        const bool cleared = _pub.advertised() && !_sub.advertised();
        const bool another = now < _last + TOGETHER && _sub.updated();

        if (cleared) {{
            orb_advertise(_topic, nullptr);
        }}

        _pub.publish(value);
        T latest;
        _sub.copy(&latest);
        _last = now;
        return !cleared && !another;
    }}

    const char *name() const {{ return _topic->o_name; }}

private:
    static constexpr hrt_abstime TOGETHER = 100000;  // after a longer pause another's publication is no rival

    const orb_metadata *_topic;
    uORB::Publication<T> _pub;
    uORB::Subscription _sub;
    hrt_abstime _last{{0}};
}};
"""


def publications_text(names: ModuleNames, role: ModuleRole) -> str:
    """The publications among the class's members."""
    output = f"{names.class_name}Output"
    return "\n".join(f"    {output}<{topic}_s> _{topic}_pub{{ORB_ID({topic})}};" for topic in role.writes)


def commands_text(names: ModuleNames, role: ModuleRole, found: MessageFields) -> str:
    """The functions that judge the commands and publish them."""
    c = names.class_name
    ignored = "" if "mode." in _WANTED[role.commands] else "    (void)mode;\n"
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

bool {c}::wanted(const actuator_armed_s &armed, const vehicle_control_mode_s &mode)
{{
{ignored}    return {_WANTED[role.commands]};
}}

void {c}::command(hrt_abstime sample)
{{
    _active = wanted(_armed, _mode) && (_faults & (STALE | NOT_FINITE)) == 0;
{body}}}
"""


def _used(role: ModuleRole, output: str) -> bool:
    return {"torque": output in ("M", "thrust"), "attitude": output != "M", "motors": output in MOTORS}[role.commands]


def _torque(role: ModuleRole, members: dict[str, str]) -> str:
    thrust = "_thrust_setpoint"
    if "thrust" in members and "thrust_0" in role.inputs:
        thrust = members["thrust"]
    elif "thrust" in members:
        thrust = (
            "(_mode.flag_control_velocity_enabled || _mode.flag_control_position_enabled)\n"
            f"                 ? {members['thrust']} : _thrust_setpoint"
        )
    return f"""
    if (!_mode.flag_control_rates_enabled) {{
        return; // another module commands torque and thrust, or nobody does
    }}

    const float thrust = {thrust};

    // Thrust first: the control allocator runs on the torque.
    vehicle_thrust_setpoint_s thrust_setpoint{{}};
    thrust_setpoint.timestamp_sample = sample;
    thrust_setpoint.xyz[2] = _active ? -limited(thrust, 0.f, 1.f) : 0.f;
    thrust_setpoint.timestamp = hrt_absolute_time();
    send(_vehicle_thrust_setpoint_pub, thrust_setpoint);

    vehicle_torque_setpoint_s torque_setpoint{{}};
    torque_setpoint.timestamp_sample = sample;
    torque_setpoint.xyz[1] = _active ? _torque_scale * limited({members["M"]}, -1.f, 1.f) : 0.f;
    torque_setpoint.timestamp = hrt_absolute_time();
    send(_vehicle_torque_setpoint_pub, torque_setpoint);
"""


def _attitude(role: ModuleRole, members: dict[str, str]) -> str:
    return f"""    const bool along_rail = _mode.flag_control_velocity_enabled || _mode.flag_control_position_enabled;
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
    send(_vehicle_attitude_setpoint_pub, attitude_setpoint);
"""


def _motors(role: ModuleRole, members: dict[str, str]) -> str:
    lines = "\n".join(
        f"    motors.control[{i}] = _active ? limited({members[name]}, 0.f, 1.f) : NAN;"
        for i, name in enumerate(MOTORS)
    )
    return f"""
    actuator_motors_s motors{{}}; // NaN stops a motor
    motors.timestamp_sample = sample;
{lines}

    for (int i = {len(MOTORS)}; i < {ACTUATORS}; i++) {{
        motors.control[i] = NAN;
    }}

    motors.timestamp = hrt_absolute_time();
    send(_actuator_motors_pub, motors);
"""
