"""ULog, the format of PX4's logs: read from PX4, written by the virtual flight controller."""
