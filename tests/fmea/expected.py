"""What each row of the hazard analysis is expected to do, one line a row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Expected:
    """`action` within `within` ms, or none where the rig stays off its stops by itself, or `why` neither can be had."""

    action: str = ""
    within: int = 0
    why: str = ""


SAFE = Expected()

EXPECTED: Mapping[str, Expected] = {}
