"""From a diagram to an external module for PX4, and whether a PX4 fits it. See docs/explanation/targets.md."""

from twodof.compile.px4.check import Finding, Findings, check
from twodof.compile.px4.export import Module, export, make_module

__all__ = ["Finding", "Findings", "Module", "check", "export", "make_module"]
