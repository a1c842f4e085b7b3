"""Processes of this machine, as tests look at them."""

from pathlib import Path


def alive(process: int) -> bool:
    """Whether a process runs; one that ended and was not waited for (by whoever inherited it) does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
