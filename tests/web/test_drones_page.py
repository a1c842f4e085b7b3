"""The page of all drones: each is seen, led to and stopped there."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

from tests.patience import patiently
from tests.web.conftest import OpenPage, readable
from tests.web.lab_server import LabServer

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_drone_is_stopped_from_the_list(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(f"{lab_server.link}#/drones", size="tablet")
    card = page.get_by_role("listitem").filter(has=page.get_by_role("link", name=f"Drone {lab_server.drone}"))
    expect(card.get_by_role("listitem").filter(has_text=re.compile(r"estimate\s+.?\d\.\d{3} deg"))).to_be_visible()
    expect(card.get_by_text("Disarmed")).to_be_visible()
    readable(page, "drones")
    card.get_by_role("button", name="STOP").click()
    lab_server.until(killed=True)
    expect(card.get_by_text("Stopped")).to_be_visible()
    page.get_by_role("button", name="Release all").click()
    lab_server.until(killed=False)
    expect(page.get_by_role("button", name="Release all")).to_have_count(0)
    lab_server.tell("reset", {"seed": 5, "rings": True})
    lab_server.until(warnings=[])
    lab_server.tell("arm")
    again = page.get_by_role("button", name="Reset all")
    expect(again).to_be_disabled()
    lab_server.tell("disarm")
    flown = lab_server.state["time"]
    again.click()
    expect(page.get_by_text(f"Reset drone {lab_server.drone}: at rest in the middle of the rail")).to_be_visible()
    for _ in patiently():
        if lab_server.state["time"] < flown:
            break
    assert (lab_server.state["seed"], lab_server.state["rings_locked"]) == (5, True)
    card.get_by_role("button", name="STOP").click()
    lab_server.until(killed=True)
    card.get_by_role("link").click()
    expect(page.get_by_role("button", name="Release the stop")).to_be_visible()
