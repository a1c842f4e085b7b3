"""The golden files: two small modules, as they were last looked at.

`python -m tests.compile.px4.golden` writes them anew; look at the difference before it is committed.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

from tests.compile.px4.modules import PITCH_LOG, pitch, rail
from twodof.compile.px4.export import Px4Module, make_module
from twodof.compile.px4.tree import write_tree

GOLDEN = Path(__file__).parent / "golden"
MODULES: Mapping[str, Callable[[], Px4Module]] = {
    "pitch": lambda: make_module(pitch(), PITCH_LOG),
    "rail": lambda: make_module(rail()),
}


def write() -> None:
    """Write all of them."""
    for name, made in MODULES.items():
        write_tree(GOLDEN / name, made().files, force=True)


if __name__ == "__main__":
    write()
