"""Promises by flight: members of an identified family, flown side by side on the virtual rig before the drone flies."""
