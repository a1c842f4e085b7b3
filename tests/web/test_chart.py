"""A state machine drawn as a chart: by mouse from an empty sheet, and by keys."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.lab.served import COMMAND, Served, served
from tests.patience import patiently
from tests.web.conftest import THEMES, OpenPage, axe, picture, scrolls_sideways
from tests.web.test_diagram_page import FLOWN, block, drawn, hearing, kept, link, sheet
from twodof.blocks import Diagram, Port, State
from twodof.blocks.reference import Reference
from twodof.blocks.schema.json_form import from_json
from twodof.blocks.state_machine import Mode, StateMachine, Transition

pytestmark = pytest.mark.slow
SIZES = ((1280, 800), (1920, 1080))


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, built_page: Path) -> Iterator[Served]:
    assert built_page.is_dir()
    with served(tmp_path_factory.mktemp("data"), token=COMMAND, command_token=COMMAND) as there:
        yield there


class Written(StateMachine):
    """The machine that the test draws, in Python."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    variables = (State("n"),)
    modes: Any = (
        Mode("idle", during={"y": 0.0}),
        Mode("push", during=lambda u: {"y": 2.0 * u.u + 0.25}, entry=lambda x: {"n": x.n + 1.0}),
    )
    transitions = (
        Transition("idle", "push", lambda u, t: (u.u > 0.01) & (t.elapsed >= 25)),
        Transition("push", "idle", lambda u, t: (u.u < 0.005) & (t.elapsed_time >= 0.1)),
    )


def centre(place: Locator) -> tuple[float, float]:
    box = place.bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def drag(page: Page, start: tuple[float, float], end: tuple[float, float]) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*end, steps=12)
    page.mouse.up()


def wire(page: Page, source: str, target: str) -> None:
    """Draw a wire, or a transition, from the output of a block to its last input."""
    drag(page, centre(block(page, source).locator(".source")), centre(block(page, target).locator(".target").last))


def typed(page: Page, label: str, text: str) -> None:
    field = page.get_by_label(label, exact=True)
    field.fill(text)
    field.press("Enter")


def added(page: Page, name: str, x: float, y: float, during: str) -> None:
    """Double-click the sheet at a share of its width and height, and fill the state in."""
    box = sheet(page).bounding_box()
    assert box is not None
    page.mouse.dblclick(box["x"] + x * box["width"], box["y"] + y * box["height"])
    page.get_by_role("dialog", name="Insert a block").get_by_role("option", name="State").click()
    typed(page, "State", name)
    typed(page, "during", during)


def shown_values(page: Page) -> dict[str, list[float]]:
    """Return the curves of the scope, as the page exports them."""
    with page.expect_download() as download:
        page.get_by_role("button", name="CSV").click()
    curves: dict[str, list[float]] = {}
    for curve, _, value in list(csv.reader(download.value.path().read_text().splitlines()))[1:]:
        curves.setdefault(curve, []).append(float(value))
    return curves


def test_a_machine_drawn_by_mouse_flies_as_the_one_in_python(server: Served, open_page: OpenPage) -> None:
    page = drawn(open_page(link(server, "?starter=pid-attitude")))
    page.set_viewport_size({"width": 1280, "height": 800})
    sheet(page).focus()
    page.keyboard.press("a")
    page.keyboard.type("state machine")
    page.keyboard.press("Enter")
    expect(block(page, "chart")).to_be_visible()
    wire(page, "pid", "chart")
    block(page, "chart").dblclick()
    expect(page.get_by_text("Double-click the sheet for a state")).to_be_visible()
    added(page, "idle", 0.25, 0.5, "y = 0.0")
    added(page, "push", 0.7, 0.5, "y = 2.0 * u + 0.25")
    wire(page, "idle", "push")
    typed(page, "guard", "u > 0.01 and after(25)")
    wire(page, "push", "idle")
    typed(page, "guard", "u < 0.005 and after(0.1, sec)")
    page.keyboard.press("Escape")
    sheet(page).press("Escape")
    page.get_by_role("heading", name="Variables").get_by_role("button", name="Add").click()
    block(page, "push").click()
    typed(page, "entry", "n = n + 1.0")
    expect(page.get_by_text("It compiles")).to_be_visible()
    for size in SIZES:
        page.set_viewport_size({"width": size[0], "height": size[1]})
        page.keyboard.press("Escape")
        sheet(page).press("f")
        for theme in THEMES:
            page.emulate_media(color_scheme=theme)
            assert axe(page) == [], theme
            assert not scrolls_sideways(page)
            picture(page, f"chart-{size[0]}-{theme}")
            bar = page.get_by_role("switch", name="Noise").bounding_box()
            fold = page.get_by_role("combobox", name="Show").bounding_box()
            assert bar is not None
            assert fold is not None
            assert abs(bar["y"] - fold["y"]) < 20, "the simulation's bar is one line"
    sheet(page).press("u")
    flown = page.locator("section[data-flights]")
    for name in ("pid", "chart"):
        block(page, name).click()
        sheet(page).press("s")
    expect(page.get_by_role("list", name="On the scope").get_by_role("listitem")).to_have_count(2)
    expect(flown.get_by_text(FLOWN)).to_be_visible()
    for _ in patiently():  # each curve is simulated when it is put on the scope
        curves = shown_values(page)
        if {name.partition(".")[0] for name in curves} >= {"pid", "chart"}:
            break
    machine = Reference(as_written(), 0.004).machine()
    given, found = (next(values for name, values in curves.items() if name.startswith(one)) for one in ("pid", "chart"))
    expected = [machine.step({"u": u})["y"] for u in given]
    assert found == expected
    assert 0.0 in found
    assert max(found) > 0.5  # it pushed
    page.keyboard.press("Control+s")
    page.get_by_role("button", name="Save", exact=True).click()
    expect(page.get_by_text("pid_attitude is saved")).to_be_visible()
    saved = from_json(kept(server, "pid_attitude")).parts["chart"].item
    assert isinstance(saved, StateMachine)
    assert [t.text for t in saved.transitions] == ["idle -> push", "push -> idle"]
    assert saved.chart.guards[1].text == "u < 0.005 and after(0.1, sec)"
    assert all(mode.position is not None for mode in saved.modes)


def as_written() -> Diagram:
    d = Diagram("alone")
    d.input("u")
    d.add("machine", Written(), u="u")
    d.output("y", "machine.y")
    return d


def test_a_chart_is_drawn_by_keys_and_undone(server: Served, open_page: OpenPage) -> None:
    page = drawn(open_page(link(server, "?starter=pid-attitude")))
    sheet(page).focus()
    said = hearing(page)
    for name in ("state machine", "state", "state"):
        page.keyboard.press("a")
        page.keyboard.type(name)
        page.keyboard.press("Enter")
        said("^add ")
        if name == "state machine":
            page.keyboard.press("o")
            said("^chart: 0 blocks")
    page.keyboard.press("F2")
    page.keyboard.type("busy")
    page.keyboard.press("Enter")
    said("^rename state_2 to busy")
    sheet(page).focus()
    page.keyboard.press("c")
    page.get_by_label("From", exact=True).select_option("state")
    page.get_by_label("To", exact=True).select_option("busy.t0")
    page.get_by_role("button", name="Connect", exact=True).press("Enter")
    said("^connect state to busy.t0")
    page.keyboard.press("w")
    said("wire from state to busy.t0")
    page.keyboard.press("Enter")
    expect(page.get_by_label("guard", exact=True)).to_be_focused()
    page.keyboard.type("u > speed")
    page.keyboard.press("Enter")
    expect(page.get_by_role("alert").filter(has_text="unknown name 'speed'")).to_be_visible()
    expect(page.get_by_text("1: u > speed")).to_be_visible()
    sheet(page).focus()
    for _ in range(4):
        page.keyboard.press("Control+z")
    expect(page.locator(".svelte-flow__node-part")).to_have_count(1)
    for _ in range(4):
        page.keyboard.press("Control+y")
    expect(page.get_by_text("1: u > speed")).to_be_visible()
    block(page, "busy").click()
    sheet(page).press("Delete")
    expect(block(page, "busy")).to_have_count(0)
    sheet(page).press("u")
    expect(block(page, "chart")).to_be_visible()
