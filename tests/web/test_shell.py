"""The frame around every page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.lab.served import served as lab_served
from tests.web.conftest import OpenPage, files_served, picture, readable

pytestmark = pytest.mark.slow

NO_SERVER = ("404", "501", "WebSocket")


@pytest.fixture(scope="module")
def files_only(built_page: Path) -> Iterator[str]:
    """Serve the page without its API."""
    with files_served(built_page) as link:
        yield link


@pytest.mark.long
def test_the_frame_reports_a_missing_server(files_only: str, open_page: OpenPage) -> None:
    page = open_page(files_only, expects=NO_SERVER)
    expect(page.get_by_text("No server")).to_be_visible()
    expect(page.get_by_role("button", name="STOP F8")).to_be_visible()
    readable(page, "shell")


def test_the_theme_is_chosen_and_kept(files_only: str, open_page: OpenPage) -> None:
    page = open_page(files_only, expects=NO_SERVER)
    background = "getComputedStyle(document.body).backgroundColor"
    light = page.evaluate(background)
    page.get_by_label("Theme").select_option("dark")
    dark = page.evaluate(background)
    assert dark != light
    page.reload()
    assert page.evaluate(background) == dark
    page.get_by_label("Theme").select_option("system")
    assert page.evaluate(background) == light


def test_the_skip_link_stays_on_the_page(files_only: str, open_page: OpenPage) -> None:
    page = open_page(f"{files_only}#/tune", expects=NO_SERVER)
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="Skip to the page")).to_be_focused()
    height = page.evaluate("[document.documentElement.scrollHeight, innerHeight]")
    assert height[0] <= height[1], "the link, once seen, makes the window scroll"
    page.keyboard.press("Enter")
    expect(page.locator("main")).to_be_focused()
    assert page.url.endswith("#/tune")


def test_a_link_of_an_earlier_start_is_named(built_page: Path, tmp_path: Path, open_page: OpenPage) -> None:
    """As `up --token` serves it: without a token, which the page forgets when it is refused, nobody comes in."""
    now = "a-token-of-the-present-start-1234"
    with lab_served(tmp_path, token=now, command_token=now, token_always=True) as server:
        refused = ("401", "WebSocket", "ERR_")
        words = "This link is of an earlier start of the server, or has no token."
        for name in ("logs", "fly"):
            link = f"http://{server.host}/?token=a-token-of-an-earlier-start-12345#/{name}"
            page = open_page(link, expects=refused)
            expect(page.get_by_text(words)).to_be_visible()
            expect(page.locator("main")).to_have_text("")  # it is said once
            expect(page.get_by_label("Messages")).to_have_text("")
            expect(page.get_by_text("No server")).to_have_count(0)
        picture(page, "earlier-start")
        page.goto(f"http://{server.host}/?token={now}")
        expect(page.get_by_text(words)).to_have_count(0)
        expect(page.get_by_role("heading", name="No drone yet")).to_be_visible()


def test_a_token_of_an_earlier_start_is_forgotten(built_page: Path, tmp_path: Path, open_page: OpenPage) -> None:
    """A link with a token was opened in this tab; then `up` was started without one, and its plain link is opened."""
    with lab_served(tmp_path) as server:
        link = f"http://{server.host}/"
        page = open_page(f"{link}?token=a-token-of-an-earlier-start-12345", expects=("401", "WebSocket", "ERR_"))
        expect(page.get_by_role("heading", name="No drone yet")).to_be_visible()
