"""The ports of drone 0, as PX4 in simulation has them; drone i has the i-th after each, except GROUND_STATION.

The UDP ports are those of PX4 v1.16 (ROMFS/px4fmu_common/init.d-posix/px4-rc.mavlink). Ground programs look for a
simulated drone at TCP 5760, where ArduPilot's listens. The flight controller's port is our own.
"""

ONBOARD = 14540
"""UDP: where the companion sends to, for clients on board and for MAVSDK."""
GROUND_STATION = 14550
"""UDP: where the companions of all drones send to, QGroundControl's."""
COMPANION_ONBOARD = 14580
"""UDP: where the companion sends from and listens, for clients on board."""
COMPANION_GROUND = 18570
"""UDP: where it does so for ground stations."""
COMPANION_TCP = 5760
"""TCP: where the companion listens."""
FLIGHT_CONTROLLER = 5790
"""TCP: where the flight controller listens, for its companion."""
