"""docs/reference/blocks.md is what the docstrings say."""

from tools.library_docs import PAGE, render
from twodof.blocks import library
from twodof.blocks.block import Block


def test_the_page_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == render(), "run `python tools/library_docs.py`"


def test_the_page_has_every_block() -> None:
    text = PAGE.read_text(encoding="utf-8")
    names = [name for name, c in vars(library).items() if isinstance(c, type) and issubclass(c, Block)]
    assert [name for name in names if f"### {name}\n" not in text] == ["FunctionBlock"]
