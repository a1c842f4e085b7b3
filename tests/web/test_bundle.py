"""Size of the page: everything together, and the files of its first view."""

import gzip
import re
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow  # it builds the page

WHOLE = 1_500_000
"""Bytes, gzipped, of everything that any page of it loads."""

FIRST = 250_000
"""Of what is loaded before anything is seen: a tenth of a second at 20 Mbit/s."""


def _gzipped(path: Path) -> int:
    return len(gzip.compress(path.read_bytes(), 6))


def test_the_page_is_small(built_page: Path) -> None:
    sizes = {path: _gzipped(path) for path in built_page.rglob("*") if path.is_file() and path.name != "built-from"}
    listed = "\n".join(f"{size:9,d} {path.relative_to(built_page)}" for path, size in sorted(sizes.items()))
    first = re.findall(r"(?:src|href)=\"\./([^\"]+)\"", (built_page / "index.html").read_text(encoding="utf-8"))
    assert first
    sys.stdout.write(f"\n{listed}\n{sum(sizes.values()):9,d} in all\n")
    assert sum(sizes.values()) < WHOLE, listed
    assert sum(sizes[built_page / name] for name in first) < FIRST, first
    # Fetched from the page's own server: a map or a picture from elsewhere would be a request out.
    assert not [path for path in sizes if path.suffix == ".map"]
