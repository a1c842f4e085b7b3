"""Faults in flight: the page reports each one and recovers by itself."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from playwright.sync_api import Page, WebSocketRoute, expect

from tests.web.conftest import SIZES, OpenPage, axe, picture
from tests.web.lab_server import LabServer
from tests.web.pilot import armed, flies_to, flown, flying, press, reaches
from twodof.flightlog.files import read_log
from twodof.gcs import Drone

pytestmark = pytest.mark.slow

GONE = ("WebSocket", "ERR_", "502", "504")
REFUSED = ("409",)


@pytest.mark.long
def test_the_page_survives_a_server_restart(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link, expects=GONE)
    flying(page)
    os.kill(lab_server.child("lab"), signal.SIGKILL)
    expect(page.get_by_role("alert").get_by_text("No connection to the server.", exact=True)).to_be_visible()
    expect(page.get_by_text("its failsafe levels it")).to_be_visible()
    # What could only fail is off, with the reason; the stop alone is tried.
    off = page.get_by_role("button", name="Disarm")
    expect(off).to_be_disabled()
    expect(off).to_have_attribute("title", "No connection to the server.")
    expect(page.locator("main").get_by_text("No connection to the server.", exact=True)).to_be_visible()
    expect(page.get_by_role("button", name="STOP")).to_be_enabled()
    # `up` starts it again, and the page finds it by itself, at the same link.
    expect(page.get_by_text("Connected to the server again.")).to_be_visible()
    expect(page.get_by_text("No connection to the server.", exact=True)).to_be_hidden()
    # Nobody renewed the set-point or the lease meanwhile: what the failsafe has done is said.
    expect(page.locator("[aria-label='The drone']").get_by_text("Failsafe").first).to_be_visible()
    lab_server.calm()
    flying(page)
    flies_to(page, press(page, "0.00"), "Position x", 0.0, 0.03)


@pytest.mark.long
def test_the_page_survives_a_lost_link(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link, expects=GONE)
    flying(page)
    with lab_server.stopped("companion"):
        expect(page.get_by_text(f"The link to drone {lab_server.drone} is lost.")).to_be_visible()
        expect(page.get_by_role("button", name="Disarm")).to_be_disabled()
        expect(page.get_by_text("The link is lost.", exact=True).first).to_be_visible()
        expect(page.get_by_text("Armed", exact=True)).to_have_count(0)
        expect(page.get_by_text("Armed when last heard")).to_have_count(2)
    expect(page.get_by_text(f"The link to drone {lab_server.drone} is lost.")).to_be_hidden()
    # Which of the two the drone missed first depends on the load of this computer.
    expect(page.get_by_label("Log of the drone")).to_contain_text(re.compile("failsafe: .*(setpoint|link)_lost"))
    flying(page)
    flies_to(page, press(page, "0.00"), "Position x", 0.0, 0.05)


def test_a_stop_that_a_silent_server_does_not_hear_is_named(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link, expects=GONE)
    armed(page)
    with lab_server.stopped("lab"):
        expect(page.get_by_text("No connection to the server.", exact=True).first).to_be_visible()
        page.keyboard.press("F8")
        expect(page.get_by_text(f"The stop has not reached drone {lab_server.drone}.")).to_be_visible(timeout=2000)
        expect(page.get_by_text("motors off")).to_have_count(0)
        expect(page.get_by_text("You command")).to_have_count(0)
    expect(page.get_by_text("the motors stay off until the stop is released")).to_be_visible()
    lab_server.until(killed=True)
    # Also where the server lost the command meanwhile.
    expect(page.get_by_text("Stopped through this server")).to_be_visible()


@pytest.mark.long
def test_another_client_holds_the_lease(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link, expects=REFUSED)
    with Drone.connect(lab_server.url):
        expect(page.get_by_text("Commanded by").first).to_be_visible()
        expect(page.get_by_role("button", name="Take command")).to_be_visible()
        messages, main = page.get_by_label("Messages"), page.locator("main")
        before = main.bounding_box()
        page.get_by_role("button", name="Arm", exact=True).click()
        expect(messages.get_by_text("holds the lease")).to_be_visible()
        expect(messages).to_contain_text(": wait until it is given up")  # and nothing in words of Python
        expect(messages).not_to_contain_text("take_lease")
        assert main.bounding_box() == before, "it moves the page"
        for size in SIZES.values():
            page.set_viewport_size({"width": size[0], "height": size[1]})
            inside, above = main.bounding_box(), messages.bounding_box()
            assert inside
            assert above
            assert above["y"] + above["height"] <= inside["y"] + 1, "it covers what is shown"
            page.get_by_role("button", name="STOP F8").click(trial=True)  # refused if anything covers it
            page.get_by_role("link", name="Logs", exact=True).click(trial=True)
            picture(page, f"message-{size[0]}")
        page.set_viewport_size({"width": SIZES["wide"][0], "height": SIZES["wide"][1]})
    expect(page.get_by_text("Not commanded").first).to_be_visible()
    page.get_by_role("button", name="Take command").click()
    expect(page.get_by_text("You command").first).to_be_visible()
    page.get_by_role("button", name="Give it back").click()
    expect(page.get_by_text("Not commanded").first).to_be_visible()
    with Drone.connect(lab_server.url) as other:  # given back is given back
        other.arm()
        expect(page.get_by_role("button", name="Disarm")).to_be_visible()
        page.get_by_role("button", name="STOP F8").click()  # needs no lease
        lab_server.until(killed=True)


@pytest.mark.long
def test_the_failsafe_reports_its_reason(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link)
    armed(page)
    number = page.get_by_label("Pitch θ, number")
    number.fill("15")  # with the cart free it runs to the rail's end
    number.press("Enter")
    expect(page.get_by_role("alert").get_by_text("near the rail's end")).to_be_visible()
    expect(page.get_by_label("Log of the drone")).not_to_contain_text("Nothing yet")
    number.fill("0")
    number.press("Enter")
    page.get_by_role("tab", name="Position").click()
    flies_to(page, press(page, "0.00"), "Position x", 0.0, 0.03)
    expect(page.get_by_role("alert").get_by_text("near the rail's end")).to_be_hidden()


@pytest.mark.long
def test_a_stopped_drone_is_armed_again(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link, expects=REFUSED)
    armed(page)
    number = page.get_by_label("Pitch θ, number")
    number.fill("45")  # beyond the stop of the pitch
    number.press("Enter")
    lab_server.until(armed=False, failsafe="off")
    card = page.locator("section", has=page.get_by_role("heading", name="Flight", exact=True))
    expect(card.get_by_text("The failsafe has stopped the motors")).to_be_visible()
    expect(card.get_by_text("Cannot be armed yet")).to_be_hidden()
    picture(page, "fly-stopped-by-failsafe")
    card.get_by_role("button", name="Disarm").click()  # also acknowledges it
    expect(card.get_by_text("The failsafe has stopped the motors")).to_be_hidden()
    lab_server.tell(
        "reset", {"x": 0.0}
    )  # pitched so far the cart may have slid to the rail's end: a person pushes it back
    armed(page)


@pytest.mark.long
def test_an_offline_stop_is_sent_when_the_link_is_back(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link, expects=GONE, own=True)
    armed(page)
    page.context.set_offline(True)
    page.keyboard.press("F8")
    expect(page.get_by_text("The stop has not reached drone")).to_be_visible()
    assert not lab_server.state["killed"]
    picture(page, "stop-offline")
    page.context.set_offline(False)
    lab_server.until(killed=True, armed=False)
    expect(page.get_by_text("The stop has not reached drone")).to_be_hidden()
    lab_server.tell("release")
    page.context.set_offline(True)
    page.keyboard.press("F8")
    page.get_by_role("button", name="Do not send it again").click()
    page.context.set_offline(False)
    expect(page.get_by_role("button", name="Arm", exact=True)).to_be_enabled()
    assert not lab_server.state["killed"]


def test_what_the_failsafe_flies_is_no_flown_step(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(lab_server.link)
    armed(page)
    flown(page, press(page, "0"), lambda: lab_server.state["mode"] == "offboard")  # the first one starts the loop
    page.wait_for_timeout(500)
    number = page.get_by_label("Pitch θ, number")
    number.fill("15")  # with the cart free it runs to the rail's end, where the failsafe brakes it
    number.press("Enter")
    expect(page.get_by_role("alert").get_by_text("near the rail's end")).to_be_visible()
    lab_server.tell("setpoint", {"loop": "theta", "value": 0.0}, "PUT")
    lab_server.until(failsafe="none")
    reaches(page, "Pitch θ", 0.0, 3.0)
    steps = page.get_by_role("table", name="Steps as they are flown").get_by_role("rowheader")
    expect(steps.filter(has_text="→ 15")).to_have_count(1)
    expect(steps.filter(has_text="15.0 →")).to_have_count(0)


def test_a_lost_link_is_connected_again_by_a_button(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page("about:blank", own=True)
    sockets: list[WebSocketRoute] = []
    cut: list[bool] = []

    def relay(socket: WebSocketRoute) -> None:
        sockets.append(socket)
        if cut:
            socket.close()
        else:
            socket.connect_to_server()

    page.clock.install()
    page.route_web_socket(re.compile("/api/telemetry"), relay)
    page.goto(lab_server.link)
    reaches(page, "Position x", 0.0, 0.05)
    cut.append(True)
    sockets[-1].close()
    again = page.get_by_role("button", name="Connect again")
    expect(again).to_be_visible()
    assert axe(page, ".troubles") == []
    page.clock.pause_at(page.evaluate("Date.now()") + 1000)  # from here on the page does not try again by itself
    cut.clear()
    again.click()
    expect(page.get_by_text("Connected to the server again.")).to_be_visible()
    expect(again).to_be_hidden()


def test_a_slept_tab_reports_it_and_resumes(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page("about:blank", own=True)
    page.clock.install()
    page.goto(lab_server.link)
    reaches(page, "Position x", 0.0, 0.05)
    page.clock.fast_forward(60_000)  # as a browser does: timers that were due fire once, after it
    expect(page.get_by_text("This page stood still for 6")).to_be_visible()
    expect(page.get_by_text("No connection to the server.", exact=True)).to_be_hidden()
    lab_server.tell("reset", {"x": 0.1})
    reaches(page, "Position x", 0.1, 0.03)
    page.get_by_role("button", name="Close").click()
    expect(page.get_by_text("This page stood still")).to_be_hidden()


def test_a_clock_jump_changes_no_plot(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page("about:blank", own=True)
    page.clock.install(time=1_700_000_000)
    page.goto(lab_server.link)
    reaches(page, "Position x", 0.0, 0.05)
    page.clock.set_system_time(1_700_000_000 - 3600)
    expect(page.get_by_text("The clock of this computer was set back by 3")).to_be_visible()
    lab_server.tell("reset", {"x": -0.1})
    reaches(page, "Position x", -0.1, 0.03)


@contextmanager
def frozen(*pages: Page) -> Iterator[None]:
    """Stop the scripts of these tabs as a browser does when it freezes a tab; their sockets stay open."""
    sessions = [page.context.new_cdp_session(page) for page in pages]
    for chrome in sessions:
        chrome.send("Debugger.enable")
        chrome.send("Debugger.pause")
    yield
    for chrome in sessions:
        chrome.send("Debugger.resume")
        chrome.send("Debugger.disable")


def recorded_without_a_gap(lab_server: LabServer, name: str) -> float:
    """End the flight and return the duration [s] of its log, which has no gap."""
    lab_server.tell("disarm")
    lab_server.until(recording="")
    times = read_log(lab_server.folder / "flights" / name)["theta"].time
    assert np.diff(times).max() < 0.01
    return float(times[-1] - times[0])


@pytest.mark.long
def test_a_frozen_page_loses_command(lab_server: LabServer, open_page: OpenPage) -> None:
    page, watching = open_page(lab_server.link, own=True), open_page(lab_server.watch_link, own=True)
    flying(page)
    flies_to(page, press(page, "0.10"), "Position x", 0.1, 0.03)
    recording = lab_server.state["recording"]
    began = lab_server.state["time"]
    with frozen(page, watching):
        state = lab_server.until(mode="hold")  # by the server: nobody is there who flies it
    for one in (page, watching):
        expect(one.get_by_text("This page stood still for")).to_be_visible()
        expect(one.get_by_label("Mode")).to_have_value("hold")
    expect(page.get_by_label("Log of the drone")).to_contain_text("stands still for 3 s: the drone is levelled")
    assert lab_server.state["mode"] == "hold"  # and nothing that was asked before is asked again
    flies_to(page, press(page, "0.00"), "Position x", 0.0, 0.05)
    assert recorded_without_a_gap(lab_server, recording) > state["time"] - began
