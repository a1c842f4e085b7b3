"""Who may command, and what the flight code is asked to fly."""
