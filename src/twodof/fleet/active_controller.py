"""What flies on a drone, in words: somebody else may have left a controller there, or other parameters."""

from __future__ import annotations

from twodof.errors import printable

STOCK = "stock"
FLIES = "flies "


def controller_in_words(controller: str, changed: int) -> str:
    """`flies my_attitude; 3 parameters differ from their defaults`; `controller` as TWODOF_RIG names it."""
    what = "the stock controllers" if controller == STOCK else printable(controller)
    if not changed:
        return f"{FLIES}{what}; all parameters are at their defaults"
    differ = (
        "1 parameter differs from its default" if changed == 1 else f"{changed} parameters differ from their defaults"
    )
    return f"{FLIES}{what}; {differ}"
