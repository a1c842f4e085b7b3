"""MAVLink's microservices as PX4 gives them, one a file: each translates messages and decides nothing."""
