"""Input of commands: files, pipes such as the shell's <(...), and standard input."""

import sys
from contextlib import nullcontext
from pathlib import Path

from twodof.errors import LogError


def read_input(source: str | Path, most: int) -> bytes:
    """Return the bytes of a file or pipe, or of standard input for "-".

    Raises LogError if it cannot be read or has more than `most` bytes.
    """
    standard = str(source) == "-"
    where = "standard input" if standard else str(source)
    try:
        with nullcontext(sys.stdin.buffer) if standard else Path(source).open("rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError) as refusal:
        why = refusal.strerror if isinstance(refusal, OSError) else refusal  # a name with a null character
        raise LogError(f"cannot be read: {why}", where, "check the name and the rights") from refusal
    if len(content) > most:
        raise LogError(f"has more than {most} bytes", where, "check that it is the right file")
    return content
