"""One conversation with a drone over MAVLink: session, commands, lease, clock, files, logs."""
