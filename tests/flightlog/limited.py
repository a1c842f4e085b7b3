"""Runner of commands in processes of their own with limits, which measures what they use.

As a program: reads one JSON list of arguments a line, runs `twodof` with it in a fork, and writes one line of JSON.
A fork, so that what all of them import is imported once.
"""

import contextlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ADDRESSES = 12 << 30
"""So that a failing test fails and takes no machine with it [bytes]."""
CPU_S = 60


@dataclass(frozen=True)
class Used:
    """Result of a command: exit status (negative for a signal), stderr, CPU time [s] and peak memory [MiB]."""

    status: int
    said: str
    cpu_s: float
    peak_mib: float


class Limited:
    """Process that forks for one command after the other."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process

    def run(self, *arguments: str | Path) -> Used:
        """Run `twodof` with these arguments."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([str(one) for one in arguments]) + "\n")
        self._process.stdin.flush()
        return Used(*json.loads(self._process.stdout.readline()))


@contextmanager
def limited() -> Iterator[Limited]:
    """Yield a process that runs commands as long as the block lasts."""
    with subprocess.Popen(
        [sys.executable, "-m", "tests.flightlog.limited"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        # Threads of numpy's own do not survive a fork, and the time of all of them counts.
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        cwd=Path(__file__).resolve().parents[2],
    ) as process:
        try:
            yield Limited(process)
        finally:
            process.kill()


def _child(arguments: list[str], said: Path) -> int:
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
    from twodof.cli.app import run
    from twodof.flightlog import fence

    with said.open("w") as file, Path(os.devnull).open("w") as nowhere:
        os.dup2(file.fileno(), 2)
        os.dup2(nowhere.fileno(), 1)
        status = 99
        with contextlib.suppress(SystemExit):
            status = run(arguments)
        fence.close()  # what its processes have used counts, too
        sys.stderr.flush()
        sys.stdout.flush()
    return status


def _serve(lines: Iterable[str]) -> None:
    import twodof.cli.identify
    import twodof.cli.log
    import twodof.cli.simulate
    import twodof.report.plots.flight_plot  # noqa: F401
    from twodof.cli import app

    with contextlib.redirect_stdout(None), contextlib.redirect_stderr(None):
        app.run(["log", "info", "--help"])  # what the parser of arguments imports when it is first used
    assert threading.active_count() == 1
    with tempfile.TemporaryDirectory() as folder:
        said = Path(folder, "said")
        for line in lines:
            said.write_text("")
            child = os.fork()
            if not child:
                status = 98
                try:
                    status = _child(json.loads(line), said)
                except BaseException as reason:  # noqa: BLE001
                    said.write_text(f"not caught: {reason!r:.2000}")
                finally:
                    os._exit(status)
            _, ended, used = os.wait4(child, 0)
            cpu = used.ru_utime + used.ru_stime
            found = (os.waitstatus_to_exitcode(ended), said.read_text()[-3000:], cpu, used.ru_maxrss / 1024)
            sys.stdout.write(json.dumps(found) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    _serve(sys.stdin)
