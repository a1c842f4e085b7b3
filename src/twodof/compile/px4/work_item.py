"""Work item of a module: the uORB topics behind a diagram's ports, and the C++ that PX4 runs on each gyro sample.

`topics.toml` holds the tables of ports and topics, and explains their columns. The C++ does not use PX4's ModuleBase,
which is another class after v1.17, so that the same text compiles with all versions.
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from types import MappingProxyType
from typing import Any

from twodof.compile.program.flat_program import FlatProgram
from twodof.compile.px4.controller import FAULTS, PERIOD_US, MessageFields
from twodof.compile.px4.names import ModuleNames, fill
from twodof.errors import DiagramError

_TABLES: Mapping[str, Any] = tomllib.loads(resources.files(__package__).joinpath("topics.toml").read_text("utf-8"))


@dataclass(frozen=True)
class Reading:
    """Source of an input: its topics, a description, its value in C++, its type and unit."""

    topics: Sequence[str]
    text: str
    value: str
    kind: str = "real"
    unit: str = ""


# Of each topic the fields that a module may touch, the class's member that keeps it, and a test of its age.
TOPICS: Mapping[str, Any] = MappingProxyType(_TABLES["topics"])
INPUTS: Mapping[str, Reading] = MappingProxyType({name: Reading(**row) for name, row in _TABLES["inputs"].items()})
OUTPUTS: Mapping[str, str] = MappingProxyType(_TABLES["outputs"])
MOTORS = tuple(_TABLES["commands"]["motors"]["finite"])


@dataclass(frozen=True)
class ModuleRole:
    """Place of a diagram in PX4's cascade.

    `commands` is "torque" (M, perhaps thrust), "attitude" (theta_0, thrust) or "motors"; `stops` are PX4's own modules
    that the diagram's module replaces.
    """

    commands: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    stops: tuple[str, ...]

    @property
    def thrust_setpoint(self) -> bool:
        """True if the thrust set-point of the topics is read."""
        return self.commands != "attitude"

    @property
    def reads(self) -> tuple[str, ...]:
        """Names of the topics read."""
        topics = {"vehicle_angular_velocity", "vehicle_control_mode", "actuator_armed", "parameter_update"}
        for name in self.inputs:
            topics.update(INPUTS[name].topics)
        if self.thrust_setpoint:
            topics.update(INPUTS["thrust_0"].topics)
        if self.commands == "attitude":
            topics.add("vehicle_attitude")
        return tuple(sorted(topics))

    @property
    def signs(self) -> dict[str, str]:
        """Topics that reveal another commanding module, with its name; beside one the exported module does not start.

        `vehicle_attitude_setpoint` is not among them: mavlink and mc_att_control publish it too, and never end.
        """
        signs = {_TABLES["signs"][module]: module for module in self.stops}
        others = () if self.commands == "attitude" else self.writes
        return {**dict.fromkeys(others, "another module"), **signs}

    @property
    def asides(self) -> tuple[str, ...]:
        """Further topics: those that show other commanding modules, and the one that makes PX4 disarm."""
        return tuple(sorted({*self.signs, "vehicle_command", "vehicle_status"}))

    @property
    def commanding(self) -> Mapping[str, Any]:
        """Properties of all modules with the same `commands`: see `topics.toml`.

        One that follows a pitch, but has no input that says when, commands where attitude is controlled.
        """
        common: Mapping[str, Any] = _TABLES["commands"][self.commands]
        if self.commands == "torque" and "theta_0" in self.inputs and "FLAG_ATTITUDE_ENABLED" not in self.inputs:
            both = "flag_control_rates_enabled\n           && mode.flag_control_attitude_enabled"
            alone = "while PX4's mode controls attitude (`flag_control_attitude_enabled`), not in Acro"
            return {**common, "when": alone, "wanted": common["wanted"].replace("flag_control_rates_enabled", both)}
        return common

    @property
    def writes(self) -> tuple[str, ...]:
        """Names of the topics published, in order of publication."""
        return tuple(self.commanding["writes"])


def role(program: FlatProgram) -> ModuleRole:
    """Return the role of a program by the names of its ports.

    Raises DiagramError for an input for which PX4 has no signal, a port of another type, width or unit, and outputs
    that command nothing or contradict each other.
    """

    def refused(what: str, remedy: str) -> DiagramError:
        return DiagramError(what, program.name, remedy)

    for name, signal in program.inputs.items():
        reading = INPUTS.get(name)
        if reading is None:
            raise refused(f"PX4 has no signal for its input {name!r}", f"use inputs among {', '.join(INPUTS)}")
        if (signal.kind, signal.width) != (reading.kind, None):
            width = "" if signal.width is None else f" of {signal.width}"
            raise refused(f"its input {name!r} is {signal.kind}{width}", f"make it {reading.kind}, a scalar")
        if signal.unit and reading.unit and signal.unit != reading.unit:
            raise refused(f"its input {name!r} is in {signal.unit}", f"PX4 gives {reading.unit}")
    if not program.inputs:
        raise refused("it has no inputs", f"give it some of {', '.join(INPUTS)}")
    inputs, found = tuple(program.inputs), tuple(name for name in OUTPUTS if name in program.outputs)
    for name in found:
        if (program.outputs[name].kind, program.outputs[name].width) != ("real", None):
            raise refused(f"its output {name!r} is not a real scalar", "make it one")
    moved = [name for name in MOTORS if name in found]
    if moved and (len(moved) < len(MOTORS) or "M" in found):
        raise refused(f"it commands {', '.join(found)}", "command all of motor_1 to motor_4 and no M, or only M")
    if moved:
        return ModuleRole("motors", inputs, found, ("control_allocator",))
    if "M" in found and "M_0" in inputs:
        raise refused("it reads M_0 and gives M", "M_0 is for a diagram that commands the motors")
    if "M" in found:
        above = ("mc_pos_control",) if "thrust" in found else ()
        return ModuleRole("torque", inputs, found, ("mc_rate_control", *above))
    if "theta_0" in found and "thrust" in found:
        circular = [name for name in ("theta_0", "thrust_0") if name in inputs]
        if circular:
            raise refused(f"it reads {' and '.join(circular)}, which it commands itself", "remove that input")
        return ModuleRole("attitude", inputs, found, ("mc_pos_control",))
    raise refused(
        f"its outputs ({', '.join(program.outputs) or 'none'}) command nothing in PX4",
        "give it M; M and thrust; thrust and theta_0; or motor_1, motor_2, motor_3, motor_4",
    )


# mavlink and mc_att_control publish this topic too, and its publication that has just gone has cleared their flag.
_AGAIN = "\n    orb_advertise(ORB_ID(vehicle_attitude_setpoint), nullptr);"
# A controller without an input that resets its integrals would wind up on the ground.
_AFRESH = "\n        _waiting = !wanted(_armed, _mode);"


def work_item_header(names: ModuleNames, role: ModuleRole) -> str:
    """Return the declaration of the work item's class."""
    topics = sorted({*role.reads, *role.writes, *role.asides, names.module})
    read = _kept(role)
    members = ["    float _thrust_setpoint{0.f};"] if role.thrust_setpoint else []
    members += [f"    {topic}_s {TOPICS[topic]['member']}{{}};" for topic in read]
    members += [f"    uORB::Subscription {TOPICS[topic]['member']}_sub{{ORB_ID({topic})}};" for topic in read]
    output = f"{names.class_name}Output"
    return fill(
        "work_item.hpp",
        names,
        topics="\n".join(f"#include <uORB/topics/{topic}.h>" for topic in topics),
        members="\n".join(members),
        publications="\n".join(f"    {output}<{topic}_s> _{topic}_pub{{ORB_ID({topic})}};" for topic in role.writes),
    )


def work_item(names: ModuleNames, role: ModuleRole, found: MessageFields) -> str:
    """Return the definition of the work item's class, and the entry of the module's command."""
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
        afresh="" if {"FLAG_RESET_INT", "FLAG_RESET_INT_VEL"} & set(role.inputs) else _AFRESH,
        torque_scale=f"\n    _torque_scale = values[{n}_TORQUE].real;" if role.commands == "torque" else "",
        message=_message(found),
        rivals="\n".join(rivals),
        **_input_fields(names, role, found),
        **_command_fields(names, role, found),
    )


def _kept(role: ModuleRole) -> list[str]:
    """Return the topics whose latest value the class keeps."""
    return [topic for topic in role.reads if "member" in TOPICS[topic]]


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
    tests = [TOPICS[topic]["fresh"] for topic in read if "fresh" in TOPICS[topic]] + [
        f"PX4_ISFINITE(_in.{name})" for name in measured
    ]
    body = "".join(f"    _in.{f.name} = {_value(role, f.path)};\n" for f in found.inputs)
    body = (
        "".join(f"    const bool {name} = {value};\n" for name, value in _TABLES["shared"].items() if name in body)
        + body
    )
    return {
        "pitch_of": fill("pitch_of.cpp", names) if "pitch_of" in body else "",
        "updates": "\n".join(
            f"    {TOPICS[topic]['member']}_sub.update(&{TOPICS[topic]['member']});" for topic in read
        ),
        "thrust": fill("thrust_setpoint.cpp", names, wanted=_thrust_wanted(role)) if role.thrust_setpoint else "",
        "sound": "\n           && ".join(tests) or "true",
        "inputs": body if "rates." in body else f"    (void)rates;\n{body}",
    }


def _value(role: ModuleRole, name: str) -> str:
    """Return an input's value in terms of the topics' members."""
    no_thrust = "!(_thrust_setpoint > 0.f)" if role.thrust_setpoint else "!along_rail"
    if role.thrust_setpoint and _own_thrust(role):  # along the rail the set-point's topic is silent
        no_thrust = f"(!along_rail && {no_thrust})"
    return INPUTS[name].value.format(
        x="_position.x" if "x" in role.inputs else "0.f",
        no_thrust=no_thrust,
        off_rail=" && !along_rail" if {"x_0", "vx_0"} & set(role.inputs) else "",  # there it has loops of its own
    )


def _thrust_wanted(role: ModuleRole) -> str:
    """Return in C++ when a missing thrust set-point is a fault."""
    if not _own_thrust(role):
        return "_armed.armed"
    off_rail = "!_mode.flag_control_velocity_enabled && !_mode.flag_control_position_enabled"
    return f"_armed.armed\n                          && {off_rail}"


def _own_thrust(role: ModuleRole) -> bool:
    """Return True if the diagram gives the thrust along the rail."""
    return "thrust" in role.outputs and "thrust_0" not in role.inputs


def _command_fields(names: ModuleNames, role: ModuleRole, found: MessageFields) -> dict[str, str]:
    """Return the fields that judge the commands and publish them."""
    members = {f.path: f"_out.{f.name}" for f in found.outputs if f.name.startswith("out_")}
    finite = [members[name] for name in role.outputs if name in role.commanding["finite"]]
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
        "wanted": f"    {role.commanding['wanted']}",
        "commands": fill(f"command_{role.commands}.cpp", names, **values),
    }
