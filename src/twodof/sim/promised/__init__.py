"""Promises by simulation: members of an identified family fly on the virtual rig before the drone flies."""
