"""The module's C++: a work item that PX4 runs on each gyro sample, and its command.

It does without PX4's ModuleBase, which is another class after v1.17, so that one text serves all versions.
"""

from twodof.compile.px4.controller import PERIOD_US
from twodof.compile.px4.message import FAULTS, MessageFields
from twodof.compile.px4.names import ModuleNames, fill
from twodof.compile.px4.topics import FRESH, INPUTS, MEMBERS, MOTORS, SHARED, ModuleRole

# mavlink and mc_att_control publish this topic too, and its publication that has just gone has cleared their flag.
_AGAIN = "\n    orb_advertise(ORB_ID(vehicle_attitude_setpoint), nullptr);"


def work_item_header(names: ModuleNames, role: ModuleRole) -> str:
    """Return the class's declaration."""
    topics = sorted({*role.reads, *role.writes, *role.asides, names.module})
    read = _kept(role)
    members = ["    float _thrust_setpoint{0.f};"] if role.thrust_setpoint else []
    members += [f"    {topic}_s {MEMBERS[topic]}{{}};" for topic in read]
    members += [f"    uORB::Subscription {MEMBERS[topic]}_sub{{ORB_ID({topic})}};" for topic in read]
    output = f"{names.class_name}Output"
    return fill(
        "work_item.hpp",
        names,
        topics="\n".join(f"#include <uORB/topics/{topic}.h>" for topic in topics),
        members="\n".join(members),
        publications="\n".join(f"    {output}<{topic}_s> _{topic}_pub{{ORB_ID({topic})}};" for topic in role.writes),
    )


def work_item(names: ModuleNames, role: ModuleRole, found: MessageFields) -> str:
    """Return the class's definition and the command's entry."""
    n = names.module
    rivals = (f'        {{ORB_ID({topic}), "{who} publishes {topic}"}},' for topic, who in sorted(role.signs.items()))
    return fill(
        "work_item.cpp",
        names,
        period=PERIOD_US,
        faults="\n".join(f"static constexpr uint8_t {name} = {n}_s::FAULT_{name};" for _, name, _ in FAULTS),
        # So that another module sees at its start that this one commands.
        advertised=" && ".join(f"_{topic}_pub.advertise()" for topic in role.writes),
        again=_AGAIN if role.commands == "attitude" else "",
        torque_scale=f"\n    _torque_scale = values[{n}_TORQUE].real;" if role.commands == "torque" else "",
        message=_message(found),
        rivals="\n".join(rivals),
        **_input_fields(names, role, found),
        **_command_fields(names, role, found),
    )


def _kept(role: ModuleRole) -> list[str]:
    """Return the topics whose latest value the class keeps."""
    return [topic for topic in role.reads if topic in MEMBERS]


def _message(found: MessageFields) -> str:
    lines = []
    for struct, members in (("_in", found.inputs), ("_out", found.outputs)):
        for f in members:
            if f.width is None:
                lines.append(f"    message.{f.name} = {struct}.{f.name};")
            else:
                lines.append(f"    memcpy(message.{f.name}, {struct}.{f.name}, sizeof message.{f.name});")
    return "\n".join(lines)


def _input_fields(names: ModuleNames, role: ModuleRole, found: MessageFields) -> dict[str, str]:
    """Return the fields that read the topics, judge the measurements and fill the inputs."""
    read = _kept(role)
    # What is measured, all reals but the set-points, must be finite.
    members = {f.path: f.name for f in found.inputs if f.kind == "real" and not f.path.endswith("_0")}
    measured = [members[path] for path in INPUTS if path in members]
    tests = [FRESH[topic] for topic in read if topic in FRESH] + [f"PX4_ISFINITE(_in.{name})" for name in measured]
    body = "".join(f"    _in.{f.name} = {_value(role, f.path)};\n" for f in found.inputs)
    body = "".join(f"    const bool {name} = {value};\n" for name, value in SHARED.items() if name in body) + body
    return {
        "pitch_of": fill("pitch_of.cpp", names) if "pitch_of" in body else "",
        "updates": "\n".join(f"    {MEMBERS[topic]}_sub.update(&{MEMBERS[topic]});" for topic in read),
        "thrust": fill("thrust_setpoint.cpp", names) if role.thrust_setpoint else "",
        "sound": "\n           && ".join(tests) or "true",
        "inputs": body if "rates." in body else f"    (void)rates;\n{body}",
    }


def _value(role: ModuleRole, name: str) -> str:
    """Return an input's value in terms of the topics' members."""
    no_thrust = "!(_thrust_setpoint > 0.f)" if role.thrust_setpoint else "!along_rail"
    if role.thrust_setpoint and _own_thrust(role):  # along the rail the set-point's topic is silent
        no_thrust = f"(!along_rail && {no_thrust})"
    return INPUTS[name].value.format(x="_position.x" if "x" in role.inputs else "0.f", no_thrust=no_thrust)


def _own_thrust(role: ModuleRole) -> bool:
    """Return True if the diagram gives the thrust along the rail."""
    return "thrust" in role.outputs and "thrust_0" not in role.inputs


def _command_fields(names: ModuleNames, role: ModuleRole, found: MessageFields) -> dict[str, str]:
    """Return the fields that judge the commands and publish them."""
    members = {f.path: f"_out.{f.name}" for f in found.outputs if f.name.startswith("out_")}
    finite = [members[name] for name in role.outputs if name in role.commanding.finite]
    if role.commands == "motors":
        limited = (f"limited({members[name]}, 0.f, 1.f)" for name in MOTORS)
        values = {"motors": "\n".join(f"    motors.control[{i}] = _active ? {v} : NAN;" for i, v in enumerate(limited))}
    elif role.commands == "attitude":
        values = {"pitch": members["theta_0"], "thrust": members["thrust"]}
    else:
        thrust = members.get("thrust", "_thrust_setpoint")
        if _own_thrust(role):
            thrust = (
                "(_mode.flag_control_velocity_enabled || _mode.flag_control_position_enabled)\n"
                f"                 ? {thrust} : _thrust_setpoint"
            )
        values = {"moment": members["M"], "thrust": thrust}
    return {
        "finite": " && ".join(f"PX4_ISFINITE({member})" for member in finite),
        "wanted": f"    {role.commanding.wanted}",
        "commands": fill(f"command_{role.commands}.cpp", names, **values),
    }
