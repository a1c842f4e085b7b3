"""The companion computer: passes MAVLink between the flight controller and several clients, and runs a user's app."""
