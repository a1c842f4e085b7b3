"""The reference interpreter, which judges every compiled target."""

from twodof.blocks.reference.interpreter import Reference, ReferenceMachine

__all__ = ["Reference", "ReferenceMachine"]
