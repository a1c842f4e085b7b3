"""The control loop: flight code, sandbox, hardware, timing and watchdog."""
