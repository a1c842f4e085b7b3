"""The frame around every page: without its server it says so, and at every size and theme it can be read and used."""

from __future__ import annotations

import functools
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.web.conftest import OpenPage, readable

pytestmark = pytest.mark.slow

NO_SERVER = ("404", "501", "WebSocket")


class QuietHandler(SimpleHTTPRequestHandler):
    """Serves files, and writes no line for each."""

    def log_message(self, format: str, *args: object) -> None:
        """Write no line."""


@pytest.fixture(scope="module")
def files_only(built_page: Path) -> Iterator[str]:
    """The page's link on a server that has its files and no API."""
    handler = functools.partial(QuietHandler, directory=str(built_page))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()
        thread.join()


def test_a_missing_server_is_shown(files_only: str, open_page: OpenPage) -> None:
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


def test_the_first_key_skips_the_bar(files_only: str, open_page: OpenPage) -> None:
    page = open_page(f"{files_only}#/tune", expects=NO_SERVER)
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="Skip to the page")).to_be_focused()
    height = page.evaluate("[document.documentElement.scrollHeight, innerHeight]")
    assert height[0] <= height[1], "the link, once seen, makes the window scroll"
    page.keyboard.press("Enter")
    expect(page.locator("main")).to_be_focused()
    assert page.url.endswith("#/tune")
