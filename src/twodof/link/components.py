"""Components of a MAVLink system that are talked to by number (MAV_COMPONENT)."""

AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1: the flight controller."""
GROUND_STATION = 190
"""MAV_COMP_ID_MISSIONPLANNER: a client on the ground."""
COMPANION = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER: the companion."""
