"""The first hour of a user with the page alone: fly, tune, identify, draw and flash a controller."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import Page, expect

from tests.patience import PATIENCE_S
from tests.web.conftest import OpenPage
from tests.web.lab_server import LabServer
from tests.web.pilot import flies_to, flying, press

pytestmark = pytest.mark.slow

FLIGHTS_S, MOST_TRIES = 50.0, 3
"""An impulse and a doublet with their holds [s]; how often the page flies what a gust ended early."""
MOST_RUNS = 5
"""The failsafe ends a flight whose pilot's computer stands still: who sees that begins again."""


def to(page: Page, name: str) -> None:
    """Goes to another page by the links at the top."""
    page.get_by_role("link", name=name, exact=True).click()


def step(page: Page, metres: str) -> None:
    """A step of the position by its button, seen to be answered."""
    flies_to(page, press(page, metres), "Position x", float(metres.replace("\u2212", "-")), 0.02)


def disarm(page: Page) -> None:
    page.get_by_role("button", name="Disarm").click()
    expect(page.get_by_role("button", name="Arm", exact=True)).to_be_enabled()


@pytest.mark.waits
def test_a_first_hour_with_the_page(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link)
    page.context.set_default_timeout(PATIENCE_S * 1000)

    # Fly: what the page says is enough to get a first step, and its figures.
    flying(page)
    step(page, "0.10")
    step(page, "\u22120.10")
    steps = page.get_by_role("table", name="Steps as they are flown")
    expect(steps).to_contain_text(re.compile(r"x\s+0\.1\S*\s+→\s+\S0\.1"))
    disarm(page)

    # Tune: a gain, sent and seen by the drone.
    to(page, "Tune")
    gain = page.get_by_role("textbox", name=re.compile("^RATE_KP"))
    gain.fill(f"{0.9 * float(gain.input_value()):.4f}")
    gain.press("Enter")
    page.get_by_role("button", name="Send 1 change").click()
    lab_server.until(changed_parameters=1)

    # Identify: the paper's two flights of the pitch in real time, their fit, and the model kept.
    to(page, "Identify")
    run = page.get_by_role("button", name="Whole pitch run")
    estimate = page.get_by_role("row", name=re.compile(r"^mu\b.* [1-9]\d\d\.\d"))
    for _ in range(MOST_RUNS):
        run.click()
        expect(run).to_be_disabled()
        expect(run).to_be_enabled(timeout=1000 * (PATIENCE_S + MOST_TRIES * FLIGHTS_S))
        if estimate.is_visible():
            break
    expect(estimate).to_be_visible()
    page.get_by_role("button", name="Keep it").click()
    page.get_by_role("tab", name="Models and design").click()
    expect(page.get_by_role("table", name="Models that are kept")).to_contain_text("doublet")

    # Draw: the controller to begin with, one gain changed.
    to(page, "Diagram")
    expect(page.get_by_text(re.compile(r"lown in \d+ ms"))).to_be_visible(timeout=PATIENCE_S * 1000)
    gain = page.get_by_label("theta_kp", exact=True)
    gain.fill(str(0.9 * float(gain.input_value())))
    gain.press("Enter")
    expect(page.get_by_text("It compiles")).to_be_visible()

    # Flash it: what it would do, and what it changes, is said before.
    page.get_by_role("button", name="Flash…").click()
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_text("no swing grows")).to_be_visible(timeout=PATIENCE_S * 1000)
    expect(dialog.get_by_text("What changes against")).to_be_visible()
    expect(dialog.get_by_role("listitem").filter(has_text=re.compile("added.*block pid"))).to_be_visible()
    assert "pid" not in lab_server.state["controller"], "a rehearsal changes nothing on the drone"
    dialog.get_by_role("button", name=re.compile("Flash to drone")).click()
    expect(dialog).to_be_hidden(timeout=PATIENCE_S * 1000)

    # Fly it: the cart, which the run of the pitch has locked, is freed by a reset.
    to(page, "Fly")
    expect(page.locator("dd", has_text="pid")).to_be_visible()
    page.get_by_role("button", name="Reset…").click()
    dialog = page.get_by_role("dialog")
    if dialog.get_by_role("switch", name="Rings").get_attribute("aria-checked") == "true":
        dialog.get_by_role("switch", name="Rings").click()
    dialog.get_by_role("button", name="Reset").click()
    expect(dialog).to_be_hidden()
    expect(page.get_by_text("free, the cart slides")).to_be_visible()
    flying(page)
    step(page, "\u22120.10")
    disarm(page)
    assert "pid" in lab_server.state["controller"]
    # What was flown is kept.
    to(page, "Logs")
    expect(page.get_by_role("link", name=re.compile("drone")).first).to_be_visible()
