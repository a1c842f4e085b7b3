"""The airframe of the rig, the scripts that put the module in the place of PX4's, and what the logger is to record."""

from zlib import crc32

from twodof.compile.px4.names import ModuleNames, harmless
from twodof.compile.px4.template_files import fill
from twodof.compile.px4.topics import ModuleRole

FIRST_ID, IDS = 22000, 1000  # PX4 reserves these for custom models


def airframe_id(names: ModuleNames) -> int:
    """SYS_AUTOSTART of the module's airframe, always the same for one name."""
    return FIRST_ID + crc32(names.module.encode()) % IDS


def airframe_file(names: ModuleNames) -> str:
    """The file's name, by which PX4_SIM_MODEL finds it too."""
    return f"{airframe_id(names)}_{names.module}"


def airframe(names: ModuleNames, role: ModuleRole, text: str) -> str:
    """The airframe's script: a multicopter with the rig's settings."""
    about = f" {harmless(text, 100)}".rstrip()
    return fill("airframe.sh", names, about=about, settings=_settings(names, role))


def board_settings(names: ModuleNames, role: ModuleRole) -> str:
    """etc/config.txt of a board's SD card, which PX4 runs after the airframe: the rig's settings but the outputs."""
    return fill("config.txt", names, settings=_settings(names, role))


def _settings(names: ModuleNames, role: ModuleRole) -> str:
    """What the rig needs of PX4, and the drone's gains for PX4's own loops beside the diagram.

    With the allocator below, which moves the motors of a symmetric X by .7071 of the torque, the gains are the larger
    by sqrt(2).
    """
    loops = "" if role.commands == "torque" else fill(f"loops_{role.commands}.sh", names)
    return fill("settings.sh", names) + loops


def takeover(names: ModuleNames, role: ModuleRole) -> str:
    """The .post script, which PX4 runs after its own modules have started."""
    stops = "\n".join(f"    {module} stop" for module in role.stops)
    return fill("takeover.sh", names, replaced=" and ".join(role.stops), stops=stops)


def logger_topics(names: ModuleNames, role: ModuleRole) -> str:
    """etc/logging/logger_topics.txt: name, and the interval in ms (0: every message)."""
    slow = {"vehicle_local_position": 20, "vehicle_attitude": 10, "sensor_combined": 0}
    others = {"vehicle_status": 200, "vehicle_land_detected": 200, "failsafe_flags": 200, "battery_status": 500}
    rows = [(names.module, 0)]
    rows += [(topic, slow.get(topic, 0)) for topic in sorted({*role.reads, *role.writes})]
    rows += sorted(others.items())
    if "actuator_motors" not in role.writes:
        rows.append(("actuator_motors", 0))
    return "".join(f"{topic} {interval}\n" for topic, interval in rows)
