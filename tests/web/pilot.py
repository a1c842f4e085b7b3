"""How a person flies by the Fly page: arms, asks, sees it come, and asks again where the drone has made itself safe."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress

from playwright.sync_api import Page, TimeoutError, expect

from tests.patience import patiently

SHOWN_EVERY_S = 0.1
"""The page tells the live values anew so often."""
PRESSED_MS = 5000.0
AGAIN_S = 10.0
"""A step of the virtual rig comes within a second or two of its time."""


def armed(page: Page) -> None:
    """Arms by the button, again where the drone refuses it, and sees that it is."""
    arm, disarm = (page.get_by_role("button", name=name, exact=True) for name in ("Arm", "Disarm"))
    arm.click()
    for _ in patiently():
        with suppress(AssertionError):
            expect(disarm).to_be_enabled(timeout=PRESSED_MS)
            break
        with suppress(TimeoutError):
            arm.click(timeout=PRESSED_MS)
    expect(disarm).to_be_enabled()
    expect(page.get_by_role("button", name="Disarm")).to_be_focused()  # the keyboard stays where it was


def press(page: Page, name: str) -> Callable[[], None]:
    """Return a function that presses a button which a disarmed drone would disable."""
    return lambda: page.get_by_role("button", name=name, exact=True).click(timeout=PRESSED_MS)


def flown(page: Page, ask: Callable[[], object], there: Callable[[], bool]) -> None:
    """Asks the armed drone for something until it is `there`.

    A drone that hears nothing for a while makes itself safe, as where the computer of its pilot stands still: then that
    arms it and asks again.
    """
    asked = -AGAIN_S
    for _ in patiently():
        if time.monotonic() - asked >= AGAIN_S:
            with suppress(TimeoutError):  # it has been disarmed meanwhile
                if page.get_by_role("button", name="Arm", exact=True).is_visible():
                    armed(page)
                ask()
            asked = time.monotonic()
        if there():
            return
        time.sleep(SHOWN_EVERY_S)


def flying(page: Page) -> None:
    """Armed and hovering in the middle of the rail."""
    armed(page)
    page.get_by_role("tab", name="Position").click()
    flown(page, press(page, "0.00"), page.get_by_text("follows position").is_visible)


def shown(page: Page, label: str) -> float:
    """A live value as the page shows it, in the unit of the screen."""
    text = page.locator("dl[aria-label=Now] div", has_text=label).locator("dd").inner_text().split()[0]
    return float(text.replace("\u2212", "-").replace("–", "nan"))


def flies_to(page: Page, ask: Callable[[], object], label: str, value: float, within: float) -> None:
    """Asks the armed drone for something until a live value is there."""
    flown(page, ask, lambda: abs(shown(page, label) - value) < within)


def reaches(page: Page, label: str, value: float, within: float) -> None:
    """Waits until a live value is there."""
    seen = float("nan")
    for _ in patiently():
        seen = shown(page, label)
        if abs(seen - value) < within:
            return
        time.sleep(SHOWN_EVERY_S)
    raise AssertionError(f"{label} is {seen}, not {value}")
