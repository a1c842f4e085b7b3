"""TWODOF_BATCH as a drone sends it, from rows of samples."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.link.mavlink.messages import BATCH_VALUES, message


def batch(tick: int, mask: int, rows: NDArray[np.float32], every: int = 1) -> list[Any]:
    """Pack samples (n, channels of `mask` by rising bit), `every` ticks apart from `tick` on, into few messages."""
    assert rows.shape[1] == mask.bit_count()
    most = BATCH_VALUES // rows.shape[1]
    return [
        message(
            "TWODOF_BATCH",
            channels=mask,
            tick=(tick + at * every) & 0xFFFFFFFF,
            values=rows[at : at + most].ravel().tolist(),
            rows=len(rows[at : at + most]),
            every=every,
        )
        for at in range(0, len(rows), most)
    ]
