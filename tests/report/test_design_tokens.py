"""The design's colours are in one place: the report and the documentation have copies, made by a tool."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tools.design_tokens import COPIES, SOURCE, render
from twodof.report.design_tokens import colours, style
from twodof.report.plots.canvas import on_paper
from twodof.report.template_texts import text


@pytest.mark.parametrize("copy", COPIES, ids=lambda path: path.parent.name)
def test_a_copy_is_the_source(copy: Path) -> None:
    assert copy.read_text(encoding="utf-8") == render(), "run: python -m tools.design_tokens"


def test_the_report_has_every_colour_of_the_page_in_both_themes() -> None:
    named = set(re.findall(r"--([\w-]+):[^;]*#", SOURCE.read_text(encoding="utf-8")))
    assert set(colours()) == named
    light, dark = style().split("@media", 1)
    for name, shades in colours().items():
        assert f"--{name}: {shades.light};" in light
        assert f"--{name}: {shades.dark};" in dark


def test_what_the_style_sheet_and_the_figures_use_is_there() -> None:
    used = set(re.findall(r"var\(--([\w-]+)\)", text("style.css")))
    assert used <= {*colours(), "paper"}
    assert on_paper()["paper"] == colours()["truth"].light
