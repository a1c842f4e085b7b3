"""The report stands alone, is well formed, says every figure it was given and is the same file every time."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import pytest

from tests.report.made_up import HOSTILE, content
from twodof.report.content import Content, Figure, Subject
from twodof.report.plots.time_figures import time_figure
from twodof.report.report_page import to_html

pytestmark = pytest.mark.slow

VOID = {"meta", "br", "hr", "img", "link", "input"}


@pytest.fixture(scope="module")
def page() -> str:
    return to_html(content())


class Nesting(HTMLParser):
    """Follows open elements; `wrong` lists end tags that close something else."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.wrong: list[str] = []
        self.ids: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids += [value or "" for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids += [value or "" for name, value in attrs if name == "id"]

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


def parsed(page: str) -> Nesting:
    parser = Nesting()
    parser.feed(page)
    return parser


@pytest.mark.long
def test_every_element_is_closed_and_every_anchor_exists(page: str) -> None:
    parser = parsed(page)
    assert parser.open == []
    assert parser.wrong == []
    for anchor in re.findall(r'href="#([^"]+)"', page):
        assert anchor in parser.ids, anchor
    assert {"table-1", "figure-3", "figure-4", "residuals", "doubts", "errata", "provenance"} <= set(parser.ids)


@pytest.mark.long
def test_it_needs_nothing_from_outside(page: str) -> None:
    assert "<script" not in page
    assert not re.findall(r'(?:src|href)="(?!#)[^"]*"', page)
    assert not re.findall(r"@import|url\((?!#)", page)


def test_the_same_figure_gives_the_same_bytes() -> None:
    figure = content().subjects[0].figures[0]
    assert len({time_figure(figure, "a title") for _ in range(2)}) == 1


def test_figures_take_the_colours_of_the_page(page: str) -> None:
    drawings = re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)
    # One figure of the estimates, two figures and one of residuals for each of the two machines.
    assert len(drawings) == 1 + 2 * 3
    declared = set(re.findall(r"(--[\w-]+):", page))
    for drawing in drawings:
        ElementTree.fromstring(drawing.replace("<svg ", '<svg xmlns:xlink="http://www.w3.org/1999/xlink" ', 1))
        colours = set(re.findall(r"(?:fill|stroke): (#[0-9a-f]{3,8})", drawing))
        assert colours == set(), "a fixed colour is unreadable in light or in dark"
        assert set(re.findall(r"var\((--[\w-]+)\)", drawing)) <= declared


def test_numbers_in_the_table_are_those_given(page: str) -> None:
    text = parsed(page).text
    for shown in ("3.437", "0.08361 ± 0.00026", "357.9 ± 1.3", "−0.2 %, 0.5 σ", "4.748", "–"):
        assert shown in text, shown


def test_a_caption_ties_numbers_to_their_units(page: str) -> None:
    assert "M = 0.1 for 0.2\N{NO-BREAK SPACE}s, then free. Period 1.83\N{NO-BREAK SPACE}s" in page


def test_names_are_text_and_not_markup(page: str) -> None:
    assert HOSTILE in [subject.name for subject in content().subjects]
    assert "<script" not in page
    assert HOSTILE in parsed(page).text


def test_without_checks_errata_and_doubts_their_sections_are_left_out() -> None:
    made = content()
    bare = Subject("bare", "nothing but a table", made.subjects[0].rows)
    text = to_html(Content("t", "l", [], [bare]))
    ids = parsed(text).ids
    assert "table-1" in ids
    assert not {"residuals", "doubts", "errata", "provenance", "figure-3"} & set(ids)


def test_cards_stand_in_as_many_columns_as_there_are_machines(page: str) -> None:
    assert set(re.findall(r'class="grid ([^"]*)"', page)) == {"of-2"}
    one = replace(content().subjects[0], figures=[Figure(6, "loop", "", picture="<svg/>")], checks=())
    three = to_html(replace(content(), subjects=[replace(one, name=f"rig {k}") for k in range(3)]))
    assert set(re.findall(r'class="grid ([^"]*)"', three)) == {"of-3"}
