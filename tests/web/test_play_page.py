"""The page Play, opened from its folder as a reader would: it flies, answers to what one does, and fetches nothing."""

from __future__ import annotations

import fcntl
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests import toolchains
from tests.patience import PATIENCE_S
from tests.web.conftest import PROJECT, SIZES, OpenPage, Theme, axe, picture, scrolls_sideways
from tools import play

pytestmark = pytest.mark.slow

FIRST_STEP_S = 2.5
"""Play's set-point steps for the first time after this, and every so long."""


@pytest.fixture(scope="module")
def link() -> str:
    """The page, built, as a link to the file."""
    toolchains.need("node")
    with (Path(tempfile.gettempdir()) / "twodof-tests-play-build.lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        done = subprocess.run(
            [PROJECT / "tools" / "web.sh", sys.executable, "play"],
            capture_output=True,
            text=True,
            timeout=2 * PATIENCE_S,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return play.write().as_uri()


def flown(page: Page, seconds: float) -> None:
    """Holds the page's own clock, and flies on by so much of the rig's time: no test waits for real time."""
    page.evaluate("(s) => { pilot.running = false; for (let k = 0; k < 10 * s; k++) pilot.advance(0.1); }", seconds)


def flown_until(page: Page, time: float) -> None:
    """The same, until so many seconds after the start."""
    page.evaluate("(t) => { pilot.running = false; while (pilot.flight.time < t) pilot.advance(0.1); }", time)


def latest(page: Page, column: str) -> float:
    value: float = page.evaluate(
        "(name) => { const h = pilot.flight.history; return h.column(name).at(h.last - 1); }", column
    )
    return value


@pytest.mark.long
@pytest.mark.parametrize(("size", "theme"), [("wide", "light"), ("tablet", "dark")])
def test_it_opens_from_its_folder_and_flies(link: str, open_page: OpenPage, size: str, theme: Theme) -> None:
    page = open_page(link, size, theme, three_d=size == "wide")
    fetched: list[str] = []
    page.on("request", lambda request: fetched.append(request.url))
    page.reload()
    expect(page.get_by_text("Flying.")).to_be_visible()
    flown_until(page, 3.9 * FIRST_STEP_S)
    up = page.get_by_role("row", name=re.compile("θ 0.00 → 9.74 deg"))
    expect(up).to_have_count(2)
    # Rise, overshoot, settling, peak and peak M of the step that is over; test_step_figures.py asks for the rest.
    expect(up.last).to_contain_text(
        re.compile(r"0\.\d{3}\s*\d+\.\d\s*(0\.\d{3}|not reached)(, mean of \d+)?\s*\d+\.\d+\s*0\.\d+")
    )
    assert latest(page, "truth.theta") == pytest.approx(0.17, abs=0.02)
    assert [address for address in fetched if not address.startswith(("file:", "blob:", "data:"))] == []
    assert axe(page) == []
    assert not scrolls_sideways(page)
    assert SIZES[size]
    picture(page, f"play-{size}-{theme}")


@pytest.mark.long
def test_the_same_seed_flies_the_same_bits_again(link: str, open_page: OpenPage) -> None:
    page = open_page(f"{link}#seed=7&rings=0&mode=position")
    expect(page.get_by_text("Flying.")).to_be_visible()
    flights = []
    for left in (0.0013, 0.0029):
        page.evaluate("pilot.running = false")
        page.evaluate("(s) => pilot.advance(s)", left)  # a frame ends anywhere in a control step
        page.get_by_role("button", name="Restart").click()
        flown(page, 6.0)
        flights.append([latest(page, name) for name in ("truth.x", "truth.theta", "estimate.x", "command.M")])
    assert flights[0] == flights[1]
    assert abs(flights[0][0]) > 1e-4


def test_a_gain_is_kept_in_the_link(link: str, open_page: OpenPage) -> None:
    page = open_page(link)
    gain = page.get_by_label(re.compile(r"^Attitude Kp \["))
    gain.fill("4")
    gain.press("Enter")
    assert page.evaluate("pilot.flight.get('flight.cascade.attitude.kp')") == 4.0
    assert "att_kp=4" in page.url
    gain.fill("40")
    gain.press("Enter")
    expect(page.get_by_role("alert").first).to_contain_text("15")
    assert page.evaluate("pilot.flight.get('flight.cascade.attitude.kp')") == 4.0
    again = open_page(page.url)
    expect(again.get_by_label(re.compile(r"^Attitude Kp \["))).to_have_value("4")


@pytest.mark.long
def test_a_cut_link_is_what_the_failsafe_says(link: str, open_page: OpenPage) -> None:
    page = open_page(f"{link}#rings=0&mode=position")
    expect(page.get_by_text("Flying.")).to_be_visible()
    flown(page, 1.0)
    page.get_by_role("switch", name="Link").press("Space")
    flown(page, 0.7)
    expect(page.get_by_text("The failsafe levels it.")).to_be_visible()
    expect(page.get_by_text("no set-point came for a while")).to_be_visible()
    flown(page, 8.0)
    expect(page.get_by_text(re.compile("The failsafe stopped the motors"))).to_be_visible()
    page.get_by_role("button", name="Restart").press("Enter")
    flown(page, 0.5)
    expect(page.get_by_text("Flying.")).to_be_visible()


def test_a_strike_and_a_delay_are_felt(link: str, open_page: OpenPage) -> None:
    page = open_page(link)
    expect(page.get_by_text("Flying.")).to_be_visible()
    flown(page, 1.0)
    page.get_by_role("button", name="Strike the nose up").click()
    assert latest(page, "truth.q") < 0.2
    flown(page, 0.1)
    struck = page.evaluate(
        "(() => { const h = pilot.flight.history, c = h.column('truth.q'); let most = 0;"
        " for (let k = h.first; k < h.last; k++) most = Math.max(most, c.at(k)); return most; })()"
    )
    assert struck > 0.5
    delay = page.get_by_label(re.compile(r"^Delay \["))
    delay.fill("0.05")
    delay.press("Enter")
    assert page.evaluate("pilot.flight.get('rig.delay')") == 0.05
