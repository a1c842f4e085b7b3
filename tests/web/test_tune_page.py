"""The Tune page on a virtual drone: edits, undo, the guard, snapshots, files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.lab.served import ServedLab, served_lab
from tests.lab.test_tuning_routes import MODEL
from tests.patience import PATIENCE_S, patiently
from tests.web.conftest import OpenPage, axe, picture, readable
from tests.web.lab_server import LabServer
from tests.web.pilot import armed, flown, press
from twodof.experiment.flight import Laboratory
from twodof.flightlog.files import write_log

pytestmark = pytest.mark.slow

LONG_MS = PATIENCE_S * 1000


@pytest.fixture(scope="module")
def lab(built_page: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedLab]:
    assert (built_page / "index.html").is_file()
    with served_lab(tmp_path_factory.mktemp("lab")) as found:
        assert found.call("PUT", "models/careful", MODEL)[0] == 201
        yield found


@pytest.fixture(autouse=True)
def as_at_first(lab: ServedLab) -> Iterator[None]:
    yield
    lab.call("PUT", "tuning/1/model", {"model": None})
    rows = {row["name"]: row for row in lab.call("GET", "drones/1/parameters")[1]}
    gains = {name: rows[name]["default"] for name in ("RATE_KP", "RATE_KI", "RATE_KD", "ATT_KP")}
    assert lab.call("PATCH", "drones/1/parameters", gains)[0] == 200


def link(lab: ServedLab, query: str = "") -> str:
    return f"http://127.0.0.1:{lab.port}/#/tune{query}"


def field(page: Page, name: str) -> Locator:
    """Find the field of a parameter; its label ends in the unit."""
    return page.get_by_role("textbox", name=re.compile(rf"^{name}( \[|$)"))


def edit(page: Page, name: str, value: str) -> None:
    field(page, name).fill(value)
    field(page, name).press("Enter")


def on_board(lab: ServedLab, name: str) -> float:
    rows = lab.call("GET", "drones/1/parameters")[1]
    return float(next(row["value"] for row in rows if row["name"] == name))


@pytest.mark.long
def test_edits_are_sent_together_and_undone(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab))
    expect(page.get_by_text("0 to 0.12 s/rad, default 0.0854")).to_be_visible()
    listed = page.get_by_role("region", name="The parameters")
    assert listed.evaluate("one => one.scrollWidth <= one.clientWidth"), "the fields are cut"
    edit(page, "RATE_KP", "0.07")
    field(page, "ATT_KP").fill("9")  # what is typed counts: the first press of the button sends it
    bar = page.get_by_label("Changes to send")
    expect(bar).to_contain_text("0.0854 → 0.07")
    expect(bar).to_contain_text("11 → 9")
    assert on_board(lab, "RATE_KP") == 0.0854, "nothing is sent yet"
    page.get_by_role("button", name="Send 2 changes").click()
    expect(page.get_by_text("Sent: ")).to_be_visible()
    # The keyboard is where what was sent is taken back, and stays in the bar when nothing is left to take back.
    expect(page.get_by_role("button", name="Undo last send")).to_be_focused()
    assert (on_board(lab, "RATE_KP"), on_board(lab, "ATT_KP")) == (0.07, 9.0)
    page.get_by_role("link", name="Fly", exact=True).click()
    page.get_by_role("link", name="Tune", exact=True).click()
    page.reload()
    undo = page.get_by_role("button", name="Undo last send")
    expect(undo).to_be_enabled()
    undo.press("Enter")
    expect(field(page, "RATE_KP")).to_have_value("0.0854")
    expect(bar).to_be_focused()
    edit(page, "RATE_KP", "0.08")
    page.get_by_role("button", name="Undo the edit of RATE_KP").press("Enter")
    expect(field(page, "RATE_KP")).to_be_focused()
    assert (on_board(lab, "RATE_KP"), on_board(lab, "ATT_KP")) == (0.0854, 11.0)


def test_a_value_out_of_bounds_is_refused(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab, "?search=RATE_KP"))
    edit(page, "RATE_KP", "0.07")
    expect(page.get_by_role("button", name="Send 1 change")).to_be_enabled()
    edit(page, "RATE_KP", "7")
    expect(page.get_by_text("From 0 to 0.12")).to_be_visible()
    # What would be sent, 0.07, is not what stands there.
    expect(page.get_by_role("button", name="Send 1 change")).to_be_disabled()
    expect(page.get_by_text("Correct RATE_KP first")).to_be_visible()
    assert axe(page) == []


def test_the_field_is_as_wide_as_its_slider(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab, "?search=RATE_KP"))
    edit(page, "RATE_KP", "0.07")
    undo = page.get_by_role("button", name="Undo the edit of RATE_KP")
    slider, box = (
        page.get_by_role("slider", name="RATE_KP").bounding_box(),
        page.locator(".field-box", has=field(page, "RATE_KP")).bounding_box(),
    )
    assert slider
    assert box
    assert (box["x"], box["width"]) == pytest.approx((slider["x"], slider["width"]), abs=4.0)
    undo.click(trial=True)


def test_a_lost_server_is_not_taken_for_a_missing_drone(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab).replace("tune", "logs"), expects=("WebSocket", "ERR_"))
    page.route_web_socket("**/api/telemetry*", lambda socket: socket.close())
    page.route("**/api/drones", lambda route: route.abort())
    page.goto(link(lab))
    page.reload()
    expect(page.get_by_role("heading", name="No connection to the server")).to_be_visible()
    expect(page.get_by_text("Start one in a shell")).to_have_count(0)


def test_the_parameters_come_after_a_failed_request(lab: ServedLab, open_page: OpenPage) -> None:
    """A drone that is reset just then refuses; the page asks again by itself, for the models too."""
    page = open_page(link(lab).replace("tune", "logs"), expects=("503",))
    page.route("**/drones/1/parameters", lambda route: route.fulfill(status=503, json={"what": "reset"}), times=1)
    page.route("**/api/models", lambda route: route.fulfill(status=503, json={"what": "reset"}), times=1)
    page.get_by_role("link", name="Tune", exact=True).click()
    expect(field(page, "RATE_KP")).to_have_value("0.0854")
    expect(page.get_by_label("Model", exact=True).get_by_role("option", name="careful")).to_be_attached()


def test_a_search_is_kept_in_the_link(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab))
    search = page.get_by_role("searchbox")
    search.press_sequentially("rail limit")
    expect(field(page, "SAFE_RAIL_MARG")).to_be_visible()
    expect(search).to_be_focused()
    assert "search=rail+limit" in page.url
    page.reload()
    expect(field(page, "SAFE_RAIL_MARG")).to_be_visible()


@pytest.mark.long
def test_the_last_preview_is_shown_while_the_next_is_computed(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab))
    page.get_by_label("Model", exact=True).select_option("careful")
    margins = page.get_by_role("row", name="attitude")
    expect(margins).to_be_visible(timeout=LONG_MS)
    page.route("**/tuning/1/preview", lambda route: None)  # it is never answered
    page.get_by_role("link", name="Fly", exact=True).click()
    page.get_by_role("link", name="Tune", exact=True).click()
    expect(page.get_by_text("computing margins, step and verdict; below, the last ones")).to_be_visible()
    expect(margins).to_be_visible()


@pytest.mark.long
def test_a_prediction_is_named_by_its_gains(lab: ServedLab, open_page: OpenPage) -> None:
    """Not by those that the slider has reached meanwhile, and an old verdict is said to be old."""
    page = open_page(link(lab))
    page.get_by_label("Model", exact=True).select_option("careful")
    expect(page.get_by_role("row", name="attitude")).to_be_visible(timeout=LONG_MS)
    page.route("**/tuning/1/preview", lambda route: None)  # it is never answered
    plot = page.get_by_text("A step of θ", exact=True)
    stands = plot.bounding_box()
    edit(page, "RATE_KP", "0.07")
    curve = page.get_by_role("listitem").filter(has_text="predicted RATE_KP 0.07")
    expect(curve).to_be_visible(timeout=LONG_MS)
    expect(page.get_by_text("below, the last ones")).to_be_visible()
    assert plot.bounding_box() == stands, "what is computed moves the page"
    page.route("**/tuning/1/step", lambda route: None)
    edit(page, "RATE_KP", "0.06")
    expect(page.get_by_label("Changes to send")).to_contain_text("0.0854 → 0.06")
    expect(curve).to_be_visible()


@pytest.mark.long
def test_unstable_gains_need_a_confirmation(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab), expects=("409",))
    page.get_by_label("Model", exact=True).select_option("careful")
    expect(page.get_by_role("row", name="attitude")).to_be_visible(timeout=LONG_MS)
    for name, value in (("RATE_KP", "0.12"), ("RATE_KD", "0.003"), ("ATT_KP", "15")):
        edit(page, name, value)
    page.get_by_role("button", name="Send 3 changes").click()  # before their preview has come
    expect(page.get_by_text("Unstable for some sampled drones")).to_be_visible(timeout=LONG_MS)
    picture(page, "tune-unstable")
    dialog = page.get_by_role("dialog")
    send = dialog.get_by_role("button", name="Send anyway")
    expect(send).to_be_disabled()
    assert axe(page) == []
    dialog.get_by_role("button", name="Do not send").click()
    assert on_board(lab, "RATE_KP") == 0.0854
    page.get_by_role("button", name="Send 3 changes").click()
    dialog.get_by_role("checkbox").check()
    send.click()
    expect(page.get_by_text("Sent: ")).to_be_visible(timeout=LONG_MS)
    assert on_board(lab, "RATE_KD") == 0.003
    for name, value in (("RATE_KP", "0.0854"), ("RATE_KD", "0"), ("ATT_KP", "11")):
        edit(page, name, value)
    page.get_by_role("button", name="Send 3 changes").click()
    bar = page.get_by_label("Changes to send")
    expect(bar).to_contain_text("Nothing to send", timeout=LONG_MS)
    # To take that back is a change that is not kept stable: it is laid into the edits, and asked for as before.
    page.get_by_role("button", name="Undo last send").click()
    expect(bar.get_by_role("alert")).to_contain_text("unstable within the uncertainty", timeout=LONG_MS)
    expect(bar).to_contain_text("0.0854 → 0.12")
    assert on_board(lab, "RATE_KD") == 0.0


def test_steps_of_a_log_say_what_flew_them(lab: ServedLab, open_page: OpenPage) -> None:
    log = Laboratory("paper").fly("attitude-steps").log
    said = {**log.provenance, "flown": {"virtual": True, "controller": "my_pid"}}
    path = lab.folder / "flights" / "2026-01-01-10-00-00-drone-1.mcap"
    path.parent.mkdir(exist_ok=True)
    write_log(replace(log, provenance=said), path)
    page = open_page(link(lab))
    expect(page.get_by_text(f"from {path.name}: rig paper (virtual), my_pid")).to_be_visible()
    path.unlink()


@pytest.fixture
def careful_model(lab_server: LabServer) -> Iterator[None]:
    lab_server.call("PUT", "models/careful", MODEL)
    yield
    lab_server.tell("parameters", {"ATT_KP": 11.0}, "PATCH")
    lab_server.call("DELETE", "models/careful")


def fly_step(page: Page, label: str) -> None:
    """Fly a step of the pitch, again where the failsafe cuts it on a busy computer; see its curve by its `label`."""
    curve = page.get_by_text(re.compile(label)).first
    for _ in patiently():
        for pitch in ("0°", "10°"):
            flown(page, press(page, pitch), lambda: True)
            page.wait_for_timeout(1500)
        with suppress(AssertionError):
            return expect(curve).to_be_visible(timeout=2000)
    raise AssertionError(f"no curve {label}")


@pytest.mark.long
@pytest.mark.parametrize("by", ["keys", "mouse"])
@pytest.mark.usefixtures("careful_model")
def test_a_gain_is_moved_flown_and_kept(by: str, lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(f"{lab_server.link}#/tune", expects=("504",))  # asked again where the computer is busy
    page.get_by_label("Model", exact=True).select_option("careful")
    expect(page.get_by_text(re.compile(r"Stable, disk margin at least \d+ deg"))).to_be_visible(timeout=LONG_MS)
    slider = page.get_by_role("slider", name="ATT_KP, slider")
    page.get_by_role("button", name="Lock the cart").press("Enter")
    lab_server.until(rings_locked=True, warnings=[])
    expect(page.get_by_role("button", name="Arm", exact=True)).to_be_focused()  # the button that was pressed is gone
    armed(page)
    fly_step(page, r"flown at \d+\.\d s")
    if by == "mouse":
        page.get_by_label("Send on release").check()
        slider.scroll_into_view_if_needed()
        box = slider.bounding_box()
        assert box
        y = box["y"] + box["height"] / 2
        page.mouse.move(box["x"] + 11 / 15 * box["width"], y)
        page.mouse.down()
        page.mouse.move(box["x"] + 8 / 15 * box["width"], y, steps=10)
        page.mouse.up()
    else:
        slider.focus()
        for _ in range(40):
            slider.press("ArrowLeft")
        page.get_by_role("button", name="Send 1 change").press("Enter")
    expect(page.get_by_text("Sent: ATT_KP")).to_be_visible(timeout=LONG_MS)
    (kept,) = (
        row["value"]
        for row in lab_server.call("GET", f"drones/{lab_server.drone}/parameters")
        if row["name"] == "ATT_KP"
    )
    assert 7.0 < kept < 9.0
    for _ in range(2):  # the curves of the gain before stay, however many follow
        fly_step(page, r"ATT_KP [78](\.\d+)?, flown at")
    expect(page.get_by_text(re.compile(r"ATT_KP 11, flown at")).first).to_be_visible()
    lab_server.tell("disarm")
    readable(page, f"cockpit-{by}")
    page.get_by_role("tab", name="Snapshots and files").click()
    page.get_by_label("Keep all parameters as").fill(f"calmer by {by}")
    page.get_by_role("button", name="Keep", exact=True).click()
    expect(page.get_by_text(f"Kept as calmer by {by}")).to_be_visible()


def test_a_snapshot_is_compared_and_restored(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab, "?tab=snapshots"))
    page.get_by_label("Keep all parameters as").fill("by hand")
    page.get_by_role("button", name="Keep", exact=True).click()
    expect(page.get_by_text("Kept as by hand")).to_be_visible()
    assert lab.call("PATCH", "drones/1/parameters", {"ATT_KP": 7.0})[0] == 200
    page.get_by_role("button", name="Compare").click()
    expect(page.get_by_role("row", name="ATT_KP")).to_contain_text("7")
    page.get_by_role("button", name="Copy 1 into the fields").click()
    page.get_by_role("button", name="Send 1 change").click()
    expect(page.get_by_text("Sent: ATT_KP")).to_be_visible()
    assert on_board(lab, "ATT_KP") == 11.0
    with page.expect_download() as download:
        page.get_by_role("button", name="Save the drone's parameters").click()
    content = download.value.path().read_text()
    assert "\tRATE_KP\t0.0854\t9\n" in content
    other = content.replace("\tRATE_KP\t0.0854\t", "\tRATE_KP\t0.07\t").encode()
    page.get_by_label("Open a .params file").set_input_files(
        {"name": "other.params", "mimeType": "text/plain", "buffer": other}
    )
    expect(page.get_by_role("row", name="RATE_KP")).to_contain_text("0.07")
    assert axe(page) == []
    picture(page, "tune-snapshots")


@pytest.mark.long
def test_it_fits_and_can_be_read(lab: ServedLab, open_page: OpenPage) -> None:
    assert lab.call("PUT", "tuning/1/model", {"model": "careful"})[0] == 200
    page = open_page(link(lab))
    expect(page.get_by_role("row", name="attitude")).to_be_visible(timeout=LONG_MS)
    edit(page, "ATT_KP", "9")
    readable(page, "tune")
