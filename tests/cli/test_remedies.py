"""What the command line puts in place of a call of Python is something that the package says."""

from __future__ import annotations

from pathlib import Path

import twodof
from twodof.cli import remedies


def test_each_call_that_is_replaced_stands_in_a_text_of_the_package() -> None:
    package = Path(twodof.__file__).parent
    own = Path(remedies.__file__)
    texts = [path.read_text(encoding="utf-8") for path in package.rglob("*.py") if path != own]
    assert [call for call in remedies.IN_SHELL if not any(call in text for text in texts)] == []
