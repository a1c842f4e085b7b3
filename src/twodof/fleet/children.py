"""Child processes: the error with which one ended, and a lower priority for programs beside a flight."""

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from twodof.errors import LinkError

_WHAT, _WHERE, _REMEDY = "error:", "  where:", "  remedy:"


def indented_lines(said: Sequence[str]) -> str:
    """Return the lines one below the other and indented; "no output" without any."""
    return "".join(f"\n    {line}" for line in said if line.strip()) or "\n    no output"


def child_error(said: Sequence[str], name: str, status: int | None = None) -> LinkError:
    """Return the error with which the program `name` ended, from its last lines.

    Where it is one of ours (`output.print_error`) it has that one's fact, place and remedy; else it shows all lines.
    """
    begins = [number for number, line in enumerate(said) if line.startswith(_WHAT)]
    if not begins:
        ended = "it ended" if status is None else f"it ended with status {status}"
        return LinkError(f"{ended}; its last output:{indented_lines(said)}", name, "mend the fault in this output")
    last = [line.rstrip() for line in said[begins[-1] :]]
    what = [last[0].removeprefix(_WHAT).strip()]
    where = remedy = ""
    for line in last[1:]:
        if line.startswith(_WHERE):
            where = line.removeprefix(_WHERE).strip()
        elif line.startswith(_REMEDY):
            remedy = line.removeprefix(_REMEDY).strip()
        elif line.strip() and not remedy:
            what.append(line.rstrip())
    return LinkError("\n".join(what), f"{name}, {where}" if where else name, remedy)


_LOWEST = 19


def lower_priority(process: int, by: int) -> None:
    """Let the process, and what it starts, come after the others; what the system does not allow is left.

    By default Linux shares out its processors to sessions first (autogroup), and looks at the niceness of a process
    only within its own. Such a process therefore has a session of its own.
    """
    with suppress(OSError):  # it has ended already
        niceness = min(_LOWEST, os.getpriority(os.PRIO_PROCESS, process) + by)
        os.setpriority(os.PRIO_PROCESS, process, niceness)
    with suppress(OSError):  # no such kernel
        group = Path(f"/proc/{process}/autogroup")
        if os.getsid(process) == process:
            now = int(group.read_text(encoding="ascii").rpartition(" ")[2])
            group.write_text(str(min(_LOWEST, now + by)), encoding="ascii")
