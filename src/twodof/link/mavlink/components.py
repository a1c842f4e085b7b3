"""Components of a MAVLink system that are talked to by number (MAV_COMPONENT), and how those that do not fly say so."""

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
