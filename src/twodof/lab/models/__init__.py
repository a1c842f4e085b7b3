"""Identified models that the user keeps, and which of them guards the tuning of which drone."""
