"""The link of *Share* shows the same view and cannot change anything."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

from tests.web.conftest import OpenPage, readable
from tests.web.lab_server import LabServer

pytestmark = pytest.mark.slow


def test_the_watch_link_shows_the_same_view(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(f"{lab_server.link}#/tune?drone={lab_server.drone}")
    page.get_by_role("button", name="Share").click()
    dialog = page.get_by_role("dialog", name="Let others watch")
    expect(dialog.get_by_text("can press the stop")).to_be_visible()
    link = dialog.get_by_label("Link for watching").input_value()
    assert re.search(rf"\?token=[\w-]{{32}}#/tune\?drone={lab_server.drone}$", link)
    readable(page, "share")
    viewer = open_page(link, "tablet", expects=("403",))
    expect(viewer.get_by_role("link", name="Tune")).to_have_attribute("aria-current", "page")
    expect(viewer.get_by_role("button", name="Share")).to_have_count(0)
    assert "token" not in viewer.url  # nobody reads it over a shoulder, or copies it by mistake
    refused = viewer.evaluate(
        """async (number) => {
            const token = sessionStorage.getItem("twodof-token");
            const headers = { Authorization: `Bearer ${token}` };
            return (await fetch(`api/drones/${number}/arm`, { method: "POST", headers })).status;
        }""",
        lab_server.drone,
    )
    assert refused == 403
