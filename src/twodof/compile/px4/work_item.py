"""The module's C++: a work item that PX4 runs on each gyro sample, and its command.

It does without PX4's ModuleBase, which is another class after v1.17, so that one text serves all versions.
"""

from __future__ import annotations

from twodof.compile.px4.controller import PERIOD_US
from twodof.compile.px4.inputs import input_fields, members_text
from twodof.compile.px4.message import FAULTS, MessageFields
from twodof.compile.px4.names import ModuleNames
from twodof.compile.px4.outputs import command_fields, publications_text
from twodof.compile.px4.template_files import fill
from twodof.compile.px4.topics import ModuleRole

# mavlink and mc_att_control publish this topic too, and its publication that has just gone has cleared their flag.
_AGAIN = "\n    orb_advertise(ORB_ID(vehicle_attitude_setpoint), nullptr);"


def work_item_header(names: ModuleNames, role: ModuleRole) -> str:
    """The class's declaration."""
    topics = sorted({*role.reads, *role.writes, *role.asides, names.module})
    return fill(
        "work_item.hpp",
        names,
        topics="\n".join(f"#include <uORB/topics/{topic}.h>" for topic in topics),
        members=members_text(role),
        publications=publications_text(names, role),
    )


def work_item(names: ModuleNames, role: ModuleRole, found: MessageFields) -> str:
    """The class's definition and the command's entry."""
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
        **input_fields(names, role),
        **command_fields(names, role, found),
    )


def _message(found: MessageFields) -> str:
    lines = []
    for struct, members in (("_in", found.inputs), ("_out", found.outputs)):
        for f in members:
            if f.width is None:
                lines.append(f"    message.{f.name} = {struct}.{f.name};")
            else:
                lines.append(f"    memcpy(message.{f.name}, {struct}.{f.name}, sizeof message.{f.name});")
    return "\n".join(lines)
