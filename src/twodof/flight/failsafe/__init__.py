"""The failsafe: thresholds, timers, a state machine, and the last choice of what reaches the motors."""
