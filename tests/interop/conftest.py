"""A virtual drone in real time, with the rings closed, as a process: what other people's clients are let loose on."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from bench.programs import running


@pytest.fixture(scope="module")
def fcu_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Where the flight controller listens, by TCP."""
    folder = tmp_path_factory.mktemp("fcu")
    with running("fcu", "--listen", "tcpin://127.0.0.1:0", "--rings", "--state", "state", urls=1, folder=folder) as fcu:
        yield fcu.urls[0]
