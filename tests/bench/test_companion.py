"""The benchmark of the companion measures frames that came, all of them."""

import asyncio
from pathlib import Path

import pytest

from bench.stack import companion

pytestmark = pytest.mark.slow


def test_every_frame_is_measured(tmp_path: Path) -> None:
    ends, each = asyncio.run(companion.through(0.5, tmp_path))
    assert len(ends.down) == sum(key > 0 for key in ends.sent) > 50
    assert len(ends.up) == sum(key < 0 for key in ends.sent)
    assert min(ends.down + ends.up) > 0.0
    assert each >= 0.0  # of a clock that counts in hundredths of a second
    assert all(share > 0.0 for share in companion.own_share(2, 200, 1))
