"""Numbers of MAVLink's enumerations that several rooms use, by the dialect's own names; components by number."""

from enum import IntEnum

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
    """MAV_RESULT: how a command was answered."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5


class MavSeverity(IntEnum):
    """MAV_SEVERITY: how urgent a text is, as in syslog."""

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
