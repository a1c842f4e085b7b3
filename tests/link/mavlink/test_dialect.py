"""The dialect: the same numbers as MAVLink's own, generated once, loaded fast, in every state of the cache."""

import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from enum import IntEnum
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from tests.patience import PATIENCE_S
from twodof.errors import LinkError, RefusalReason
from twodof.fcu.command import excitation_player
from twodof.flight.failsafe.causes_and_actions import ACTIONS, BIT, CAUSES
from twodof.link.mavlink import dialect
from twodof.link.mavlink.dialect import GROUND, ONBOARD, RATES, MavCmd, MavResult, MavSeverity
from twodof.signals import TOPICS

pytestmark = pytest.mark.slow

# Messages that the dialects in pymavlink's wheel lack (it leaves out those marked unfinished): number and CRC_EXTRA of
# MAVLink's own common.h. The second is a checksum over name, types and names of the fields, and lengths of the arrays.
PUBLISHED = {
    "PROTOCOL_VERSION": (300, 217),
    "ESC_INFO": (290, 251),
    "COMPONENT_METADATA": (397, 182),
    "ESC_STATUS": (291, 10),
    "AVAILABLE_MODES": (435, 134),
    "CURRENT_MODE": (436, 193),
    "AVAILABLE_MODES_MONITOR": (437, 30),
}


def test_every_message_of_common_is_common_s_own() -> None:
    ours, compared = dialect.load().mavlink_map, 0
    for number, theirs in common.mavlink_map.items():
        mine = ours.get(number)
        if mine is None:
            continue
        assert (mine.msgname, mine.crc_extra) == (theirs.msgname, theirs.crc_extra)
        # An older wheel may lack the last extension fields, which an old receiver cuts off and an old sender leaves 0.
        for what in ("fieldnames", "fieldtypes", "ordered_fieldnames", "array_lengths"):
            assert getattr(mine, what)[: len(theirs.fieldnames)] == getattr(theirs, what), (mine.msgname, what)
        assert mine.unpacker.format.startswith(theirs.unpacker.format)
        shared = mine.fieldunits_by_name.keys() & theirs.fieldunits_by_name.keys()
        assert all(mine.fieldunits_by_name[unit] == theirs.fieldunits_by_name[unit] for unit in shared)
        compared += 1
    own = [n for n in ours if dialect.FIRST_OWN_ID <= n <= dialect.LAST_OWN_ID]
    lacking = set(ours) - set(common.mavlink_map) - set(own)
    assert compared == len(ours) - len(own) - len(lacking)
    assert {ours[n].msgname for n in lacking} <= {*PUBLISHED}, "messages that nothing compares"
    assert compared > 80


@pytest.mark.parametrize("name", PUBLISHED)
def test_what_the_wheel_may_lack_has_the_published_numbers(name: str) -> None:
    number, crc_extra = PUBLISHED[name]
    kind = dialect.load().mavlink_map[number]
    assert (kind.msgname, kind.crc_extra) == (name, crc_extra)


def test_every_constant_of_common_has_common_s_value() -> None:
    ours = dialect.load()
    compared = 0
    for name, enum in ours.enums.items():
        if name.startswith("TWODOF_"):
            continue
        for value, entry in enum.items():
            theirs = getattr(common, entry.name, None)
            if theirs is None or entry.name.endswith("_ENUM_END"):
                continue
            assert theirs == value, entry.name
            compared += 1
    assert compared > 350


@pytest.mark.parametrize("ours", [MavCmd, MavResult, MavSeverity])
def test_our_enumerations_have_the_dialects_numbers(ours: type[IntEnum]) -> None:
    prefix = {MavCmd: "MAV_CMD", MavResult: "MAV_RESULT", MavSeverity: "MAV_SEVERITY"}[ours]
    for member in ours:
        assert getattr(dialect.load(), f"{prefix}_{member.name}") == member


def test_rates_name_messages_and_a_slow_link_gets_no_more() -> None:
    known = dialect.load().mavlink_map
    assert {row.number: row.name for row in RATES} == {row.number: known[row.number].msgname for row in RATES}
    assert len({row.number for row in RATES}) == len(RATES)
    assert all(rate <= ONBOARD[number] for number, rate in GROUND.items())


def spelled(enum: str) -> dict[str, int]:
    """An enumeration of ours: the names behind its own, in small letters, and their values."""
    entries = dialect.load().enums[enum].items()
    return {one.name.removeprefix(f"{enum}_").lower(): value for value, one in entries if "ENUM_END" not in one.name}


def test_the_failsafes_words_are_in_the_dialect() -> None:
    assert spelled("TWODOF_CAUSE") == dict(BIT)
    said = dialect.load().enums["TWODOF_CAUSE"]
    assert {cause.name: said[BIT[cause.name]].description for cause in CAUSES} == {c.name: c.text for c in CAUSES}
    assert spelled("TWODOF_ACTION") == {name: place for place, name in enumerate(ACTIONS)}


def test_the_words_of_excitations_are_in_the_dialect() -> None:
    names = ("IDLE", "RECEIVING", "READY", "PLAYING", "DONE", "STOPPED", "REFUSED")
    assert spelled("TWODOF_EXCITE_STATE") == {name.lower(): getattr(excitation_player, name) for name in names}
    assert spelled("TWODOF_LOOP") == {
        one.name.removesuffix("_open").removesuffix("0").lower(): place
        for place, one in enumerate(excitation_player.LOOPS)
    }


def test_reasons_of_refusals_are_in_the_dialect() -> None:
    assert spelled("TWODOF_REFUSAL") == {reason.name.lower(): reason for reason in RefusalReason}


def test_topics_name_messages_that_there_are() -> None:
    known = dialect.classes()
    assert [row.mavlink for row in TOPICS if row.mavlink not in known] == []


def test_our_own_messages_and_their_fields_are_described() -> None:
    root = ET.parse(Path(dialect.__file__).with_name("dialect.xml")).getroot()
    for entry in root.iter("message"):
        assert dialect.FIRST_OWN_ID <= int(entry.get("id", "0")) <= dialect.LAST_OWN_ID
        assert (entry.findtext("description") or "").strip()
        assert all((field.text or "").strip() for field in entry.iter("field")), entry.get("name")


def test_the_page_lists_every_one_of_our_messages() -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "reference" / "protocol.md").read_text()
    own = [kind.msgname for number, kind in dialect.load().mavlink_map.items() if number >= dialect.FIRST_OWN_ID]
    assert [name for name in own if f"`{name}`" not in page] == []


def test_no_message_is_unknown_without_saying_what_there_is() -> None:
    with pytest.raises(LinkError, match=r"no message 'ATITUDE'.*ATTITUDE"):
        dialect.message_id("ATITUDE")


FILES = {name: Path(dialect.__file__).with_name(name).read_text() for name in dialect.FILES}
LOAD = "from twodof.link.mavlink import dialect; print(dialect.load().MAVLINK_MSG_ID_TWODOF_TICK)"


def test_processes_may_generate_at_once(tmp_path: Path) -> None:
    environment = {**os.environ, "TWODOF_CACHE": str(tmp_path)}
    command = [sys.executable, "-W", "error", "-c", LOAD]
    started = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    try:
        assert [process.communicate(timeout=PATIENCE_S)[0] for process in started] == ["54208\n"] * 2
    finally:
        for process in started:
            process.kill()
            process.wait(timeout=PATIENCE_S)
    assert len([*tmp_path.iterdir()]) == 1  # one entry, nothing half made


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The entry of a cache, generated once."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TWODOF_CACHE", str(folder))
        dialect.build(FILES)
    (entry,) = folder.iterdir()
    return entry


@pytest.fixture
def entry(generated: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The only entry of the cache in use, as it was generated."""
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path))
    return Path(shutil.copy2(generated, tmp_path))


def test_damaged_entry_is_made_again(entry: Path) -> None:
    whole = entry.read_bytes()
    for damaged in (whole[:-100], b"none of Python's"):
        entry.write_bytes(damaged)
        assert dialect.build(FILES).MAVLINK_MSG_ID_TWODOF_TICK == 54208
        assert entry.read_bytes() == whole


def test_a_cache_that_cannot_be_written_is_done_without(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path / "file" / "cache"))
    assert dialect.build(FILES).MAVLINK_MSG_ID_TWODOF_TICK == 54208


def test_another_definition_is_another_entry(entry: Path) -> None:
    kept = entry.read_bytes()
    changed = {**FILES, "dialect.xml": FILES["dialect.xml"].replace("TWODOF_TICK", "TWODOF_TOCK")}
    assert dialect.build(changed).MAVLINK_MSG_ID_TWODOF_TOCK == 54208
    assert len([*entry.parent.iterdir()]) == 2
    assert entry.read_bytes() == kept


def test_a_generator_that_refuses_says_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path))
    with pytest.raises(LinkError, match="unknown type 'uint9_t'"):
        dialect.build({**FILES, "dialect.xml": FILES["dialect.xml"].replace("uint32_t", "uint9_t")})
