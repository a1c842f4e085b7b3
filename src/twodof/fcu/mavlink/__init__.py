"""The MAVLink services that our own protocol needs."""
