"""Commands that start a drone, find one or talk to one."""
