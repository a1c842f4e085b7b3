"""The Fly page: arm, fly by set-points, preview an excitation, stop, reset, save."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Locator, expect

from tests.patience import patiently
from tests.web.conftest import OpenPage, axe, looks
from tests.web.lab_server import LabServer
from tests.web.pilot import PRESSED_MS, armed, flies_to, flown, flying, press, reaches
from twodof.flightlog.files import read_log

pytestmark = pytest.mark.slow

STOP = re.compile("^STOP")


def typed(field: Locator, text: str) -> None:
    """Type a number into a field that is disabled while the drone is disarmed."""
    field.fill(text, timeout=PRESSED_MS)
    field.press("Enter", timeout=PRESSED_MS)


@pytest.mark.long
def test_set_points_by_button_slider_key_and_number(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link)
    armed(page)
    page.get_by_role("tab", name="Position").click()
    # An arrow key goes on from where the slider stands.
    expect(page.get_by_role("slider", name="Position x", exact=True)).to_have_value("0")
    flies_to(page, press(page, "0.10"), "Position x", 0.1, 0.02)
    number = page.get_by_label("Position x, number")
    flies_to(page, lambda: typed(number, "-0,05"), "Position x", -0.05, 0.02)  # as a German keyboard writes it
    slider = page.get_by_role("slider", name="Position x", exact=True)
    slider.focus()
    # Its least: what the keyboard gives at once.
    flown(page, lambda: slider.press("Home", timeout=PRESSED_MS), lambda: lab_server.state["mode"] == "offboard")
    slider.press("End")
    flies_to(page, press(page, "0.00"), "Position x", 0.0, 0.02)
    number.fill("0.3")  # typed and left: nothing may jump
    page.get_by_label("Thrust", exact=True).or_(page.get_by_role("tab", name="Position")).first.focus()
    expect(number).to_have_accessible_description(re.compile("Not applied yet: Enter applies it"))
    assert lab_server.state["setpoint"]["value"] == 0.0
    page.get_by_role("button", name="0.00", exact=True).click()
    number.press("Escape")
    expect(number).to_have_value("0")
    number.fill("0.9")
    number.press("Enter")
    expect(page.get_by_text("From \u22120.4 to 0.4 m.")).to_be_visible()
    number.press("Escape")
    page.get_by_role("button", name="Disarm").click()
    expect(page.get_by_role("button", name="Arm", exact=True)).to_be_enabled()
    assert not lab_server.state["armed"]


def test_pitch_is_typed_in_degrees(lab_server: LabServer, open_page: OpenPage) -> None:
    lab_server.calm(rings=True)
    page = open_page(lab_server.link)
    expect(page.get_by_text("locked, the cart stands")).to_be_visible()
    armed(page)
    flies_to(page, lambda: typed(page.get_by_label("Pitch θ, number"), "8"), "Pitch θ", 8.0, 1.5)
    page.get_by_role("tab", name="Velocity").click()
    expect(page.get_by_text("The rings lock the cart")).to_be_visible()
    page.get_by_role("button", name="Hold level").click()
    expect(page.get_by_label("Mode")).to_have_value("hold")
    reaches(page, "Pitch θ", 0.0, 1.5)


@pytest.mark.long
def test_the_stop_works_on_every_page(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link)
    armed(page)
    page.get_by_role("button", name="Build one").click()
    page.get_by_role("dialog").get_by_role("button", name=STOP).click()
    lab_server.until(killed=True, armed=False)
    page.keyboard.press("Escape")
    expect(page.get_by_text("the motors stay off until the stop is released")).to_be_visible()
    page.get_by_role("button", name="Release the stop").click()
    for name in ("Tune", "Diagram", "Identify", "Logs", "Fly"):
        page.get_by_role("link", name=name, exact=True).click()
        expect(page.get_by_role("button", name=STOP)).to_be_enabled()
    armed(page)
    page.get_by_label("Thrust, number").focus()  # also while something is typed
    page.get_by_role("link", name="Logs", exact=True).click()
    page.keyboard.press("F8")
    lab_server.until(killed=True, armed=False)


def test_the_controls_are_where_the_drone_is(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link)
    flying(page)
    flies_to(page, press(page, "0.10"), "Position x", 0.1, 0.03)
    page.get_by_role("link", name="Logs", exact=True).click()
    page.get_by_role("link", name="Fly", exact=True).click()
    expect(page.get_by_role("tab", name="Position")).to_have_attribute("aria-selected", "true")
    expect(page.get_by_label("Position x, number")).to_have_value("0.1")


def test_a_reset_keeps_the_noise(lab_server: LabServer, open_page: OpenPage) -> None:
    lab_server.tell("reset", {"seed": 3, "x": 0.0, "noise": 0.0, "rings": False})
    page = open_page(f"{lab_server.link}#/tune")
    page.get_by_role("button", name="Lock the cart").click()
    lab_server.until(rings_locked=True, noise=0.0, seed=3)
    page.get_by_role("link", name="Fly", exact=True).click()
    page.get_by_role("button", name="Reset…").click()
    expect(page.get_by_label("Noise, 1 is the rig's own")).to_have_value("0")
    page.get_by_role("button", name="Reset", exact=True).click()
    expect(page.get_by_role("dialog")).to_be_hidden()
    assert lab_server.state["noise"] == 0.0


@pytest.mark.parametrize("name", ["fly", "tune"])
def test_a_stop_by_key_keeps_the_focus(lab_server: LabServer, open_page: OpenPage, name: str) -> None:
    page = open_page(f"{lab_server.link}#/{name}")
    release = page.get_by_role("button", name="Release the stop")
    for tabs in (1, 0):  # at Hold level, which the stop switches off; and at Disarm, whose place the release takes
        armed(page)
        for _ in range(tabs):
            page.keyboard.press("Tab")
        page.keyboard.press("F8")
        expect(page.get_by_role("button", name="STOP F8")).to_be_focused()
        page.keyboard.press("Enter")  # one more in alarm releases nothing
        expect(page.get_by_text("the motors stay off until the stop is released")).to_be_visible()
        assert lab_server.until(killed=True)["armed"] is False
        expect(page.get_by_text("Stopped through this server")).to_be_visible()
        release.press("Enter")
        expect(page.get_by_role("button", name="Arm", exact=True)).to_be_focused()
        lab_server.until(killed=False)
    page.keyboard.press("Shift+Tab")
    here = page.locator(":focus")
    expect(here).to_be_enabled()
    before = here.element_handle()
    page.keyboard.press("F8")  # what stays enabled keeps the focus
    lab_server.until(killed=True)
    expect(page.get_by_role("button", name="Release the stop")).to_be_visible()
    assert page.locator(":focus").evaluate("(now, before) => now === before", before)


@pytest.mark.long
def test_an_excitation_is_built_and_previewed(lab_server: LabServer, open_page: OpenPage) -> None:
    lab_server.warm()
    page = open_page(lab_server.link)
    page.get_by_role("button", name="Build one").click()
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_text("of 50 deg")).to_be_visible()
    ends = [dialog.get_by_role("slider", name=f"Cursor of {plot}") for plot in ("The signal", "Predicted pitch")]
    assert len({plot.get_attribute("aria-valuemax") for plot in ends}) == 1, "one axis of time"
    small = dialog.get_by_text("of 50 deg").inner_text()
    dialog.get_by_label("Amplitude").fill("25")
    dialog.get_by_label("Period").fill("3")
    expect(dialog.get_by_text("the failsafe would act")).to_be_visible()
    assert dialog.get_by_text("of 50 deg").inner_text() != small
    dialog.get_by_label("Amplitude").fill("70")
    dialog.get_by_label("Amplitude").press("Enter")
    expect(dialog.get_by_text("From \u221250 to 50 deg.")).to_be_visible()
    for kind in ("impulse", "3-2-1-1", "steps", "sweep", "prbs", "multisine"):
        with page.expect_response("**/api/excitations/preview") as answer:
            dialog.get_by_label("Kind").select_option(kind)
        assert answer.value.status == 200, (kind, answer.value.text())
        assert answer.value.json()["motion"], (kind, answer.value.json()["why"])
    assert axe(page, "dialog") == []


def test_a_watcher_may_only_stop(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.watch_link)
    expect(page.get_by_text("Watching only")).to_be_visible()
    expect(page.get_by_role("img", name=re.compile("^The drone on its rail"))).to_be_visible()  # without WebGL
    arm = page.get_by_role("button", name="Arm", exact=True)
    expect(arm).to_be_disabled()
    expect(arm).to_have_accessible_description("This link can only watch.")
    reaches(page, "Position x", 0.0, 0.05)
    assert "token" not in page.url
    lab_server.tell("arm")
    expect(page.get_by_text("Commanded from a page").first).to_be_visible()
    expect(page.get_by_text("You command")).to_have_count(0)
    page.get_by_role("button", name=STOP).click()  # but whoever stands beside it may stop it
    lab_server.until(killed=True, armed=False)
    expect(page.get_by_label("Log of the drone")).to_contain_text(
        "the emergency stop was pressed by a watching client at"
    )


def test_leaving_the_page_while_its_log_scrolls(lab_server: LabServer, open_page: OpenPage) -> None:
    """A browser tells of a scroll a frame later, also where the part that scrolled is gone by then."""
    page = open_page(lab_server.link)  # an error of the page fails the test at its end
    log = page.get_by_label("Log of the drone").element_handle()
    page.get_by_role("link", name="Logs").click()
    expect(page.get_by_label("Log of the drone")).to_have_count(0)
    log.dispatch_event("scroll")


def test_the_rig_is_reset(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link)
    page.get_by_role("button", name="Reset…").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Place on the rail x").fill("0.2")
    dialog.get_by_label("Place on the rail x").press("Enter")
    dialog.get_by_role("switch", name="Rings").click()
    dialog.get_by_role("button", name="Reset").click()
    expect(dialog).to_be_hidden()
    reaches(page, "Position x", 0.2, 0.03)
    expect(page.get_by_text("locked, the cart stands")).to_be_visible()


def test_the_visible_rows_are_saved_for_matlab(lab_server: LabServer, open_page: OpenPage, tmp_path: Path) -> None:
    page = open_page(lab_server.link)
    reaches(page, "Position x", 0.0, 0.05)
    for _ in patiently():  # on a busy computer only few rows are there with the first value
        with page.expect_download() as saved:
            page.get_by_role("button", name=".mat").click()
        saved.value.save_as(tmp_path / "seen.mat")
        log = read_log(tmp_path / "seen.mat")
        if len(log["theta"]) > 20:
            break
    assert {"theta", "x", "M", "x_true"} <= log.channels.keys()
    assert len(log["theta"]) > 20
    assert log["theta"].period() == pytest.approx(0.004, rel=0.05)
    assert np.abs(log["x_true"].value).max() < 0.01


@pytest.mark.long
def test_it_fits_and_is_accessible(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link, three_d=True)
    expect(page.get_by_role("application", name=re.compile("^The drone on its rail"))).to_be_visible()
    expect(page.get_by_role("button", name="Arm", exact=True)).to_be_enabled()
    assert axe(page) == []  # what a disarmed drone disables can be read as well
    flying(page)
    flies_to(page, press(page, "0.10"), "Position x", 0.1, 0.02)
    for size, theme in looks(page, "fly"):
        if size == "wide":  # what axe looks for does not hang on the size
            assert axe(page) == [], theme
        stop = page.get_by_role("button", name=STOP).bounding_box()
        assert stop is not None
        assert stop["height"] >= 36  # for a finger
        assert stop["y"] < 120  # in the first lines, never scrolled away
