"""The documentation as a site: built strictly, every page in its list, and nothing fetched from elsewhere."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from tests.toolchains import lacking
from tools import cli_docs, lab_docs, site

pytestmark = pytest.mark.slow

PAGE = '<a href="https://a.b/">a</a><script src="https://c.d/e.js"></script><img src="pictures/f.png">'


@pytest.mark.soak
def test_the_site_is_built_with_all_pages_and_stands_alone(tmp_path: Path) -> None:
    if importlib.util.find_spec("zensical") is None:
        lacking("zensical is missing: `make docs` installs it")
    built = site.build(tmp_path / "gathered")
    pages = [page.relative_to(site.DOCS).with_suffix(".html") for page in site.DOCS.rglob("*.md")]
    assert [str(page) for page in pages if not (built / page).is_file()] == []
    assert (built / "search.json").is_file()
    assert site.fetched_from_elsewhere(built) == []
    # The docstring of a method that every script uses, from the source.
    assert "set_pitch" in (built / "reference" / "api" / "gcs.html").read_text(encoding="utf-8")


def test_every_page_is_in_the_list_of_pages() -> None:
    configuration = site.CONFIGURATION.read_text(encoding="utf-8")
    assert site.not_listed(configuration) == [], "add it to nav in mkdocs.yml"
    assert site.not_listed(configuration.replace("      - explanation/physics.md\n", "")) == ["explanation/physics.md"]


def test_what_would_be_fetched_from_elsewhere_is_found(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(PAGE)
    (tmp_path / "b.css").write_text("a { background: url(//g.h/i.png) } b { background: url(j.png) }")
    assert site.fetched_from_elsewhere(tmp_path) == ["a.html: https://c.d/e.js", "b.css: //g.h/i.png"]


@pytest.mark.parametrize(
    ("link", "text"),
    [
        ("[a](language.md)", "[a](language.md)"),
        ("[a](https://b.c)", "[a](https://b.c)"),
        ("[the dialect](../../src/twodof/link/dialect.xml)", "the dialect (`src/twodof/link/dialect.xml`)"),
        ("[examples/](../../examples)", "`examples`"),
    ],
)
def test_a_link_out_of_the_site_becomes_the_name_of_its_file(link: str, text: str) -> None:
    assert site.standing_alone(link, "explanation/physics.md") == text


def test_the_page_of_the_routes_is_what_the_server_says() -> None:
    assert lab_docs.PAGE.read_text(encoding="utf-8") == lab_docs.render(), "run `python -m tools.lab_docs`"


def test_the_page_of_the_command_line_is_what_the_commands_say() -> None:
    assert cli_docs.PAGE.read_text(encoding="utf-8") == cli_docs.render(), "run `python tools/cli_docs.py`"
