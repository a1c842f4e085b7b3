"""docs/reference/services.md says what the program answers: every command and message it has, and no other."""

import re
from pathlib import Path

import pytest

from twodof.fcu.assembly import MavlinkServices
from twodof.link.mavlink import dialect
from twodof.sim.virtual_drone import VirtualDrone

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "reference" / "services.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def px4() -> MavlinkServices:
    return VirtualDrone(lockstep=True).assembly.px4


def section(title: str) -> str:
    """The text below a heading."""
    return re.split(r"^## ", PAGE.split(f"## {title}\n")[1], flags=re.MULTILINE)[0]


def test_the_commands_are_those_of_the_page(px4: MavlinkServices) -> None:
    rows = re.findall(r"^\| `(\w+)` \| (\d+) \|", section("Commands"), flags=re.MULTILINE)
    assert sorted(int(number) for _, number in rows) == [*px4.commands.supported]
    names = dialect.load().enums["MAV_CMD"]
    assert [f"MAV_CMD_{name}" for name, _ in rows] == [names[int(number)].name for _, number in rows]


def test_the_messages_that_can_be_asked_for_are_those_of_the_page(px4: MavlinkServices) -> None:
    streams = re.findall(r"^\| `(\w+)` \| (\d+) \|", section("Streams"), flags=re.MULTILINE)
    (request,) = [line for line in section("Commands").splitlines() if "`REQUEST_MESSAGE`" in line]
    more = {int(number) for number in re.findall(r"[A-Z_]+ \((\d+)", request)}
    only = {int(number) for _, number in re.findall(r"`(\w+)` \((\d+)\)", section("Streams"))}
    assert {int(number) for _, number in streams} | more | only == set(px4.requests.supported)
