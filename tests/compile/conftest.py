"""Fixtures of the tests of compiled programs."""

from pathlib import Path

import pytest


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep programs that are compiled only once out of the user's cache."""
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path / "cache"))
