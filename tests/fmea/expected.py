"""What each row of the hazard analysis is expected to do, one line a row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Expected:
    """`action` or a stronger one within `within` ms, in each situation; without one the rig stays safe by itself.

    `why` says why motors may be on for longer at a stop than the rule has it; `rarely` that it takes hundreds of seeds.
    """

    action: str = ""
    within: int = 0
    why: str = ""
    rarely: bool = False


SAFE = Expected()

EXPECTED: Mapping[str, Expected] = {}
