"""docs/reference/blocks.md is what the docstrings say."""

from tools.library_docs import PAGE, render
from twodof.blocks.library import __all__


def test_the_page_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == render(), "run `python tools/library_docs.py`"


def test_the_page_has_every_block() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert [name for name in __all__ if f"### {name}\n" not in text] == ["FunctionBlock"]
