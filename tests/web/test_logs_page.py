"""The Logs page: list, replay, compare, notes, upload, delete and undo."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.flightlog.test_ulog_file import px4_log
from tests.lab.served import COMMAND, WATCH, Served, served
from tests.patience import patiently
from tests.web.conftest import OpenPage, axe, readable
from twodof.experiment.flight import Laboratory
from twodof.flightlog.files import read_log, write_log
from twodof.flightlog.log import FlightLog
from twodof.report.step_responses import folded_steps, step_responses

pytestmark = pytest.mark.slow

FIRST, SECOND = "2026-03-01-10-00-00-drone-1.mcap", "2026-03-01-10-05-00-drone-1.mcap"


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two flights of steps in pitch on the virtual rig, one of them with words and a change; and a file cut short."""
    data = tmp_path_factory.mktemp("data")
    folder = data / "flights"
    folder.mkdir()
    laboratory = Laboratory("lab")
    said = {
        "texts": [[14.0, "warning", "the pitch is near its stop"]],
        "changes": [[13.0, "RATE_P", 0.2]],
        "parameters": {"RATE_P": 0.1},
    }
    for name, seed, told in ((FIRST, 1, said), (SECOND, 2, {"parameters": {"RATE_P": 0.1}})):
        log = laboratory.fly("attitude-steps", seed=seed).log
        write_log(FlightLog(log.channels, {**log.provenance, **told}), folder / name)
    (folder / "cut.mcap").write_bytes((folder / FIRST).read_bytes()[:3000])
    return data


@pytest.fixture(scope="module")
def logs_server(flights: Path, built_page: Path) -> Iterator[Served]:
    with served(flights, token=COMMAND, command_token=COMMAND, watch_token=WATCH) as there:
        yield there


def link(server: Served, rest: str = "", token: str = COMMAND) -> str:
    return f"http://{server.host}/?token={token}#/logs{rest}"


def opened(page: Page) -> None:
    """The log has been read, its replay too."""
    expect(page.get_by_role("button", name="Play")).to_be_enabled()


@pytest.mark.long
def test_every_view_is_accessible(logs_server: Served, open_page: OpenPage) -> None:
    page = open_page(link(logs_server))
    expect(page.get_by_role("img", name="estimated pitch")).to_have_count(2)
    expect(page.get_by_text("cannot be read")).to_be_visible()  # the file that was cut short
    readable(page, "logs-list")
    page.goto(link(logs_server, f"/{FIRST}?at=20.4"))
    opened(page)
    readable(page, "logs-open")
    page.goto(link(logs_server, f"/{FIRST}?with={SECOND}"))
    expect(page.get_by_role("cell", name="RATE_P 0.1").first).to_be_visible()
    readable(page, "logs-compared")


@pytest.mark.long
def test_a_replay_shows_where_the_drone_was(logs_server: Served, flights: Path, open_page: OpenPage) -> None:
    log = read_log(flights / "flights" / FIRST)
    page = open_page(link(logs_server, f"/{FIRST}?at=20.40"), three_d=True)
    opened(page)

    def seen(time: float) -> None:
        expect(page.locator("output.time")).to_have_text(f"{time:.2f} s")
        pitch = round(float(np.degrees(log.resample("theta", [time])[0])))
        expect(page.get_by_role("application")).to_have_attribute(
            "aria-label", re.compile(rf"pitch ({pitch}|{pitch - 1}|{pitch + 1}) degrees")
        )

    seen(20.40)
    scrub = page.get_by_role("slider", name="Time in the log")
    scrub.focus()
    page.keyboard.press("l")
    seen(21.40)
    page.keyboard.press("j")
    page.keyboard.press(",")
    seen(20.38)
    first = step_responses(log)[0]
    page.get_by_role("button", name=f"Go to {first.time:.2f} s").first.click()
    expect(page.locator("output.time")).to_have_text(f"{first.time:.2f} s")
    expect(page).to_have_url(re.compile(rf"at={first.time:.2f}"))
    page.get_by_role("button", name="Go to 14.00 s: the pitch is near its stop").click()
    seen(14.00)
    expect(page.get_by_role("button", name="Go to 13.00 s: RATE_P set to 0.2")).to_be_visible()
    page.get_by_label("Speed").select_option("10")
    page.get_by_role("button", name="Play").click()
    expect(page.get_by_role("button", name="Pause")).to_be_visible()
    expect(page.get_by_role("button", name="Play")).to_be_visible()
    expect(page.locator("output.time")).to_have_text(f"{log.span[1]:.2f} s")


def test_compared_flights_show_their_steps(logs_server: Served, flights: Path, open_page: OpenPage) -> None:
    page = open_page(link(logs_server))
    for name in (FIRST, SECOND):
        page.get_by_label(f"Choose {name}").check()
    page.get_by_role("link", name="Compare 2 logs").click()
    called = {FIRST: "RATE_P 0.2", SECOND: "RATE_P 0.1"}
    for name, said in called.items():
        found = step_responses(read_log(flights / "flights" / name))
        row = page.get_by_role("row").filter(has_text=said).first
        expect(page.locator("[data-plot]").first.get_by_text(said, exact=True)).to_be_visible()
        rise, overshoot = found[0].figures.rise_time, 100.0 * found[0].figures.overshoot
        expect(row).to_contain_text(f"{rise:.3f}")
        expect(row).to_contain_text(f"{overshoot:.1f}")
    page.get_by_label("Aligned at").select_option("step 3 of each")
    later = [step_responses(read_log(flights / "flights" / name))[2].time for name in (FIRST, SECOND)]
    for time in later:
        expect(page.get_by_role("row", name=f"{time:.2f}").first).to_have_class(re.compile("now"))
    log = read_log(flights / "flights" / FIRST)
    inside = (log["theta"].time >= later[0]) & (log["theta"].time <= later[0] + 1.0)
    for _ in patiently():  # around the step each sample is shown, not a thinned curve of the whole flight
        with page.expect_download() as saved:
            page.get_by_role("button", name="CSV").first.click()
        rows = [row.split(",") for row in saved.value.path().read_text().splitlines()]
        shown = [row for row in rows if "RATE_P 0.2" in row[0] and 0.0 <= float(row[1]) <= 1.0]
        if len(shown) > 0.98 * inside.sum():
            break
        page.wait_for_timeout(500)
    other = step_responses(read_log(flights / "flights" / SECOND))[1].time
    row = page.get_by_role("row").filter(has_text=called[SECOND]).filter(has_text=f"{other:.2f}")
    row.get_by_role("button", name=f"Align at {other:.2f} s").click()
    expect(row).to_have_class(re.compile("now"))
    page.get_by_label("Aligned at").select_option("start")
    expect(page.get_by_text("position x").first).to_be_visible()


def test_a_flight_without_steps_is_compared_from_its_start(
    logs_server: Served, flights: Path, open_page: OpenPage
) -> None:
    log = read_log(flights / "flights" / FIRST)
    first = step_responses(log)[0].time
    before = {name: one.slice(log.span[0], first - 0.1) for name, one in log.channels.items()}
    write_log(FlightLog(before, {}), flights / "flights" / "still.mcap")
    page = open_page(link(logs_server, f"/{FIRST}?with=still.mcap"))
    expect(page.get_by_text("their starts instead: no set-point steps in this flight (still.mcap)")).to_be_visible()
    expect(page.get_by_text("still.mcap: from").first).to_be_attached()
    (flights / "flights" / "still.mcap").unlink()


@pytest.mark.long
def test_own_plots_cursors_and_folded_steps(logs_server: Served, flights: Path, open_page: OpenPage) -> None:
    log = read_log(flights / "flights" / FIRST)
    page = open_page(link(logs_server, f"/{FIRST}?at=12.00"))
    opened(page)
    page.get_by_role("button", name="Choose signals").click()
    for name in ("theta estimated pitch", "q estimated pitch rate"):
        page.get_by_role("checkbox", name=name).check()
    expect(page.get_by_role("heading", name="theta, q", exact=True)).to_be_visible()
    page.get_by_label("Signals of").select_option("a new plot")
    page.get_by_label("Find").fill("lmnf")
    page.get_by_role("checkbox", name="lmnf/M").check()
    page.reload()
    opened(page)
    expect(page.get_by_role("heading", name="lmnf/M", exact=True)).to_be_visible()  # kept in the browser
    page.get_by_role("switch", name="Usual plots").click()
    expect(page.get_by_role("heading", name="pitch θ", exact=True)).to_have_count(0)

    # Three cursors by keys, and one taken away.
    cursor = page.get_by_role("slider", name="Cursor of theta, q")
    cursor.focus()
    for key in ("Enter", "ArrowRight", "ArrowRight", "Enter", "ArrowRight", "ArrowRight", "Enter"):
        page.keyboard.press(key)
    table = page.get_by_role("table", name="Cursors")
    start, end = log.span
    far = 0.02 * (end - start)
    expect(table).to_contain_text("A, 12.000 s")  # where the link says that the replay stands
    expect(table).to_contain_text(f"C − A, {2 * far:.3f} s")
    rate = float(np.degrees(log.resample("q", [12.0 + far])[0]))
    shown = table.get_by_role("row", name="theta, q, q").get_by_role("cell").nth(1).inner_text()
    assert float(shown.replace("−", "-")) == pytest.approx(rate, abs=1.0)
    page.keyboard.press("Enter")
    expect(table).not_to_contain_text("C − A")

    page.get_by_role("button", name="Fold the steps").click()
    figures = page.get_by_role("table", name="Statistics of the steps of the attitude loop")
    steps = [one for one in folded_steps(log, step_responses(log)) if one.loop == "attitude"]
    count, mean, *_ = steps[0].statistics()["overshoot [%]"]
    row = figures.get_by_role("row").filter(has_text="overshoot").first
    expect(row.get_by_role("cell").nth(1)).to_have_text(f"{count:.0f}")
    assert float(row.get_by_role("cell").nth(2).inner_text()) == pytest.approx(mean, rel=1e-3)
    page.get_by_role("switch", name="Time from 0").click()
    expect(page.get_by_text(f"of 0.0 to {end - start:.1f} s")).to_be_visible()
    expect(page.get_by_role("button", name=f"Go to {13.0 - start:.2f} s: RATE_P set to 0.2")).to_be_visible()
    page.get_by_role("button", name="Choose signals").click()
    expect(page.get_by_role("checkbox", name="theta estimated pitch")).to_be_checked()
    readable(page, "logs-own")


def test_topics_of_another_vehicle_are_plotted(logs_server: Served, flights: Path, open_page: OpenPage) -> None:
    """Some of its signals are constant, whose ticks once kept the page busy for half a minute."""
    (flights / "flights" / "px4.ulg").write_bytes(px4_log())
    page = open_page(link(logs_server, "/px4.ulg"))
    opened(page)
    page.get_by_role("button", name="Choose signals").click()
    page.get_by_text("distance_sensor.1").click()
    page.get_by_role("checkbox", name="distance_sensor.1/current_distance").check()
    expect(page.get_by_role("heading", name="distance_sensor.1/current_distance")).to_be_visible()
    page.get_by_role("button", name="Rename").click()
    page.keyboard.press("Control+a")
    page.keyboard.type("my rover")
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile("my%20rover.ulg"))
    opened(page)
    assert (flights / "flights" / "my rover.ulg").exists()
    (flights / "flights" / "my rover.ulg").unlink()


def test_a_log_is_opened_by_keys(logs_server: Served, open_page: OpenPage) -> None:
    page = open_page(link(logs_server))
    page.get_by_role("link", name="attitude-steps").first.press("Enter")
    opened(page)
    expect(page.locator("main")).to_be_focused()  # the link that was followed is gone
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="All logs")).to_be_focused()


def test_a_log_is_uploaded_noted_downloaded_and_restored(
    logs_server: Served, flights: Path, open_page: OpenPage, tmp_path: Path
) -> None:
    source = flights / "flights" / FIRST
    dropped = tmp_path / "my flight (new).mat"
    write_log(read_log(source), dropped)
    page = open_page(link(logs_server))
    page.get_by_label("A log file").set_input_files(dropped)
    opened(page)
    name = "my flight -new-.mat"
    expect(page.get_by_text(f"{name} is added")).to_be_visible()
    page.get_by_label("Notes").fill("Gusts from the window.")
    page.get_by_role("button", name="Save notes").click()
    expect(page.get_by_text("Saved beside the log")).to_be_visible()
    notes = flights / "flights" / f"{name}.notes.txt"
    assert notes.read_text(encoding="utf-8") == "Gusts from the window."
    with page.expect_download() as got:
        page.get_by_role("button", name="Download as .parquet").click()
    assert got.value.suggested_filename == "my flight -new-.parquet"
    got.value.save_as(tmp_path / "got.parquet")
    np.testing.assert_array_equal(read_log(tmp_path / "got.parquet")["q"].value, read_log(source)["q"].value)
    page.get_by_role("button", name="Delete", exact=True).click()
    expect(page.get_by_text(f"{name} is deleted")).to_be_visible()
    expect(page.get_by_label(f"Choose {name}")).to_have_count(0)
    expect(page.get_by_role("button", name="Undo")).to_be_focused()  # what was pressed is gone
    page.keyboard.press("Enter")
    expect(page.get_by_label(f"Choose {name}")).to_be_visible()
    for _ in patiently():
        if notes.exists():
            break


def test_several_logs_come_in_one_zip_file(
    logs_server: Served, flights: Path, open_page: OpenPage, tmp_path: Path
) -> None:
    page = open_page(link(logs_server))
    for name in (FIRST, SECOND):
        page.get_by_label(f"Choose {name}").check()
    with page.expect_download() as got:
        page.get_by_role("button", name="Download 2 as .zip").click()
    got.value.save_as(tmp_path / "got.zip")
    with ZipFile(tmp_path / "got.zip") as archive:
        assert archive.testzip() is None
        assert set(archive.namelist()) == {FIRST, SECOND}
        assert archive.read(FIRST) == (flights / "flights" / FIRST).read_bytes()
    page.get_by_label("All", exact=True).check()
    expect(page.get_by_role("button", name=re.compile("^Download [3-9] as .zip$"))).to_be_visible()
    assert axe(page) == []


def test_an_upload_can_be_cancelled(logs_server: Served, flights: Path, open_page: OpenPage) -> None:
    page = open_page(link(logs_server))
    page.route("**/api/logs/cancelled.mcap", lambda route: None)  # on its way for ever
    content = (flights / "flights" / FIRST).read_bytes()
    page.get_by_label("A log file").set_input_files(
        {"name": "cancelled.mcap", "mimeType": "application/octet-stream", "buffer": content}
    )
    expect(page.get_by_role("progressbar", name="Sending cancelled.mcap")).to_be_visible()
    expect(page.get_by_role("button", name="Open a file")).to_be_disabled()
    page.get_by_role("button", name="Cancel").click()
    expect(page.get_by_text("cancelled.mcap is not added")).to_be_visible()
    expect(page.get_by_role("button", name="Open a file")).to_be_enabled()


def test_other_files_are_refused(logs_server: Served, open_page: OpenPage, tmp_path: Path) -> None:
    page = open_page(link(logs_server), expects=("422",))  # what is sent is refused
    for name, words in (("page.html", "page.html is not a log"), ("noise.ulg", "noise.ulg")):
        (tmp_path / name).write_bytes(b"<script>alert(1)</script>" * 40)
        page.get_by_label("A log file").set_input_files(tmp_path / name)
        expect(page.locator("main").get_by_role("alert")).to_contain_text(words)


def test_a_damaged_log_can_be_deleted(logs_server: Served, flights: Path, open_page: OpenPage) -> None:
    damaged = flights / "flights" / "shot.mcap"
    damaged.write_bytes((flights / "flights" / FIRST).read_bytes()[:2000])
    page = open_page(link(logs_server, f"/{damaged.name}"), expects=("422",))  # nothing can be recovered
    alert = page.locator("main").get_by_role("alert")
    expect(alert).to_contain_text(re.compile(f"{damaged.name} cannot be read.*It cannot be recovered"))
    expect(alert).not_to_contain_text(str(flights))
    expect(page.get_by_role("button", name="Download as")).to_have_count(1)
    expect(page.get_by_role("button", name="Download as .mcap")).to_be_enabled()
    page.get_by_role("button", name="Delete", exact=True).click()
    expect(page.get_by_text(f"{damaged.name} is deleted")).to_be_visible()
    assert not damaged.exists()


def test_a_cut_flight_is_recovered_where_it_is_opened(logs_server: Served, flights: Path, open_page: OpenPage) -> None:
    whole = (flights / "flights" / FIRST).read_bytes()
    (flights / "flights" / "cut.mcap").write_bytes(whole[: 2 * len(whole) // 3])
    page = open_page(link(logs_server, "/cut.mcap"))
    opened(page)
    expect(page.get_by_label("Messages")).to_contain_text(
        re.compile(r"cut.mcap is cut \(the recording was not closed.*\d+ samples are kept in cut.recovered.mcap")
    )
    assert "cut.recovered.mcap" in page.url
    expect(page.get_by_text("recovered from cut.mcap: the recording was not closed")).to_be_visible()
    readable(page, "log-recovered")
    page.go_back()
    expect(page.locator("main").get_by_role("alert")).to_contain_text("cut.mcap cannot be read")
    page.goto(link(logs_server, "/cut.mcap"))
    page.reload()
    expect(page.get_by_text("recovered from cut.mcap")).to_be_visible()
    assert not (flights / "flights" / "cut.recovered-2.mcap").exists()
    page.goto(link(logs_server))
    page.get_by_label("A log file").set_input_files(
        {"name": "sent.mcap", "mimeType": "application/octet-stream", "buffer": whole[: len(whole) // 2]}
    )
    expect(page.get_by_text("recovered from sent.mcap")).to_be_visible()


def test_a_watcher_changes_nothing(logs_server: Served, open_page: OpenPage) -> None:
    page = open_page(link(logs_server, token=WATCH))
    expect(page.get_by_role("link", name="attitude-steps").first).to_be_visible()
    expect(page.get_by_role("button", name=re.compile("^Delete"))).to_have_count(0)
    expect(page.get_by_role("button", name="Open a file")).to_have_count(0)
    page.goto(link(logs_server, f"/{FIRST}", WATCH))
    opened(page)
    expect(page.get_by_label("Notes")).to_have_attribute("readonly", "")
