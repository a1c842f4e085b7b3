"""The MAVLink services of the flight controller."""
