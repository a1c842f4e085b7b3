"""Drones on this computer: started, supervised, found, given controllers and ended."""

from twodof.fleet.virtual_drone import virtual_drone

__all__ = ["virtual_drone"]
