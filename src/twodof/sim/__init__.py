"""The only place where a rig meets a flight controller; owns simulated time."""
