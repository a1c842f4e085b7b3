"""Lower priority for a program that is not to disturb what flies, on Linux also where each session has its share."""

import os
from contextlib import suppress
from pathlib import Path

_LOWEST = 19


def lower_priority(process: int, by: int) -> None:
    """Let the process, and what it starts, come after the others; what the system does not allow is left.

    By default Linux shares out its processors to sessions first (autogroup), and looks at the niceness of a process
    only within its own. A process that is to be told so has a session of its own.
    """
    with suppress(OSError):  # it has ended already
        niceness = min(_LOWEST, os.getpriority(os.PRIO_PROCESS, process) + by)
        os.setpriority(os.PRIO_PROCESS, process, niceness)
    with suppress(OSError):  # no such kernel
        group = Path(f"/proc/{process}/autogroup")
        if os.getsid(process) == process:
            now = int(group.read_text(encoding="ascii").rpartition(" ")[2])
            group.write_text(str(min(_LOWEST, now + by)), encoding="ascii")
