"""Simulation of a rig together with its flight controller; this package owns simulated time."""
