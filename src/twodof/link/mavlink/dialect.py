"""The MAVLink dialect: a Python module made of dialect.xml by pymavlink's generator on first use, then from the cache.

What is cached is the module's byte code, without docstrings, so that it loads in hundredths of a second. Its classes
and constants are pymavlink's: `load().MAVLink_heartbeat_message`, `load().MAV_CMD_COMPONENT_ARM_DISARM`.
"""

import __future__

import importlib.util
import marshal
import subprocess
import sys
from collections.abc import Mapping
from enum import IntEnum
from pathlib import Path
from threading import Lock
from types import MappingProxyType, ModuleType
from typing import Any, NamedTuple

import pymavlink

from twodof.compile.toolchain import cache
from twodof.errors import LinkError, listed, shown

AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1: the flight controller."""
GROUND_STATION = 190
"""MAV_COMP_ID_MISSIONPLANNER: a client on the ground."""
COMPANION = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER: the companion."""
APP = 192
"""MAV_COMP_ID_ONBOARD_COMPUTER2: a user's program on board."""
NO_AUTOPILOT = 8
"""MAV_AUTOPILOT_INVALID: the autopilot in the HEARTBEAT of a component that is none."""


class MavResult(IntEnum):
    """MAV_RESULT: result of a command in its COMMAND_ACK."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5


class MavSeverity(IntEnum):
    """MAV_SEVERITY: urgency of a text, as in syslog."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    INFO = 6


class MavCmd(IntEnum):
    """MAV_CMD: the commands that a drone carries out."""

    DO_SET_MODE = 176
    DO_FLIGHTTERMINATION = 185
    PREFLIGHT_STORAGE = 245
    PREFLIGHT_REBOOT_SHUTDOWN = 246
    DO_SET_STANDARD_MODE = 262
    COMPONENT_ARM_DISARM = 400
    RUN_PREARM_CHECKS = 401
    GET_HOME_POSITION = 410
    GET_MESSAGE_INTERVAL = 510
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_PROTOCOL_VERSION = 519
    REQUEST_AUTOPILOT_CAPABILITIES = 520
    LOGGING_START = 2510
    LOGGING_STOP = 2511
    USER_1 = 31010


class Rates(NamedTuple):
    """Rates [1/s] at which a client gets a message unless it asks for others: on a fast link, and on a slow one.

    0: with each news; None: on request only. `on_change`: it also comes at each change. The flight controller streams
    at these rates, and the companion thins to them. Source: PX4 v1.16, mavlink_main.cpp, MAVLINK_MODE_ONBOARD and
    MAVLINK_MODE_NORMAL; the rates of twodof's own messages are ours.
    """

    number: int
    name: str
    onboard: float | None
    ground: float | None
    on_change: bool = False


RATES = (
    Rates(30, "ATTITUDE", 100.0, 15.0),
    Rates(31, "ATTITUDE_QUATERNION", 50.0, 10.0),
    Rates(105, "HIGHRES_IMU", 50.0, 2.0),
    Rates(32, "LOCAL_POSITION_NED", 30.0, 1.0),
    Rates(331, "ODOMETRY", 30.0, 0.5),
    Rates(132, "DISTANCE_SENSOR", 10.0, 0.5),
    Rates(36, "SERVO_OUTPUT_RAW", 10.0, 1.0),
    Rates(83, "ATTITUDE_TARGET", 10.0, 2.0),
    Rates(85, "POSITION_TARGET_LOCAL_NED", 10.0, 1.5),
    Rates(140, "ACTUATOR_CONTROL_TARGET", 10.0, 1.0),
    Rates(74, "VFR_HUD", 10.0, 4.0),
    Rates(1, "SYS_STATUS", 5.0, 1.0),
    Rates(245, "EXTENDED_SYS_STATE", 5.0, 1.0),
    Rates(2, "SYSTEM_TIME", 1.0, 0.5),
    Rates(230, "ESTIMATOR_STATUS", 1.0, 0.5),
    Rates(54206, "TWODOF_RIG", 1.0, 1.0, on_change=True),
    Rates(54209, "TWODOF_LEASE", 1.0, 1.0, on_change=True),
    Rates(54210, "TWODOF_SAFETY", 1.0, 1.0, on_change=True),
    Rates(54211, "TWODOF_TIMING", 1.0, 1.0, on_change=True),
    Rates(147, "BATTERY_STATUS", 0.5, 0.5),
    Rates(242, "HOME_POSITION", 0.5, 0.5),
    Rates(436, "CURRENT_MODE", 0.5, 0.5, on_change=True),
    Rates(437, "AVAILABLE_MODES_MONITOR", 0.3, 0.3, on_change=True),
    Rates(54204, "TWODOF_TOF", 0.0, None),
    Rates(54200, "TWODOF_OPENLOOP", 0.0, 0.0, on_change=True),
)

ONBOARD: Mapping[int, float] = MappingProxyType({row.number: row.onboard for row in RATES if row.onboard is not None})
"""Message id -> rate [1/s] on a fast link; 0: with each news."""
GROUND: Mapping[int, float] = MappingProxyType({row.number: row.ground for row in RATES if row.ground is not None})
"""The same for a slow link."""
PROFILES: Mapping[str, Mapping[int, float]] = MappingProxyType({"onboard": ONBOARD, "ground": GROUND})


FILES = ("dialect.xml", "common.xml")
MODULE = "twodof.link.generated"
FIRST_OWN_ID, LAST_OWN_ID = 54200, 54299
# It takes .2 s; a loaded machine several times that.
BUILD_SECONDS = 60
_GENERATE = """
import sys
from types import SimpleNamespace
from pymavlink.generator import mavgen
options = {"wire_protocol": "2.0", "language": "Python3", "validate": False, "strict_units": False}
sys.exit(not mavgen.mavgen(SimpleNamespace(output=sys.argv[2], **options), [sys.argv[1]]))
"""
_lock = Lock()


def load() -> ModuleType:
    """Return the dialect's module, the same one for all threads of the process.

    Raises LinkError if it cannot be generated.
    """
    with _lock:
        module = sys.modules.get(MODULE)
        if module is None:
            module = build({name: Path(__file__).with_name(name).read_text(encoding="utf-8") for name in FILES})
            sys.modules[MODULE] = module
        return module


def build(files: Mapping[str, str]) -> ModuleType:
    """Generate a module from the definitions in `files` (name -> XML; the first includes the others), unregistered.

    Raises LinkError if the generator refuses or hangs.
    """
    generator = f"pymavlink {pymavlink.__version__} {importlib.util.MAGIC_NUMBER.hex()} {sys.implementation.cache_tag}"
    key = ("mavlink", generator, *(part for item in files.items() for part in item))
    module = ModuleType(MODULE, "MAVLink as generated from dialect.xml.")
    # An entry that is damaged, or written by another Python, cannot be loaded and is made again.
    code = cache.cached(
        key, ".code", lambda made: _generate(files, made), lambda made: marshal.loads(made.read_bytes())
    )
    exec(code, module.__dict__)
    return module


def _generate(files: Mapping[str, str], made: Path) -> None:
    """Generate a module from `files` and write its byte code to `made`."""
    for name, text in files.items():
        made.with_name(name).write_text(text, encoding="utf-8")
    source = made.with_suffix(".py")
    # In a process of its own: the generator prints, exits and has no deadline.
    command = [sys.executable, "-W", "ignore", "-c", _GENERATE, next(iter(files)), str(source)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=BUILD_SECONDS, check=False, cwd=made.parent)
    except (subprocess.TimeoutExpired, OSError) as error:
        what = f"the dialect was not generated: {error}"
        raise LinkError(what, "MAVLink dialect", "try again when the machine is less busy") from error
    if done.returncode or not source.is_file():
        said = (done.stderr or done.stdout).decode("utf-8", "replace").strip()[-1000:]
        raise LinkError(f"the generator refused: {said}", "MAVLink dialect", "install pymavlink again")
    # Annotations as text and no docstrings: half of the time that loading takes.
    flags = __future__.annotations.compiler_flag
    code = compile(source.read_text(encoding="utf-8"), MODULE, "exec", flags=flags, dont_inherit=True, optimize=2)
    made.write_bytes(marshal.dumps(code))


def classes() -> Mapping[str, Any]:
    """Return the class of each message of the dialect by its name, in the order of the ids."""
    kinds = load().mavlink_map
    return MappingProxyType({kinds[number].msgname: kinds[number] for number in sorted(kinds)})


def message_id(name: str) -> int:
    """Return the id of the message called `name` ("HEARTBEAT"). Raises LinkError if there is none."""
    found = getattr(load(), f"MAVLINK_MSG_ID_{name}", -1)
    if found < 0:
        raise LinkError(f"no message {shown(name)}", "MAVLink dialect", f"choose one of {listed(classes(), 200)}")
    return int(found)
