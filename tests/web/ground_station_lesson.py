"""The lesson of docs/tutorials/ground-station.md, as its reader does it in the page; who runs it takes its pictures."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

from playwright.sync_api import Page, expect

from tests.patience import PATIENCE_S
from tests.web.pilot import flown, press

Take = Callable[[str], None]
"""Takes a picture of the page under a name."""
# What is previewed or read first starts a process, and compiles: on a loaded machine that takes longer than a page.
LONG_MS = 1000.0 * PATIENCE_S
STANDS_S = 4.0
"""How long the lesson has the cart move and stand."""

FIGURES = re.compile(r"\d\.\d{3}\s*\d+\.\d")


def run(page: Page, take: Take) -> None:
    """All of it, from the Fly page of a drone that stands at its start."""
    _build_an_excitation(page, take)
    _fly(page, take)
    _look_at_the_log(page, take)


def _build_an_excitation(page: Page, take: Take) -> None:
    page.get_by_role("button", name="Build one").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Added to the set-point of").select_option("x")
    dialog.get_by_label("Kind").select_option("impulse")
    for label, value in (("Amplitude", "0.1"), ("Width", "2"), ("Rest before", "0")):
        dialog.get_by_label(label).fill(value)
    expect(dialog.get_by_text("of 0.40 m")).to_be_visible(timeout=LONG_MS)
    take("excitation")
    dialog.get_by_role("button", name="Use this one").click()


def _fly(page: Page, take: Take) -> None:
    page.get_by_role("button", name="Arm", exact=True).click()
    expect(page.get_by_role("button", name="Disarm")).to_be_enabled()
    page.get_by_role("tab", name="Position").click()
    listed = page.get_by_role("table", name="Steps as they are flown").get_by_role("row")
    rows = [listed.filter(has_text=step).last for step in ("0.00 → 0.10", "0.10 → 0.00")]
    for _ in range(3):  # on a busy computer the failsafe may cut a step
        for place in ("0.00", "0.10", "0.00"):
            page.get_by_role("button", name=place, exact=True).click()
            time.sleep(STANDS_S)
        if all(row.count() and FIGURES.search(row.inner_text()) for row in rows):
            break
    for row in rows:
        expect(row).to_contain_text(FIGURES)
    take("fly")
    flown(page, press(page, "Start"), page.get_by_role("button", name="Stop it").is_visible)
    time.sleep(STANDS_S)
    page.get_by_role("button", name="Disarm").click()
    expect(page.get_by_role("button", name="Arm", exact=True)).to_be_enabled()


def _look_at_the_log(page: Page, take: Take) -> None:
    page.get_by_role("link", name="Logs", exact=True).click()
    expect(page.get_by_role("img", name="estimated").first).to_be_visible(timeout=LONG_MS)
    expect(page.get_by_label("Close this message")).to_have_count(0)
    take("logs")
    page.locator("main li a").first.click()
    expect(page.get_by_role("button", name="Play")).to_be_enabled(timeout=LONG_MS)
    page.get_by_role("button", name="Go to").first.click()
    steps = page.get_by_role("table", name="Steps of the set-point")
    assert steps.evaluate("one => one.scrollWidth - one.parentElement.clientWidth") <= 0, "columns are cut"
    page.get_by_label("Notes").fill("My first flight from the page.")
    page.get_by_role("button", name="Save notes").click()
    expect(page.get_by_text("Saved beside the log")).to_be_visible()
    page.locator("main h1").scroll_into_view_if_needed()
    take("replay")
    page.get_by_role("button", name="Play").click()
    expect(page.get_by_role("button", name="Pause")).to_be_visible()
