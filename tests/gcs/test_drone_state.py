"""The failsafe in words: every act and every cause of the flight code is explained by the dialect."""

import pytest

from twodof.flight.failsafe.causes_and_actions import ACTIONS
from twodof.gcs.drone_state import SafetyState, explanation_of, names_of
from twodof.link.mavlink import dialect

CAUSES = [
    name.removeprefix("TWODOF_CAUSE_").lower()
    for row in dialect.load().enums["TWODOF_CAUSE"].values()
    if not (name := str(row.name)).endswith("ENUM_END")
]


@pytest.mark.parametrize("cause", CAUSES)
def test_every_cause_is_explained(cause: str) -> None:
    words = SafetyState("descend", cause).in_words()
    assert words.startswith("descend (level, the thrust fades to 0, then off): ")
    assert len(words.partition("): ")[2]) > 15
    assert cause not in words


def test_there_are_as_many_as_bits() -> None:
    assert names_of("TWODOF_CAUSE", (1 << len(CAUSES)) - 1) == tuple(CAUSES)


def test_every_act_is_explained() -> None:
    assert all(explanation_of("TWODOF_ACTION", action) for action in ACTIONS)


def test_what_has_no_reason_says_nothing_and_what_is_unknown_keeps_its_name() -> None:
    assert SafetyState("off", "").in_words() == ""
    assert SafetyState("none", "link_lost").in_words() == ""
    assert SafetyState("7", "bit 30").in_words() == "7: bit 30"
