"""The numbers that the rooms share: those of the dialect."""

import pytest

from twodof.link.mavlink import dialect
from twodof.link.mavlink.enums import MavCmd, MavResult, MavSeverity

ENUMS = {"MAV_CMD": MavCmd, "MAV_RESULT": MavResult, "MAV_SEVERITY": MavSeverity}


@pytest.mark.parametrize("prefix", ENUMS)
def test_they_are_the_dialects(prefix: str) -> None:
    for member in ENUMS[prefix]:
        assert getattr(dialect.load(), f"{prefix}_{member.name}") == member
