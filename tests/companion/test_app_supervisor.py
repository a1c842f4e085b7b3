"""An app as a child process: its crashes, its floods of words, its limits, and that nothing of it is left."""

import asyncio
import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.companion.scripted import until
from tests.link.ends import in_loop
from tests.patience import PATIENCE_S
from tests.processes import alive, started
from twodof.companion.app_supervisor import LONGEST_LINE, MOST_LINES, AppLimits, AppSupervisor, RestartPolicy

pytestmark = pytest.mark.slow

QUICK = RestartPolicy(first=0.05, longest=0.1, most=2)


def program(folder: Path, text: str) -> list[str]:
    """A command that runs a script."""
    file = folder / "app.py"
    file.write_text(textwrap.dedent(text))
    return [sys.executable, "-I", "-S", "-u", str(file)]


def test_what_ends_by_itself_is_not_started_again(tmp_path: Path) -> None:
    said: list[str] = []
    made = AppSupervisor(program(tmp_path, "print('all well')"), said.append, restarts=QUICK)
    assert asyncio.run(made.run()) == 0
    assert (made.starts, said) == (1, ["all well"])


@pytest.mark.parametrize(
    ("text", "status", "words"),
    [
        ("raise ValueError('no such gain')", 1, "ended with status 1"),
        ("import os; os.kill(os.getpid(), 11)", 139, "ended by SIGSEGV"),
        ("import os; os._exit(77)", 77, "ended with status 77"),
    ],
)
def test_what_crashes_is_started_again_so_often_and_no_more(tmp_path: Path, text: str, status: int, words: str) -> None:
    said: list[str] = []
    made = AppSupervisor(program(tmp_path, text), said.append, restarts=QUICK)
    assert asyncio.run(made.run()) == status
    assert made.starts == 1 + QUICK.most
    ours = [line for line in said if line.startswith("app: ")]
    assert ours == [
        f"app: {words}; started again in 0.05 s",
        f"app: {words}; started again in 0.1 s",
        f"app: {words}; it crashed 3 times in a row: given up",
    ]


@in_loop
async def test_what_crashed_is_not_started_again_while_its_drone_is_killed(tmp_path: Path) -> None:
    """After a kill the app waits, says so, and is started again once the kill was released."""
    said: list[str] = []
    killed = [True]
    made = AppSupervisor(program(tmp_path, "raise ValueError"), said.append, restarts=QUICK, killed=lambda: killed[0])
    running = asyncio.ensure_future(made.run())
    await until(lambda: any("was killed" in line for line in said), PATIENCE_S)
    for _ in range(5):
        await asyncio.sleep(QUICK.longest)
        assert made.starts == 1
    killed[0] = False
    assert await asyncio.wait_for(running, PATIENCE_S) == 1
    assert made.starts == 1 + QUICK.most
    assert sum("was killed" in line for line in said) == 1


def test_a_mistake_of_the_caller_is_not_tried_again(tmp_path: Path) -> None:
    made = AppSupervisor(program(tmp_path, "raise SystemExit(2)"), lambda line: None, restarts=QUICK)
    assert asyncio.run(made.run()) == 2
    assert made.starts == 1


def test_a_flood_of_words_is_cut_and_does_not_hold_it_up(tmp_path: Path) -> None:
    said: list[str] = []
    text = """
        import sys
        sys.stdout.write("x" * 100_000 + "\\n")
        for number in range(20_000):
            sys.stdout.write(f"line {number} \\x1b[31m\\n")
        sys.stdout.buffer.write(bytes(range(128, 256)))
    """
    made = AppSupervisor(program(tmp_path, text), said.append, restarts=QUICK)
    assert asyncio.run(made.run()) == 0
    assert MOST_LINES - 1 <= len(said) <= MOST_LINES + 1000  # a slow machine gives it seconds
    left_out = [int(line.split()[1]) for line in said if line.endswith("lines left out")]
    assert sum(left_out) > 15_000
    assert all(len(line) <= LONGEST_LINE and line.isprintable() for line in said)


STUBBORN = """
    import os, signal, subprocess, sys, time
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    child = subprocess.Popen([sys.executable, "-I", "-S", "-c", "import time; time.sleep(600)"])
    print("here", os.getpid(), child.pid)
    time.sleep(600)
"""


@pytest.mark.parametrize("stop_s", [0.2])
def test_nothing_is_left_of_one_that_does_not_want_to_end(tmp_path: Path, stop_s: float) -> None:
    said: list[str] = []

    async def work() -> list[int]:
        running = asyncio.ensure_future(
            AppSupervisor(program(tmp_path, STUBBORN), said.append, restarts=QUICK, stop_s=stop_s).run()
        )
        await until(lambda: bool(said))
        pids = [int(word) for word in said[0].split()[1:]]
        assert all(map(alive, pids))
        running.cancel()
        await asyncio.wait({running}, timeout=PATIENCE_S)
        assert running.cancelled()
        return pids

    pids = asyncio.run(work())
    assert len(pids) == 2
    asyncio.run(until(lambda: not any(map(alive, pids))))


def test_what_it_leaves_behind_in_a_session_of_its_own_does_not_hold_its_end_up(tmp_path: Path) -> None:
    """A daemon of its own making keeps its pipe open: only what it says is waited for, and for a moment only."""
    said: list[str] = []
    text = """
        import subprocess, sys
        command = [sys.executable, "-I", "-S", "-c", "import time; time.sleep(600)"]
        print(subprocess.Popen(command, start_new_session=True).pid)
        sys.stdout.write("last words")
    """
    made = AppSupervisor(program(tmp_path, text), said.append, restarts=QUICK)
    try:
        assert asyncio.run(asyncio.wait_for(made.run(), PATIENCE_S)) == 0
        assert alive(int(said[0]))  # so its end was not what ended the wait
        assert said[1:] == ["last words"]
    finally:
        for line in said[:1]:
            os.kill(int(line), signal.SIGKILL)


def test_one_that_cleans_up_is_given_the_time(tmp_path: Path) -> None:
    said: list[str] = []
    text = """
        import signal, sys, time
        def leave(*_):
            time.sleep(0.1)
            print("disarmed")
            sys.exit(0)
        signal.signal(signal.SIGTERM, leave)
        print("flying")
        time.sleep(600)
    """

    async def work() -> None:
        made = AppSupervisor(program(tmp_path, text), said.append, restarts=QUICK, stop_s=PATIENCE_S)
        running = asyncio.ensure_future(made.run())
        await until(lambda: bool(said))
        running.cancel()
        await asyncio.wait({running}, timeout=PATIENCE_S)

    asyncio.run(work())
    assert said == ["flying", "disarmed"]


def test_it_does_not_outlive_a_supervisor_that_was_killed(tmp_path: Path) -> None:
    command = program(tmp_path, "import os, time; print(os.getpid()); time.sleep(600)")
    above = textwrap.dedent(f"""
        import asyncio
        from twodof.companion.app_supervisor import AppSupervisor
        asyncio.run(AppSupervisor({command!r}, lambda line: print(line, flush=True)).run())
    """)
    with started([sys.executable, "-c", above], stdout=subprocess.PIPE, text=True) as supervisor:
        assert supervisor.stdout is not None
        child = int(supervisor.stdout.readline())
        assert alive(child)
        os.kill(supervisor.pid, signal.SIGKILL)
        supervisor.wait(PATIENCE_S)
        asyncio.run(until(lambda: not alive(child)))


@pytest.mark.parametrize(
    ("text", "limits", "shows"),
    [
        ("bytes(800 << 20)", AppLimits(memory=256 << 20), lambda said: "MemoryError" in said),
        ("open(0 and '' or __file__ + '.big', 'wb').write(bytes(3 << 20))", AppLimits(file=1 << 20), lambda said: True),
        ("files = [open('/dev/null') for _ in range(100)]", AppLimits(files=32), lambda said: "Too many open" in said),
    ],
    ids=["memory", "file", "files"],
)
def test_its_limits_hold(tmp_path: Path, text: str, limits: AppLimits, shows: Callable[[str], bool]) -> None:
    said: list[str] = []
    made = AppSupervisor(program(tmp_path, text), said.append, limits, RestartPolicy(most=0))
    assert asyncio.run(made.run()) != 0
    assert shows("\n".join(said))
    assert all(file.stat().st_size <= limits.file for file in tmp_path.iterdir())


def test_it_stands_back_and_leaves_no_core(tmp_path: Path) -> None:
    said: list[str] = []
    text = "import os, resource; print(os.nice(0), resource.getrlimit(resource.RLIMIT_CORE))"
    made = AppSupervisor(program(tmp_path, text), said.append, AppLimits(niceness=3))
    assert asyncio.run(made.run()) == 0
    assert said == [f"{min(os.nice(0) + 3, 19)} (0, 0)"]
