"""Shared objects for this computer, loaded into this process."""
