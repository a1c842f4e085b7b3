"""Ctrl-C at any moment ends a command with one line and status 130: no traceback, no file, no process left."""

import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S, patiently
from twodof.cli.interrupts import INTERRUPTED, LINE

pytestmark = pytest.mark.slow

DEMO_TAKES = "The demo flies, identifies and writes the report in 1 to 5 minutes on two idle cores.\n"


def processes(group: int) -> int:
    """How many of a process group run."""
    found = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        found += fields[2] == str(group) and fields[0] != "Z"
    return found


def interrupted(after_s: float, folder: Path, *arguments: str) -> str:
    """Send Ctrl-C to a command and its children, and return what is wrong with its end ("" if nothing).

    The time is counted from the beginning of its `main`.
    """
    began = folder / "began"
    code = (
        "from twodof.cli import interrupts, main; from pathlib import Path\n"
        f"interrupts.begin(); Path({str(began)!r}).touch(); main()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        for _ in patiently():
            if began.exists():
                break
        time.sleep(after_s)
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    for _ in patiently():
        if not processes(process.pid):
            break
    began.unlink()
    files = [str(one) for one in folder.rglob("*") if one.is_file()]
    right = process.returncode == INTERRUPTED and said.decode().removeprefix(DEMO_TAKES) == LINE and not files
    return "" if right else f"after {after_s:.3f} s: status {process.returncode}, left {files}, said {said.decode()}"


@pytest.mark.long
@pytest.mark.parametrize("after_s", [0.0, 0.3, 1.5])
def test_the_demo_ends_in_a_line(tmp_path: Path, after_s: float) -> None:
    assert interrupted(after_s, tmp_path, "demo", "--repetitions", "3") == ""


@pytest.mark.soak
def test_commands_end_in_a_line_at_any_moment(tmp_path: Path) -> None:
    chance = random.Random(9)
    flown = ("fly", "attitude-steps")
    commands = [("demo", "--repetitions", "3"), flown, ("simulate", "attitude-steps"), ("drones",)]
    wrong = [interrupted(6.0 * chance.random() ** 3, tmp_path, *commands[k % 4]) for k in range(200)]
    assert [one for one in wrong if one] == []


def test_an_interrupt_in_a_destructor_is_repeated() -> None:
    """In a destructor it was printed, and the command went on."""
    code = """
        import signal, sys, time, types
        import typer
        from twodof.cli import main
        slow = types.ModuleType("twodof.cli.log")
        class Closing:
            def __del__(self) -> None:
                signal.raise_signal(signal.SIGINT)
        def log() -> None:
            closing = Closing()
            del closing
            for _ in range(10_000):
                time.sleep(0.001)
            print("it goes on")
        slow.log = log
        sys.modules["twodof.cli.log"] = slow
        sys.argv[1:] = ["log"]
        main()
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (INTERRUPTED, "", LINE)


def test_an_interrupt_at_exit_changes_nothing() -> None:
    code = """
        import atexit, signal
        from twodof.cli import main
        atexit.register(signal.raise_signal, signal.SIGINT)
        main()
    """
    command = [sys.executable, "-c", textwrap.dedent(code), "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_who_wants_it_ignored_is_heard() -> None:
    """As a shell starts what is to run in the background."""
    code = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); from twodof.cli import main; main()"
    raising = code.replace("main()", "signal.raise_signal(signal.SIGINT); main()")
    done = subprocess.run([sys.executable, "-c", raising, "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(("cause", "status"), [("KeyboardInterrupt()", INTERRUPTED), ("None", 1)])
def test_ctrl_c_while_an_extension_module_loads(cause: str, status: int) -> None:
    """The import then fails, because of it; an import that fails by itself is no Ctrl-C."""
    code = f"""
        import twodof.cli
        from twodof.cli import app
        def run(arguments):
            raise ImportError("initialization failed") from {cause}
        app.run = run
        twodof.cli.main()
    """
    ended = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True)
    assert ended.returncode == status
    assert (ended.stderr == LINE) == (status == INTERRUPTED), ended.stderr
