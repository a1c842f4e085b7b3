"""The descriptions of events keep libevents' rules (schema version 2), and read back what the table sends.

The rules are stated again here, from `validation/schema.json` and `scripts/validate.py` of mavlink/libevents.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyulog.libevents_parse.parser import Parser

from twodof.errors import LinkError
from twodof.fcu.px4_compat.event_definitions import definitions
from twodof.fcu.px4_compat.event_enumerations import ABOUT, COMPONENT_INDEX, ENUMERATIONS, OBSTACLES
from twodof.fcu.px4_compat.event_table import CHECKS, DENIED, EVENTS, MOST_BYTES, EventType
from twodof.flight.failsafe.causes_and_actions import ACTIONS, CAUSES
from twodof.link.mavlink.modes import MODES

WIDTHS = {"uint8_t": 1, "uint16_t": 2, "uint32_t": 4}
GIVEN = json.loads(definitions())
COMPONENT = GIVEN["components"]["1"]
DESCRIBED: dict[int, tuple[str, dict[str, Any]]] = {
    int(number): (group, event)
    for group, found in COMPONENT["event_groups"].items()
    for number, event in found["events"].items()
}


def test_the_file_has_the_parts_of_the_schema() -> None:
    assert GIVEN.keys() == {"version", "components"}
    assert GIVEN["version"] == 2
    parts = {"namespace", "enums", "event_groups", "supported_protocols", "navigation_mode_groups"}
    assert COMPONENT.keys() == parts
    assert re.fullmatch(r"[a-z][a-z0-9_]*", COMPONENT["namespace"])
    for name, one in COMPONENT["enums"].items():
        assert re.fullmatch(r"[a-zA-Z][a-zA-Z0-9_]*_t", name)
        assert one.keys() <= {"type", "description", "is_bitfield", "separator", "entries"}
        assert "\n" not in one["description"]
        for value, entry in one["entries"].items():
            assert re.fullmatch(r"[0-9]+", value)
            assert int(value) < 1 << 8 * WIDTHS[one["type"]]
            assert entry.keys() == {"name", "description"}
            assert re.fullmatch(r"[a-z][a-z0-9_]*", entry["name"])
            assert re.fullmatch(r"[^\n]+", entry["description"])


@pytest.mark.parametrize("number", DESCRIBED)
def test_an_event_keeps_the_rules_of_its_group(number: int) -> None:
    group, event = DESCRIBED[number]
    assert event.keys() <= {"name", "message", "description", "type", "arguments"}
    assert re.fullmatch(r"[a-zA-Z][a-zA-Z0-9_]*", event["name"])
    assert re.fullmatch(r"[^\n]{1,120}", event["message"])
    assert 0 <= number < 1 << 24
    arguments = event.get("arguments", [])
    kinds = [COMPONENT["enums"].get(one["type"], one)["type"] for one in arguments]
    assert sum(WIDTHS[kind] for kind in kinds) <= MOST_BYTES
    for text in (event["message"], event.get("description", "")):
        assert not re.search(r"[<>\\]|https?://", text)
        used = [int(place) for place in re.findall(r"\{(\d+)\}", text)]
        assert len(re.findall(r"[{}]", text)) == 2 * len(used)
        assert all(1 <= place <= len(arguments) for place in used)
    named = [(one["name"], one["type"]) for one in arguments]
    modes, component = "navigation_mode_group_t", "health_component_t"
    if event.get("type") == "summary":
        counted = [("chunk_idx", "uint8_t")]
        if group == "arming_check":
            parts = [("error", component), ("warning", component), ("can_arm", modes), ("can_run", modes)]
        else:
            parts = [("is_present", component), ("error", component), ("warning", component)]
        assert named == counted + parts
    elif group != "default":
        assert named == [("modes", modes), ("health_component_index", "uint8_t")]


def test_no_number_and_no_name_is_there_twice() -> None:
    assert max(Counter(event.number for event in EVENTS).values()) == 1
    assert max(Counter(event.name for event in EVENTS).values()) == 1
    assert DESCRIBED.keys() == {event.number for event in EVENTS}


def test_causes_actions_and_modes_are_those_that_fly() -> None:
    enums = COMPONENT["enums"]
    assert [entry["name"] for entry in enums["cause_t"]["entries"].values()] == [cause.name for cause in CAUSES]
    assert [*enums["cause_t"]["entries"]] == [str(1 << place) for place in range(len(CAUSES))]
    assert [entry["name"] for entry in enums["action_t"]["entries"].values()] == [*ACTIONS]
    assert {int(value): entry["name"] for value, entry in enums["mode_t"]["entries"].items()} == {
        mode.custom_mode: mode.name for mode in MODES
    }
    groups = COMPONENT["navigation_mode_groups"]["groups"]
    names = enums["navigation_mode_group_t"]["entries"]
    assert {names[str(1 << int(place))]["name"]: modes for place, modes in groups.items()} == {
        mode.name: [mode.custom_mode] for mode in MODES
    }


def test_every_cause_and_obstacle_has_a_check_about_a_component() -> None:
    names = {*(cause.name for cause in CAUSES), *(one.name for one in OBSTACLES)}
    assert CHECKS.keys() == names
    assert ABOUT.keys() == names
    first, *_ = COMPONENT["enums"]["health_component_t"]["entries"].items()
    assert first == ("1", {"name": "none", "description": "None"})  # the protocol asks for this
    assert {COMPONENT_INDEX[component] for component in ABOUT.values()} <= {*range(32)}


@settings(max_examples=40)
@given(event=st.sampled_from(EVENTS), data=st.data())
def test_what_is_sent_is_read_back_by_another_parser(event: EventType, data: st.DataObject) -> None:
    values = []
    for argument in event.arguments:
        found = ENUMERATIONS.get(argument.kind)
        width = WIDTHS[argument.kind if found is None else found.kind]
        some = st.integers(0, (1 << 8 * width) - 1)
        if found is not None and not found.bits:
            some = st.sampled_from([value for value, _, _ in found.entries])
        elif found is not None:
            picked = data.draw(st.sets(st.sampled_from([value for value, _, _ in found.entries])))
            some = st.just(sum(picked))
        values.append(data.draw(some))
    parser = Parser()
    parser.load_definitions(json.loads(definitions()))
    parsed = parser.parse(event.id, event.pack(*values).ljust(40, b"\0"))
    assert parsed is not None
    assert (parsed.name(), parsed.group(), parsed.type()) == (event.name, event.group, event.kind)
    assert [parsed.argument_value(place) for place in range(parsed.num_arguments())] == values
    assert "unknown" not in parsed.message()
    for place, argument in enumerate(event.arguments):
        found = ENUMERATIONS.get(argument.kind)
        if found is not None and found.bits and f"{{{place + 1}}}" in event.message:
            texts = [text for value, _, text in found.entries if values[place] & value]
            assert "; ".join(texts) in parsed.message()


def test_arguments_that_are_not_the_events_are_refused() -> None:
    with pytest.raises(LinkError, match="arming_denied"):
        DENIED.pack()
    with pytest.raises(LinkError, match="arming_denied"):
        DENIED.pack(1 << 32)
