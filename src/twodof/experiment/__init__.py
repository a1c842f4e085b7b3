"""Experiments: protocols that excite a rig whose flight controller runs a diagram, and the flights they make."""
