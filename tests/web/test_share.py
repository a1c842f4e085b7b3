"""Share gives a link to the same view that only watches."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

from tests.web.conftest import OpenPage, readable
from tests.web.lab_server import LabServer

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_the_shared_link_only_watches(lab_server: LabServer, open_page: OpenPage) -> None:
    page = open_page(f"{lab_server.link}#/tune?drone={lab_server.drone}")
    page.get_by_role("button", name="Share").click()
    dialog = page.get_by_role("dialog", name="Let others watch")
    expect(dialog.get_by_text("can press the stop")).to_be_visible()
    link = dialog.get_by_label("Link for watching").input_value()
    assert re.search(rf"\?token=[\w-]{{32}}#/tune\?drone={lab_server.drone}$", link)
    readable(page, "share")
    viewer = open_page(link, "tablet")
    expect(viewer.get_by_role("link", name="Tune")).to_have_attribute("aria-current", "page")
    expect(viewer.get_by_role("button", name="Share")).to_have_count(0)
    expect(viewer.get_by_text("Watching only")).to_be_visible()
    assert "token" not in viewer.url
