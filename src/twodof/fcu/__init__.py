"""The flight controller's program: the compiled flight code behind a Hardware protocol, spoken to over MAVLink."""
