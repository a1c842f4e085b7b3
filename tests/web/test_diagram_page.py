"""The Diagram page: draw by mouse and keys, check, simulate, save."""

from __future__ import annotations

import json
import logging
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, Route, expect

from tests.lab.served import COMMAND, Served, served
from tests.patience import patiently
from tests.web.conftest import OpenPage, axe, picture, readable
from tests.web.written_diagrams import odd_diagram, wide_diagram
from twodof.blocks import Diagram
from twodof.blocks.library import Gain
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.flight.starters import starter

pytestmark = pytest.mark.slow

FLOWN = re.compile(r"imulated in [\d.]+ m?s")
COVERED = """() => {
  const all = [...document.querySelectorAll(".svelte-flow__node")];
  const nodes = all.map((n) => [n.dataset.id, n.getBoundingClientRect()]);
  const found = [];
  for (const [one, a] of nodes)
    for (const [other, b] of nodes)
      if (one < other && a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom)
        found.push(`${one} over ${other}`);
  for (const wire of document.querySelectorAll(".svelte-flow__edge-path"))
    for (let s = 0; s < wire.getTotalLength(); s += 4) {
      const { x, y } = wire.getPointAtLength(s).matrixTransform(wire.getScreenCTM());
      for (const [id, r] of nodes)
        if (x > r.left + 3 && x < r.right - 3 && y > r.top + 1 && y < r.bottom - 1) found.push(`a wire through ${id}`);
    }
  return found;
}"""
HIDDEN = """() => {
  const box = document.querySelector(".sheet").getBoundingClientRect();
  const panels = [...document.querySelectorAll(".where, .svelte-flow__controls")];
  const over = panels.map((one) => one.getBoundingClientRect());
  const meets = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  return [...document.querySelectorAll(".svelte-flow__node")].filter((node) => {
    const r = node.getBoundingClientRect();
    const inside = r.left >= box.left && r.right <= box.right && r.top >= box.top && r.bottom <= box.bottom;
    return !inside || over.some((one) => meets(one, r));
  }).map((node) => node.dataset.id);
}"""
HEARD = """() => {
  globalThis.heard = [];
  const said = document.querySelector("#diagram-said");
  const changes = { childList: true, characterData: true, subtree: true };
  new MutationObserver(() => heard.push(said.textContent.trim())).observe(said, changes);
}"""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, built_page: Path) -> Iterator[Served]:
    assert built_page.is_dir()
    with served(tmp_path_factory.mktemp("data"), token=COMMAND, command_token=COMMAND) as there:
        yield there


def link(server: Served, rest: str = "") -> str:
    return f"http://{server.host}/?token={COMMAND}#/diagram{rest}"


def kept(server: Served, name: str) -> str:
    """Return the text of a saved diagram."""
    return (server.folder / "diagrams" / f"{name}.json").read_text(encoding="utf-8")


def keep(server: Served, name: str, text: str) -> None:
    folder = server.folder / "diagrams"
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.json").write_text(text, encoding="utf-8")


def block(page: Page, name: str) -> Locator:
    return page.locator(f".svelte-flow__node[data-id='p:{name}']")


def sheet(page: Page) -> Locator:
    return page.locator(".sheet")


def hidden(page: Page) -> list[str]:
    """Return the nodes that are not wholly on the sheet, or under its path, folds and zoom."""
    found: list[str] = page.evaluate(HIDDEN)
    return found


def drawn(page: Page) -> Page:
    expect(sheet(page)).to_be_visible()
    expect(page.get_by_text(FLOWN)).to_be_visible()
    return page


def hearing(page: Page) -> Callable[[str], None]:
    """Return a function that waits for words announced to screen readers from now on."""
    page.evaluate(HEARD)
    heard: list[str] = []

    def said(words: str) -> None:
        for _ in patiently():
            heard.extend(page.evaluate("heard.splice(0)"))
            if any(re.search(words, one) for one in heard):
                heard.clear()
                return
            time.sleep(0.05)

    return said


def took(page: Page) -> float:
    """Return the time from the last change to its simulation [ms]."""
    return float(page.locator("section[data-took]").get_attribute("data-took") or "nan")


@pytest.mark.long
def test_a_starter_is_drawn_and_simulated(server: Served, open_page: OpenPage) -> None:
    page = drawn(open_page(link(server, "?starter=notch-attitude")))
    expect(block(page, "notch")).to_be_visible()
    expect(page.get_by_text("It compiles")).to_be_visible()
    block(page, "pid").click()
    expect(page.get_by_label("anti_windup")).to_have_value("back-calculation")
    readable(page, "diagram")
    sheet(page).focus()
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Keys of the sheet")).to_be_visible()
    assert axe(page, "dialog") == []


def test_the_whole_sheet_is_shown_beside_its_buttons(server: Served, open_page: OpenPage) -> None:
    page = drawn(open_page(link(server, "?starter=empty-attitude")))
    page.set_viewport_size({"width": 1280, "height": 560})
    for _ in range(4):
        page.get_by_role("button", name="Zoom In").click()
    assert any(hidden(page)), "the sheet is larger than its place"
    page.get_by_role("button", name="Fit View").click()
    assert any(not hidden(page) for _ in patiently()), hidden(page)
    for terminal in ("i:theta_0", "o:M"):  # refused if anything covers it
        page.locator(f'[data-id="{terminal}"]').click()
    left, right = (page.locator(f'[data-id="{one}"]').bounding_box() for one in ("i:theta_0", "o:M"))
    box = sheet(page).bounding_box()
    assert left
    assert right
    assert box
    assert right["x"] + right["width"] - left["x"] > 0.5 * box["width"], "it is smaller than it could be"


def test_a_subtraction_is_found_by_its_name(server: Served, open_page: OpenPage) -> None:
    page = drawn(open_page(link(server, "?starter=empty-attitude")))
    sheet(page).focus()
    page.keyboard.press("a")
    page.keyboard.type("subtract")
    page.keyboard.press("Enter")
    expect(page.get_by_label("signs", exact=True)).to_have_value("+-")


def test_a_busy_computer_is_asked_again(server: Served, open_page: OpenPage) -> None:
    page = open_page(link(server).replace("diagram", "logs"), expects=("504",))
    slow = {"what": "the work took longer than 30 s", "where": "diagram", "remedy": "ask for less"}
    for asked in ("catalogue", "check"):
        page.route(f"**/api/diagrams/{asked}", lambda route: route.fulfill(status=504, json=slow), times=1)
    page.get_by_role("link", name="Diagram", exact=True).click()
    expect(drawn(page).get_by_text("It compiles")).to_be_visible()


def test_all_edits_work_by_keys(server: Served, open_page: OpenPage) -> None:
    page = drawn(open_page(link(server, "?starter=pid-attitude")))
    sheet(page).focus()
    said = hearing(page)
    page.keyboard.press("a")
    page.keyboard.type("gain")
    page.keyboard.press("Enter")
    said("add gain")
    expect(block(page, "gain")).to_be_visible()
    expect(page.get_by_text("1 problem", exact=True)).to_be_visible()
    page.keyboard.press("c")
    page.get_by_label("From", exact=True).select_option("gain")
    page.get_by_label("To", exact=True).select_option("error.b")
    page.get_by_role("button", name="Connect", exact=True).press("Enter")
    said("connect gain to error.b")
    page.keyboard.press("c")
    page.get_by_label("From", exact=True).select_option("q")
    page.get_by_label("To", exact=True).select_option("gain.u")
    page.get_by_role("button", name="Connect", exact=True).press("Enter")
    expect(page.get_by_text("It compiles")).to_be_visible()
    before = block(page, "gain").bounding_box()
    page.keyboard.press("ArrowRight")
    assert before is not None
    said(r"^gain at ")
    page.keyboard.press("F2")
    expect(page.get_by_label("Name", exact=True)).to_be_focused()
    sheet(page).focus()
    page.keyboard.press("Enter")
    expect(page.get_by_label("k", exact=True)).to_be_focused()
    page.keyboard.type("1.1")
    page.keyboard.press("Enter")
    said("^k of gain$")
    page.keyboard.press("Escape")
    expect(sheet(page)).to_be_focused()
    page.keyboard.press("n")
    said("input|from")
    for _ in range(5):
        page.keyboard.press("Control+z")
    expect(block(page, "gain")).to_have_count(0)
    page.keyboard.press("Control+y")
    expect(block(page, "gain")).to_be_visible()


@pytest.mark.parametrize("name", ["pid-attitude", "lqr-attitude", "stock-position", "pid-position", "direct-motor"])
def test_no_block_of_a_starter_covers_anything(server: Served, open_page: OpenPage, name: str) -> None:
    page = open_page(link(server, f"?starter={name}"))
    expect(page.locator(".svelte-flow__node[data-id^='p:']")).to_have_count(len(starter(name).parts))
    expect(page.locator(".svelte-flow__edge-path").first).to_be_attached()
    assert page.evaluate(COVERED) == []


@pytest.mark.long
def test_blocks_are_inserted_wired_flipped_and_aligned(server: Served, open_page: OpenPage) -> None:
    page = drawn(open_page(link(server, "?starter=pid-attitude")))
    said = hearing(page)
    search = page.get_by_role("dialog", name="Insert a block").get_by_role("combobox")
    block(page, "rate_limit").click()
    sheet(page).focus()
    page.keyboard.press("i")
    expect(search).to_be_focused()
    search.fill("feed-forward")
    expect(page.get_by_text("added with a Sum")).to_be_visible()
    search.fill("gain")
    page.keyboard.press("Enter")
    said("^insert gain$")
    expect(page.get_by_label("wire from rate_limit to gain.u")).to_be_attached()
    expect(sheet(page)).to_be_focused()
    start = block(page, "gain").locator(".source").bounding_box()
    assert start is not None
    x, y = start["x"] + start["width"] / 2, start["y"] + start["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y + 70, steps=5)
    page.mouse.up()
    expect(search).to_be_focused()
    page.keyboard.type("delay")
    page.keyboard.press("Enter")
    expect(page.locator("[aria-label^='wire from gain to ']")).to_have_count(1)
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    expect(block(page, "gain")).to_have_count(0)
    expect(page.get_by_role("button", name="Save…", exact=True)).to_be_visible()
    page.keyboard.press("a")
    page.keyboard.type("gain")
    page.keyboard.press("Enter")
    page.locator(".svelte-flow__node[data-id='i:q']").click()
    block(page, "gain").click(modifiers=["Control"])
    said("^connect q to gain$")
    sheet(page).press("Control+i")
    said("^flip gain$")
    sheet(page).press("Control+a")
    page.keyboard.press("m")
    page.get_by_role("menuitem", name="Left edges").press("Enter")
    said("^align: left edges$")


@pytest.mark.long
def test_moves_are_saved_and_unsaved_changes_confirmed(server: Served, open_page: OpenPage) -> None:
    text = to_json(starter("pid-attitude"))
    keep(server, "moved", text)
    page = drawn(open_page(link(server, "/moved")))
    inlet = page.locator(".svelte-flow__node[data-id='i:theta']")
    outer = page.locator(".svelte-flow__node-inlet:not([data-id='i:theta']), .svelte-flow__node-outlet")
    places = outer.evaluate_all("nodes => nodes.map((node) => node.style.transform)")
    inlet.click()
    sheet(page).focus()
    page.keyboard.press("Shift+ArrowUp")
    expect(page.locator("#diagram-said")).to_have_text(re.compile("^theta at "))
    page.keyboard.press("Control+s")
    expect(page.get_by_text("moved is saved")).to_be_visible()
    saved = from_json(kept(server, "moved"))
    assert "theta" in saved.input_positions
    assert all(part.position is not None for part in saved.parts.values())
    place = inlet.evaluate("node => node.style.transform")
    page.reload()
    expect(inlet).to_be_visible()
    assert inlet.evaluate("node => node.style.transform") == place
    assert outer.evaluate_all("nodes => nodes.map((node) => node.style.transform)") == places
    inlet.click()
    sheet(page).press("ArrowDown")
    by_dialog = page.get_by_role("dialog").get_by_role("button", name="notch-attitude")
    for way, answer, parts in (
        ("o", "Stay here", 0),
        ("new", "Stay here", 0),
        ("#", "Stay here", 0),
        ("#", "Open notch-attitude and lose them", 1),
    ):
        if way == "o":
            sheet(page).press("Control+o")
            by_dialog.click()
        elif way == "new":
            page.get_by_role("button", name="New", exact=True).press("Enter")
            expect(page.get_by_role("dialog", name="Open empty-attitude?")).to_be_visible()
        else:
            page.evaluate("location.hash = '#/diagram?starter=notch-attitude'")
        page.get_by_role("button", name=answer).press("Enter")
        expect(page).to_have_url(re.compile("[?]starter=notch-attitude$" if parts else "#/diagram/moved$"))
        expect(block(page, "notch")).to_have_count(parts)
    page.get_by_role("button", name="New", exact=True).press("Enter")
    expect(page).to_have_url(re.compile("[?]starter=empty-attitude$"))
    expect(block(page, "notch")).to_have_count(0)


@pytest.mark.long
def test_panels_fold_and_the_stock_controller_flies_beside(server: Served, open_page: OpenPage) -> None:
    page = drawn(open_page(link(server, "?starter=notch-attitude")))
    page.get_by_role("switch", name="Stock beside").click()
    plots = page.locator("#plots")
    expect(plots.get_by_text("stock", exact=True)).to_have_count(2)
    page.get_by_role("tab", name="Margins").click()
    expect(page.get_by_text("On the lab rig, at 250 Hz")).to_be_visible()
    asked: list[Route] = []
    page.route("**/api/jobs/*", lambda route: asked.append(route))
    page.get_by_role("combobox", name="Rig").select_option("paper")
    expect(page.get_by_role("progressbar", name=re.compile("^Margins: "))).to_be_visible()
    expect(page.get_by_text(re.compile(r"The last one took [\d.]+ s"))).to_be_visible()
    for one in asked:
        one.continue_()
    page.unroute("**/api/jobs/*")
    expect(page.get_by_text("On the paper rig, at 250 Hz")).to_be_visible()
    page.get_by_role("button", name="Show the Bode plots below").click()
    expect(plots.get_by_text("rate, stock", exact=True)).to_have_count(2)
    expect(page.get_by_role("columnheader", name="stock").first).to_be_visible()
    readable(page, "diagram-bode")
    page.set_viewport_size({"width": 1280, "height": 720})
    block(page, "notch").click()
    before = sheet(page).bounding_box()
    sheet(page).press("h")
    expect(page.get_by_role("tab", name="Margins")).to_be_hidden()
    after = sheet(page).bounding_box()
    assert before is not None
    assert after is not None
    assert after["width"] * after["height"] > 1.8 * before["width"] * before["height"]
    readable(page, "diagram-folded")
    page.set_viewport_size({"width": 1280, "height": 720})
    sheet(page).press("Enter")
    expect(page.get_by_label(re.compile("^frequency"))).to_be_focused()
    page.reload()
    expect(page.get_by_role("combobox", name="Search a block to add")).to_be_hidden()
    page.get_by_role("button", name="Palette").click()
    expect(page.get_by_role("combobox", name="Search a block to add")).to_be_visible()


def test_a_new_parameter_has_the_typed_value(server: Served, open_page: OpenPage) -> None:
    """Also before the server has told the ports and parameters of the block with that value."""
    page = drawn(open_page(link(server, "?starter=pid-attitude")))
    sheet(page).press("a")
    page.keyboard.type("gain")
    page.keyboard.press("Enter")
    expect(block(page, "gain")).to_be_visible()
    page.route("**/diagrams/shapes", lambda route: None)  # it is never answered
    page.get_by_label("k", exact=True).fill("5")
    page.get_by_label("k", exact=True).press("Enter")
    page.get_by_label("k bound to").select_option("a new parameter of the diagram")
    sheet(page).press("Escape")
    expect(page.get_by_label("gain_k", exact=True)).to_have_value("5.0")


@pytest.mark.long
def test_blocks_are_commented_grouped_and_given_parameters(server: Served, open_page: OpenPage) -> None:
    page = drawn(open_page(link(server, "?starter=notch-attitude")))
    flown = page.locator("section[data-flights]")

    def flies(action: Callable[[], object]) -> None:
        before = flown.get_attribute("data-flights") or ""
        action()
        expect(flown).not_to_have_attribute("data-flights", before)
        expect(page.get_by_text("It compiles")).to_be_visible()

    block(page, "rate_limit").click()
    flies(lambda: page.get_by_label("high bound to").select_option("a new parameter of the diagram"))
    expect(page.get_by_label("high bound to")).to_have_value("rate_limit_high")
    for name, key in (("notch", "y"), ("pid", "y"), ("rate_limit", "x")):
        block(page, name).click()
        flies(lambda key=key: sheet(page).press(f"Control+Shift+{key}"))  # type: ignore[misc]
        expect(block(page, name).locator(".commented")).to_be_visible()
    readable(page, "diagram-commented")
    page.set_viewport_size({"width": 1280, "height": 720})
    page.get_by_role("button", name="Use it again").click()
    expect(block(page, "rate_limit").locator(".commented")).to_have_count(0)
    block(page, "pid").click(modifiers=["Shift"])
    flies(lambda: sheet(page).press("Control+g"))
    flies(page.get_by_role("button", name="Ungroup").click)
    expect(block(page, "pid").locator(".commented")).to_be_visible()
    page.keyboard.press("Control+s")
    page.get_by_role("button", name="Save", exact=True).click()
    expect(page.get_by_text("notch_attitude is saved")).to_be_visible()
    saved = from_json(kept(server, "notch_attitude"))
    assert saved.params["rate_limit_high"].value == 20.0
    assert saved.parts["rate_limit"].params == {"high": "rate_limit_high"}
    assert saved.parts["pid"].commented == "through"


def test_margins_end_with_their_diagram(server: Served, open_page: OpenPage) -> None:
    loose = Diagram("loose")
    loose.input("u")
    loose.add("k", Gain(2), u="u")
    loose.output("y", "k")
    keep(server, "loose", to_json(loose))
    page = drawn(open_page(link(server, "?starter=pid-attitude")))
    page.get_by_role("tab", name="Margins").click()
    expect(page.get_by_text("On the lab rig, at 250 Hz")).to_be_visible()
    page.evaluate("location.hash = '#/diagram/loose'")
    expect(page.get_by_text("Margins need a diagram that fits a template")).to_be_visible()
    expect(page.get_by_role("rowheader", name="gain margin")).to_have_count(0)


def test_a_refused_block_is_named_and_not_simulated(server: Served, open_page: OpenPage) -> None:
    page = drawn(open_page(link(server, "?starter=pid-attitude"), expects=("422",)))
    block(page, "error").click()
    page.get_by_label("signs", exact=True).fill("+x")
    page.get_by_label("signs", exact=True).press("Enter")
    expect(page.get_by_text("Not simulated: it does not compile yet")).to_be_visible()
    page.get_by_role("tab", name="Margins").click()
    expect(page.get_by_text("Margins need a diagram that compiles")).to_be_visible()
    page.get_by_role("tab", name="Problems (1)").click()
    expect(page.get_by_role("button", name="pid_attitude.error")).to_be_visible()
    expect(page.get_by_text("fits no template")).to_have_count(0)


def test_an_algebraic_loop_is_marked(server: Served, open_page: OpenPage) -> None:
    d = starter("pid-attitude")
    del d.connections["error", "b"]
    d.connect("pid", "error.b")
    keep(server, "loop", to_json(d))
    page = open_page(link(server, "/loop"))
    expect(page.get_by_text("1 problem", exact=True)).to_be_visible()
    for name in ("error", "pid"):
        expect(block(page, name).locator(".loop")).to_be_visible()
        expect(block(page, name).locator("[title*='algebraic loop']")).to_be_visible()
    expect(page.locator(".svelte-flow__edge.loop")).to_have_count(2)
    expect(block(page, "pitch_gain").locator(".loop")).to_have_count(0)
    page.get_by_role("tab", name="Problems (1)").click()
    expect(page.get_by_text("put a delay or a continuous state into the loop").first).to_be_visible()
    picture(page, "diagram-loop")


@pytest.mark.parametrize("text", [to_json(starter("lqr-attitude")), to_json(from_json(to_json(odd_diagram())))])
def test_opening_and_saving_keeps_the_bytes(server: Served, open_page: OpenPage, text: str) -> None:
    keep(server, "bytes", text)
    page = open_page(link(server, "/bytes"))
    expect(sheet(page)).to_be_visible()
    sheet(page).focus()
    (server.folder / "diagrams" / "bytes.json").unlink()
    page.keyboard.press("Control+s")
    expect(page.get_by_text("bytes is saved")).to_be_visible()
    assert kept(server, "bytes") == text


def change_value_and_structure(page: Page, turn: int) -> tuple[float, float]:
    """Change a limit, then a rule of the PID; return the time until each was simulated [ms]."""
    flown = page.locator("section[data-flights]")

    def after(change: Callable[[], object]) -> float:
        before = flown.get_attribute("data-flights") or "0"
        change()
        expect(flown).not_to_have_attribute("data-flights", before)
        return took(page)

    block(page, "rate_limit").click()
    field = page.get_by_label("high", exact=True)
    field.fill(f"{0.4 + turn / 10}")
    value = after(lambda: field.press("Enter"))
    block(page, "pid").click()
    chosen = ("forward", "trapezoidal", "backward")[turn]
    return value, after(lambda: page.get_by_label("derivative", exact=True).select_option(chosen))


def test_only_a_changed_structure_is_compiled(server: Served, open_page: OpenPage) -> None:
    page = drawn(open_page(link(server, "?starter=pid-attitude")))
    compiled: list[str] = []
    page.on("request", lambda request: compiled.append(request.url) if "compile" in request.url else None)
    with page.expect_request(lambda request: "compile" in request.url):  # it may be asked for after the last flight
        change_value_and_structure(page, 0)
    assert len(compiled) == 1, "only for the structure"


@pytest.mark.long
def test_actions_on_300_blocks_stay_cheap(server: Served, open_page: OpenPage) -> None:
    """Selecting all touches each block once and measures this computer; other actions cost up to 1.9 times that."""
    figures = _longest_tasks(server, open_page)
    assert max(figures.values()) < 5.0 * figures["all"], figures


def _longest_tasks(server: Served, open_page: OpenPage) -> dict[str, float]:
    """Measure the longest task of each action on 300 blocks [ms]."""
    keep(server, "wide", to_json(wide_diagram(300)))
    page = drawn(open_page(link(server, "/wide")))
    expect(page.locator(".svelte-flow__node-part")).to_have_count(300)
    names = ["g50", "g61"]
    figures: dict[str, float] = {}

    def measured(name: str, *keys: str) -> None:
        figures[name] = _longest(page, lambda: [page.keyboard.press(key) for key in keys])

    def pressed_until(key: str, count: int) -> None:
        page.keyboard.press(f"Control+{key}")
        expect(page.locator(".svelte-flow__node-part")).to_have_count(count)

    def drag() -> None:
        box = block(page, names[0]).bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 40, y + 30, steps=10)
        page.mouse.up()

    def wire() -> None:
        start = block(page, names[0]).locator(".source").bounding_box()
        end = block(page, names[1]).locator(".target").first.bounding_box()
        assert start is not None
        assert end is not None
        page.mouse.move(start["x"] + start["width"] / 2, start["y"] + start["height"] / 2)
        page.mouse.down()
        page.mouse.move(end["x"] + end["width"] / 2, end["y"] + end["height"] / 2, steps=10)
        page.mouse.up()

    figures["select"] = _longest(page, block(page, names[0]).click)
    figures["drag"] = _longest(page, drag)
    sheet(page).focus()
    measured("undo", "Control+z")
    measured("move", "ArrowDown")
    measured("all", "Control+a")
    block(page, names[0]).click()
    measured("copy and paste", "Control+c", "Control+v")
    measured("undo a paste", "Control+z")
    sheet(page).focus()
    page.keyboard.press("Control+a")
    page.keyboard.press("Control+c")
    for name, key, count in (("paste", "v", 600), ("undo a paste", "z", 300), ("redo a paste", "y", 600)):
        figures[f"{name} of all"] = _longest(page, lambda key=key, count=count: pressed_until(key, count))  # type: ignore[misc]
    page.keyboard.press("Control+z")
    page.keyboard.press("Escape")
    figures["connect"] = _longest(page, wire)
    block(page, names[1]).click()
    field = page.get_by_label("k", exact=True)
    field.fill("1.25")
    figures["type"] = _longest(page, lambda: field.press("Enter"))
    logging.info("longest task of each action [ms]: %s", figures)
    return figures


def _longest(page: Page, action: Callable[[], object]) -> float:
    """Measure the longest task of the page's thread in an action, in its own processor time [ms]."""
    browser = page.context.browser
    assert browser is not None
    browser.start_tracing(page=page, categories=["toplevel"])
    action()
    page.wait_for_timeout(300)
    events = json.loads(browser.stop_tracing())["traceEvents"]
    names = (one for one in events if one.get("name") == "thread_name")
    threads = {(one["pid"], one["tid"]) for one in names if one["args"]["name"] == "CrRendererMain"}
    tasks = [
        one["tdur"] / 1000.0
        for one in events
        if one.get("name") == "ThreadControllerImpl::RunTask" and (one["pid"], one["tid"]) in threads and "tdur" in one
    ]
    assert tasks, "the trace holds no task"
    return max(tasks)
