"""Flash from the Diagram page: a changed controller is rehearsed, sent to the drone, and flies."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

from tests.patience import PATIENCE_S
from tests.web.conftest import OpenPage, picture
from tests.web.lab_server import LabServer
from tests.web.pilot import flies_to, flying, press

pytestmark = pytest.mark.slow

LONG_MS = PATIENCE_S * 1000


@pytest.mark.long
@pytest.mark.waits
def test_a_changed_controller_is_flashed_and_flies(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(f"{lab_server.link}#/diagram")
    expect(page.get_by_text(re.compile(r"imulated in [\d.]+ m?s"))).to_be_visible(timeout=LONG_MS)
    gain = page.get_by_label("theta_kp", exact=True)
    gain.fill(str(0.9 * float(gain.input_value())))
    gain.press("Enter")
    expect(page.get_by_text("It compiles")).to_be_visible()
    page.get_by_role("button", name=re.compile("^Save…")).click()
    page.get_by_label("Name", exact=True).last.fill("My pid 2")
    expect(page.get_by_text("On the drone its name is My_pid_2")).to_be_visible()
    page.get_by_role("button", name="Save", exact=True).click()
    expect(page.get_by_text("My pid 2 is saved")).to_be_visible()
    page.get_by_role("button", name="Flash…").click()
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_text("no swing grows")).to_be_visible(timeout=LONG_MS)
    expect(dialog.get_by_text("What changes against")).to_be_visible()
    expect(dialog.get_by_role("row", name="0.00054 s²/rad, 0 to 0.05")).to_be_visible()
    dialog.get_by_text(re.compile(r"Blocks and wires: \d+ changes")).click()
    expect(dialog.get_by_role("listitem").filter(has_text=re.compile("added.*block pid"))).to_be_visible()
    assert "pid" not in lab_server.state["controller"], "a rehearsal changes nothing on the drone"
    dialog.get_by_role("button", name=re.compile("Flash to drone")).click()
    expect(dialog).to_be_hidden(timeout=LONG_MS)
    page.get_by_role("link", name="Tune", exact=True).click()
    expect(page.get_by_label("q_n [rad/s]", exact=True)).to_have_value("100")
    expect(page.get_by_text("1 to 1000 rad/s")).to_be_visible()
    expect(page.get_by_label("rate_limit.high, slider")).to_be_attached()
    picture(page, "tune-own-diagram")
    page.get_by_role("link", name="Fly", exact=True).click()
    expect(page.locator("dd", has_text="My_pid_2")).to_be_visible()
    flying(page)
    flies_to(page, press(page, "\u22120.10"), "Position x", -0.1, 0.02)
    page.get_by_role("button", name="Disarm").click()
    lab_server.until(armed=False)
    assert "My_pid_2" in lab_server.state["controller"]
    page.get_by_role("link", name="Logs", exact=True).click()
    expect(page.get_by_role("link", name=re.compile("drone")).first).to_be_visible()
    page.get_by_role("link", name="Fly", exact=True).click()
    page.get_by_role("link", name="Tune or replace it").click()
    page.get_by_role("link", name="Back to the stock controller").click()
    expect(page.get_by_role("heading", name="Diagram stock_attitude")).to_be_attached()
    expect(page.get_by_text("It compiles")).to_be_visible()
    page.get_by_role("button", name="Flash…").click()
    expect(dialog.get_by_text("no swing grows")).to_be_visible(timeout=LONG_MS)
    dialog.get_by_role("button", name=re.compile("Flash to drone")).click()
    lab_server.until(controller="stock")
