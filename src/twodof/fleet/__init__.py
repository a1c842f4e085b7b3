"""Drones on this computer: started, supervised, found, given controllers and ended."""

from twodof.fleet.virtual_drone import virtual_drone, virtual_drones

__all__ = ["virtual_drone", "virtual_drones"]
