"""External modules for PX4 from diagrams, and their check against a checkout of PX4.

See docs/explanation/targets.md.
"""

from twodof.compile.px4.export import Px4Module, export, make_module
from twodof.compile.px4.tree import CheckoutFinding, CheckoutFindings, check

__all__ = ["CheckoutFinding", "CheckoutFindings", "Px4Module", "check", "export", "make_module"]
