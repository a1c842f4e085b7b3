"""From a diagram to an external module for PX4, and whether a PX4 fits it. See docs/explanation/targets.md."""

from twodof.compile.px4.checkout import CheckoutFinding, CheckoutFindings, check
from twodof.compile.px4.export import Px4Module, export, make_module

__all__ = ["CheckoutFinding", "CheckoutFindings", "Px4Module", "check", "export", "make_module"]
