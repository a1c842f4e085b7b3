"""Virtual drones as child processes in lockstep; the error of a child that ended."""

import re
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from twodof.errors import LinkError

START_S = 120.0
"""Deadline for all drones to listen [s]; the first time they compile flight code and rig."""

END_S = 5.0
"""Time a drone has to end [s]; it is killed afterwards."""

_LISTENING = re.compile(rb"listening on tcpin(\S+)\s")  # the whole of the line
_MOST_SAID = 50  # lines


@contextmanager
def virtual_drone(
    rig: str = "lab",
    rings: bool = False,
    controllers: Iterable[str | Path] = (),
    options: Sequence[str] = (),
    seed: int = 1,
) -> Iterator[str]:
    """Start one drone, as `virtual_drones` does, and yield its URL."""
    with virtual_drones(1, rig, rings, controllers, options, seed) as (url,):
        yield url


@contextmanager
def virtual_drones(
    count: int,
    rig: str = "lab",
    rings: bool = False,
    controllers: Iterable[str | Path] = (),
    options: Sequence[str] = (),
    seed: int = 1,
) -> Iterator[list[str]]:
    """Start `count` drones on virtual rigs in lockstep and yield their URLs; the drones end with the block.

    Each listens on the loopback interface, on a port that the system chooses, and keeps no files. Drone k has the noise
    of `seed` + k. `rig` is "lab", "paper" or a JSON file of rig parameters; `rings` locks the cart. `controllers` are
    JSON files of diagrams or names of starters, which fly in a sandbox. `options` are passed to `twodof fcu`. Raises
    LinkError if a drone does not start.
    """
    given = ["--rings", *options] if rings else [*options]
    given += [option for name in controllers for option in ("--controller", str(name))]
    with TemporaryDirectory(prefix="twodof-") as folder, ExitStack() as stack:
        drones: list[_Drone] = []
        stack.callback(_end, drones)
        for number in range(count):
            own = ["--seed", str(seed + number), "--state", str(Path(folder) / str(number))]
            drones.append(_Drone(["--lockstep", "--rig", str(rig), *own, *given]))
        end = time.monotonic() + START_S
        yield [drone.url(f"virtual drone on the rig {rig}", end) for drone in drones]


class _Drone:
    """Process of a drone, and a thread that reads its output: a full pipe would block the drone."""

    def __init__(self, options: Sequence[str]) -> None:
        command = [sys.executable, "-m", "twodof.fleet.child", "fcu", "--listen", "tcpin://127.0.0.1:0", *options]
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,  # never written to: the child ends when this pipe closes
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        self._said: deque[str] = deque(maxlen=_MOST_SAID)
        self._url: Future[str] = Future()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        pipe = self.process.stdout
        assert pipe is not None
        with pipe:
            for line in pipe:
                self._said.append(line.decode(errors="replace"))
                if not self._url.done() and (found := _LISTENING.search(line)):
                    self._url.set_result("tcp" + found[1].decode())
        if not self._url.done():
            self._url.cancel()

    def url(self, name: str, end: float) -> str:
        """Return the drone's URL when it listens. `end` is the deadline on the monotonic clock."""
        try:
            return self._url.result(max(0.0, end - time.monotonic()))
        except (CancelledError, TimeoutError) as reason:
            raise child_error("".join(self._said).splitlines(), name) from reason


def _end(drones: Sequence[_Drone]) -> None:
    """Terminate the processes, and kill them after `END_S`."""
    for drone in drones:
        drone.process.terminate()
    end = time.monotonic() + END_S
    for drone in drones:
        try:
            drone.process.wait(max(0.0, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            drone.process.kill()
            drone.process.wait()
        if drone.process.stdin is not None:
            drone.process.stdin.close()


_WHAT, _WHERE, _REMEDY = "error:", "  where:", "  remedy:"


def indented_lines(said: Sequence[str]) -> str:
    """Join the lines of a program's output, each on an indented line of its own; "no output" if there are none."""
    return "".join(f"\n    {line}" for line in said if line.strip()) or "\n    no output"


def child_error(said: Sequence[str], name: str, status: int | None = None) -> LinkError:
    """Return an error for the program `name` that ended, made from `said`, the last lines of its output.

    If they hold an error of a `twodof` command, the result has its fact, place and remedy; otherwise it has all lines.
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
