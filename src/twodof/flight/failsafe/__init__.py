"""The failsafe: thresholds, timers, a state machine, and the gate that selects the commands for the motors."""
