"""How states change in C: at the end of a tick, by integration, and in state machines."""
