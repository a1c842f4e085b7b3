"""Runs the tests while their processes are stopped at random, as a loaded machine does: what fails then is flaky.

python tools/shake.py SEED COMMAND...   any command; `make shake` runs every test. Linux.

The command's processes, and those that they start, stand still one after another: for .08 s in the mean and for
`LONGEST_S` at most. In between all run for .02 s in the mean. A drone whose pilot stands still for longer than its
failsafe waits makes itself safe, as it should. No test may fail because of that, or take it for a fault.
"""

import os
import random
import signal
import subprocess
import sys
import time
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

STOPPED_S, RUNNING_S, LONGEST_S = 0.08, 0.02, 1.5
UNFIT = "ZTtX"  # ended, or stopped by somebody else


def state_and_parent(process: Path) -> tuple[str, int]:
    """As proc(5) has them behind the name in parentheses. Raises OSError for one that is gone."""
    state, parent = (process / "stat").read_text().rpartition(")")[2].split()[:2]
    return state, int(parent)


def family(root: int) -> list[int]:
    """`root` and its descendants that can be stopped now."""
    children: dict[int, list[tuple[int, str]]] = defaultdict(list)
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                state, parent = state_and_parent(entry)
                children[parent].append((int(entry.name), state))
    found, todo = [root], [root]
    while todo:
        for process, state in children[todo.pop()]:
            todo.append(process)
            found += [] if state in UNFIT else [process]
    return found


def shake(root: int, chance: random.Random) -> None:
    """Stop one of the family for a while."""
    process = chance.choice(family(root))
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGSTOP)
        try:
            time.sleep(min(chance.expovariate(1.0 / STOPPED_S), LONGEST_S))
        finally:
            os.kill(process, signal.SIGCONT)


def main(seed: int, command: list[str]) -> int:
    """The exit status of the command."""
    chance = random.Random(seed)
    with subprocess.Popen(command) as process:
        try:
            while process.poll() is None:
                shake(process.pid, chance)
                time.sleep(chance.expovariate(1.0 / RUNNING_S))
        finally:
            process.terminate()
    return process.returncode


if __name__ == "__main__":
    if len(sys.argv) < 3 or not sys.argv[1].isdecimal():
        sys.exit(__doc__)
    sys.exit(main(int(sys.argv[1]), sys.argv[2:]))
