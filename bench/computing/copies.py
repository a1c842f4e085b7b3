"""Compiling time of a large diagram: 2,400 blocks."""

from bench.computing.start_up import build_seconds
from bench.measure import Figure

LARGE = 2400
SECONDS = 8.0


def run(quick: bool = False) -> list[Figure]:
    """Return the figure."""
    blocks = 60 if quick else LARGE
    new, _, emitted = build_seconds(str(blocks), "cc", 1)[0]
    remark = f"of which tracing and emitting {emitted:.2f}"
    name = f"{blocks} blocks: source to loaded native code"
    return [Figure(name, new, "s", SECONDS, at_most=True, remark=remark)]
