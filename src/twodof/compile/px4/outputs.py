"""How a controller's outputs become uORB topics, in the C++ of the module."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from twodof.compile.px4.message import MessageFields
from twodof.compile.px4.names import ModuleNames
from twodof.compile.px4.template_files import fill
from twodof.compile.px4.topics import MOTORS, ModuleRole

# What the commands are in use for: the vehicle is armed, and its mode leaves them to this controller.
_WANTED: Mapping[str, str] = MappingProxyType(
    {
        "torque": "armed.armed && mode.flag_control_rates_enabled",
        "attitude": "armed.armed && (mode.flag_control_velocity_enabled || mode.flag_control_position_enabled)",
        "motors": "armed.armed",
    }
)


def publications_text(names: ModuleNames, role: ModuleRole) -> str:
    """The publications among the class's members."""
    output = f"{names.class_name}Output"
    return "\n".join(f"    {output}<{topic}_s> _{topic}_pub{{ORB_ID({topic})}};" for topic in role.writes)


def command_fields(names: ModuleNames, role: ModuleRole, found: MessageFields) -> dict[str, str]:
    """The fields of work_item.cpp that judge the commands and publish them."""
    members = {f.path: f"_out.{f.name}" for f in found.outputs if f.name.startswith("out_")}
    wanted = f"    return {_WANTED[role.commands]};"
    return {
        "finite": " && ".join(f"PX4_ISFINITE({members[name]})" for name in role.outputs if _used(role, name)),
        "wanted": wanted if "mode." in wanted else f"    (void)mode;\n{wanted}",
        "commands": fill(f"command_{role.commands}.cpp", names, **_values(role, members)),
    }


def _used(role: ModuleRole, output: str) -> bool:
    return {"torque": output in ("M", "thrust"), "attitude": output != "M", "motors": output in MOTORS}[role.commands]


def _values(role: ModuleRole, members: dict[str, str]) -> dict[str, str]:
    """The values that are published, in terms of the class's members."""
    if role.commands == "motors":
        limited = (f"limited({members[name]}, 0.f, 1.f)" for name in MOTORS)
        return {
            "motors": "\n".join(f"    motors.control[{i}] = _active ? {text} : NAN;" for i, text in enumerate(limited))
        }
    if role.commands == "attitude":
        return {"pitch": members["theta_0"], "thrust": members["thrust"]}
    thrust = members.get("thrust", "_thrust_setpoint")
    if "thrust" in members and "thrust_0" not in role.inputs:
        thrust = (
            "(_mode.flag_control_velocity_enabled || _mode.flag_control_position_enabled)\n"
            f"                 ? {thrust} : _thrust_setpoint"
        )
    return {"moment": members["M"], "thrust": thrust}
