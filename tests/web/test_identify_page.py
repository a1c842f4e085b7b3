"""The Identify page on a real virtual drone: from a choice to a controller, by clicks alone."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Page, Route, expect

from tests.lab.served import ServedLab, served_lab
from tests.patience import PATIENCE_S
from tests.web.conftest import OpenPage, axe, picture, readable
from twodof.experiment.flight import Laboratory
from twodof.flightlog.files import write_log
from twodof.gcs import Drone

pytestmark = pytest.mark.slow

LONG_MS = PATIENCE_S * 1000


@pytest.fixture(scope="module")
def lab(built_page: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedLab]:
    assert (built_page / "index.html").is_file()
    folder = tmp_path_factory.mktemp("lab")
    (folder / "flights").mkdir()
    laboratory = Laboratory("paper")
    for name in ("impulse", "doublet"):
        log = laboratory.fly(name).log
        said = {**log.provenance, "flown": {"virtual": True}}
        write_log(replace(log, provenance=said), folder / "flights" / f"2026-01-01-10-00-00-{name}.mcap")
    with served_lab(folder) as found:
        yield found


def link(lab: ServedLab, query: str = "") -> str:
    return f"http://127.0.0.1:{lab.port}/#/identify{query}"


def fitted(page: Page) -> None:
    """Identify from the chosen log, and wait for the verdict."""
    page.get_by_role("button", name="Identify", exact=True).click()
    expect(page.get_by_text("(95 % intervals)")).to_be_visible(timeout=LONG_MS)


def decimals(number: str) -> int:
    return len(number.partition(".")[2])


def with_another_truth(route: Route) -> None:
    """Answer with a fit whose interval of mu misses the rig's value."""
    answer = route.fetch()
    job = answer.json()
    for row in job["result"]["view"]["estimates"] if job["result"] else ():
        if row["name"] == "mu":
            row["truth"] = 2.0 * row["high"]
    route.fulfill(response=answer, json=job)


@pytest.mark.long
def test_from_a_stored_log_to_a_controller(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab, "?log=2026-01-01-10-00-00-doublet.mcap"))
    expect(page.get_by_label("Poles from the impulse in")).to_have_value("2026-01-01-10-00-00-impulse.mcap")
    page.get_by_text("More", exact=True).click()
    page.get_by_label("Structure").select_option("pitch-rate")
    fitted(page)
    gain = page.get_by_role("row", name=re.compile(r"^mu gain\b"))
    expect(gain).to_contain_text(re.compile(r"358\.50*\s+●\s+in the interval"))
    expect(page.get_by_text("True value outside")).to_have_count(0)
    page.route("**/api/jobs/*", with_another_truth)
    page.get_by_role("button", name="Identify", exact=True).click()
    expect(page.get_by_text("True value outside the interval: mu")).to_be_visible(timeout=LONG_MS)
    expect(gain).to_contain_text("outside the interval")
    picture(page, "identify-truth-missed")
    page.unroute("**/api/jobs/*")
    expect(page.get_by_role("heading", name="Correlation of the estimates")).to_be_visible()
    expect(page.get_by_text("By hand, step by step")).to_be_visible()
    assert axe(page) == []
    named = page.get_by_label("Keep the model as")
    expect(named).to_have_attribute("placeholder", re.compile(r"^doublet \d\d-\d\d \d\d\.\d\d$"))
    named.fill("from the page")
    page.get_by_role("button", name="Keep it").click()
    expect(page.get_by_role("row", name=re.compile("^from the page"))).to_be_visible()
    # What was pressed is gone; the keyboard goes on at what came of it.
    expect(page.get_by_role("tab", name="Models and design")).to_be_focused()
    page.get_by_role("button", name="Design it").click()
    expect(page.get_by_text(re.compile(r"Robust$"))).to_be_visible(timeout=LONG_MS)
    expect(page.get_by_role("button", name="Design it")).to_be_focused()
    opened = page.get_by_role("link", name="in the diagram editor")
    assert "#/diagram/for%20from%20the%20page" in str(opened.get_attribute("href"))
    assert (lab.folder / "diagrams" / "for from the page.json").is_file()
    assert axe(page) == []
    picture(page, "identify-designed")
    page.get_by_role("button", name="Tune with it").click()
    expect(page.get_by_label("Model", exact=True)).to_have_value("from the page")


@pytest.mark.long
def test_the_drone_flies_what_was_previewed(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab, "?experiment=velocity-doublet"))
    page.get_by_role("button", name="Preview the accuracy").click()
    expect(page.get_by_role("row", name="k_v")).to_be_visible(timeout=LONG_MS)
    expect(page.get_by_text("of the rail")).to_be_visible()
    assert lab.call("POST", "drones/1/reset", {"rings": True})[0] == 200
    page.get_by_role("button", name="Fly velocity-doublet").click()
    expect(page.get_by_text("all checks passed")).to_be_visible(timeout=LONG_MS)
    with Drone.connect(lab.call("GET", "drones/1")[1]["url"]) as drone:
        assert drone.state.rig.rings_locked, "it is put back as it was"
    expect(page.get_by_text("It was not put back")).to_be_hidden()
    expect(page.get_by_role("combobox", name="Log", exact=True)).to_have_value(re.compile(r"-velocity-doublet\.mcap$"))


def test_a_flight_that_is_stopped_says_so(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab, "?experiment=attitude-prbs"))
    page.get_by_role("button", name="Fly attitude-prbs").click()
    page.get_by_role("button", name="Stop the flight").click()
    expect(page.get_by_text("interrupted").or_(page.get_by_text("stopped before")).first).to_be_visible(timeout=LONG_MS)


def test_a_refusal_appears_beside_the_button(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab, "?log=2026-01-01-10-00-00-impulse.mcap"))
    page.get_by_label("Experiment in it").select_option("velocity")
    page.get_by_role("button", name="Identify", exact=True).click()
    expect(page.get_by_role("alert").filter(has_text="holds no excitation")).to_be_visible(timeout=LONG_MS)


def test_it_goes_on_waiting_for_a_busy_computer(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab).replace("identify", "logs"), expects=("504",))
    slow = {"what": "the work took longer than 30 s", "where": "log", "remedy": "ask for less"}
    for asked in ("identification", "identification/plan", "jobs/*"):
        page.route(f"**/api/{asked}", lambda route: route.fulfill(status=504, json=slow), times=1)
    page.get_by_role("link", name="Identify", exact=True).click()
    waits = page.get_by_text("It is asked again by itself")
    expect(waits).to_be_visible()
    expect(page.get_by_text("The logs are being listed")).to_be_visible()
    expect(page.get_by_role("combobox", name="Log", exact=True)).to_be_visible()
    expect(waits).to_be_hidden()
    page.get_by_role("button", name="Preview the accuracy").click()
    expect(page.get_by_role("row", name="w_n")).to_be_visible(timeout=LONG_MS)
    for row in page.get_by_role("table", name="Expected standard deviations").get_by_role("row").all()[1:]:
        _, value, sigma, *_ = row.get_by_role("cell").all_inner_texts()
        assert decimals(value) == decimals(sigma), row.inner_text()


@pytest.mark.long
def test_it_fits_and_can_be_read(lab: ServedLab, open_page: OpenPage) -> None:
    page = open_page(link(lab, "?log=2026-01-01-10-00-00-impulse.mcap&experiment=impulse"))
    fitted(page)
    readable(page, "identify")
