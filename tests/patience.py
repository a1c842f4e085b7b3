"""How long a test waits before it says that something hangs: one figure for every wait that states nothing itself.

It ends what would wait for ever, and no machine, however loaded, takes so long over what works. A time that a test
*states* is measured where load does not count: in virtual time, control periods or processor time. Or it is compared
with something else that runs beside it.
"""

import time
from collections.abc import Iterator

PATIENCE_S = 120.0


def patiently() -> Iterator[None]:
    """A turn each millisecond or so, for what another thread or process brings about; AssertionError at the end."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        yield
        time.sleep(0.001)
    raise AssertionError(f"it did not come within {PATIENCE_S:g} s")
