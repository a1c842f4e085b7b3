"""Drones on this computer: start, supervise, find, flash and end them."""

from twodof.fleet.virtual_drone import virtual_drone, virtual_drones

__all__ = ["virtual_drone", "virtual_drones"]
