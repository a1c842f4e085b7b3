"""`twodof watch`: what a drone tells is what is shown, nobody is disturbed, and it ends well."""

import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest

from tests.cli.program import Shell
from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer, speaking
from tests.gcs.virtual import on_board
from tests.patience import PATIENCE_S, patiently
from tests.processes import started
from twodof.cli import watch
from twodof.gcs.drone import Drone

pytestmark = pytest.mark.slow

COMMAND = [sys.executable, "-m", "twodof.cli", "watch"]


@contextmanager
def watching(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], list[dict[str, Any]]]]:
    """`twodof watch --json` and the documents that it has written so far."""
    lines: list[dict[str, Any]] = []
    command = [*COMMAND, "--json", "--every", "0.05", *arguments]
    with started(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        reader = threading.Thread(target=lambda: lines.extend(map(json.loads, process.stdout)))
        reader.start()
        yield process, lines
        process.send_signal(signal.SIGINT)
        reader.join(PATIENCE_S)


def come(lines: list[dict[str, Any]], key: str, value: object) -> dict[str, Any]:
    """The first drone as it is said once `key` is `value`."""
    for _ in patiently():
        if lines and lines[-1]["drones"][0].get(key) == value:
            return lines[-1]["drones"][0]
    raise AssertionError(lines[-1:])


@pytest.mark.long
def test_a_flight_is_followed_to_its_end() -> None:
    """In lockstep, so that what is seen is what was granted; then the drone ends, and later the watcher."""
    with ExitStack() as stack:
        there = stack.enter_context(on_board(lockstep=True, conditions={"rings": True}, index=6))
        process, lines = stack.enter_context(watching(there.url))
        with Drone.connect(there.url) as drone:
            assert come(lines, "link", "heard")["armed"] is False
            holder = list(drone.there.lease.holder or ())
            drone.run(0.5)
            drone.arm()
            drone.set_pitch(0.1)
            drone.run(1.5)
            seen = come(lines, "time", pytest.approx((drone.tick - 1) * 0.004, abs=0.1))
            assert (seen["armed"], seen["mode"], seen["lease_holder"]) == (True, "offboard", holder)
            assert seen["theta"] == pytest.approx(drone.theta, abs=0.02)
            assert seen["setpoint"] == {
                "theta": pytest.approx(0.1, abs=1e-6),
                "q": pytest.approx(0.0, abs=9),
                "x": None,
            }
            drone.stop_setpoints()
            drone.run(0.7)
            seen = come(lines, "failsafe_reason", "setpoint_lost")
            assert seen["failsafe_in_words"].endswith("no set-point came for a while, in a mode that flies one")
            drone.kill()
            assert come(lines, "armed", False)["killed"] is True
            drone.close()
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE_S) == 0
            assert process.stderr is not None
            assert process.stderr.read() == ""


@pytest.mark.long
def test_a_lost_link_is_shown_and_restored() -> None:
    with ExitStack() as first:
        url = first.enter_context(on_board(index=6)).url
        with watching(url) as (process, lines):
            come(lines, "link", "heard")
            first.close()
            assert come(lines, "link", "lost")["lost_because"]
            with on_board(url.replace("tcp://", "tcpin://"), index=6):
                come(lines, "link", "heard")
            assert process.poll() is None


def test_once_prints_the_state_without_a_lease(shell: Shell) -> None:
    with on_board(lockstep=True, index=6) as there, Drone.connect(there.url) as pilot:
        pilot.run(0.2)
        (seen,) = shell(["watch", "--once", "--json", there.url]).json["drones"]
        assert (seen["system"], seen["link"], seen["ours"], seen["virtual"]) == (7, "heard", True, True)
        assert seen["lease_holder"] == list(pilot.there.lease.holder or ())
        assert shell(["watch", "--once", there.url]).out.startswith("drone 7  ")
        pilot.arm()  # it still commands


@pytest.mark.long
@pytest.mark.parametrize("form", [["--json"], []])
def test_it_ends_when_its_reader_leaves(form: list[str]) -> None:
    with ExitStack() as stack:
        there = stack.enter_context(on_board(lockstep=True, index=6))
        command = [*COMMAND, "--every", "0.05", *form, there.url]
        process = stack.enter_context(started(command, stdout=subprocess.PIPE))
        assert process.stdout is not None
        assert process.stdout.readline()
        process.stdout.close()
        assert process.wait(PATIENCE_S) in (0, 1)


def test_no_drone_is_an_error_with_its_remedy(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watch, "urls", lambda _: [])
    monkeypatch.setattr(watch, "_LISTEN_S", 0.05)
    said = shell(["watch", "--once", "--json"], 2).json["error"]
    assert (said["kind"], "twodof up" in said["remedy"]) == ("LinkLost", True)


def test_texts_during_connecting_are_shown() -> None:
    async def work() -> list[str]:
        async with Peer(spoil=speaking(b"battery low")) as peer:
            watched = watch.WatchedDrone(peer.url, None, None)
            await watched.connect()
            await watched.leave()
            return [line["text"] for line in watched.texts]

    assert run_virtual(work()) == ["battery low"]


def plain(raw: str) -> str:
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", raw).replace("\r", "")


def read(terminal: int) -> str:
    """Return what the terminal has written, "" after a moment without."""
    try:
        return os.read(terminal, 65536).decode(errors="replace") if select.select([terminal], [], [], 0.05)[0] else ""
    except OSError:  # its other end is closed
        return ""


@pytest.mark.long
@pytest.mark.parametrize("columns", [80, 140])
def test_the_table_follows_a_drone(columns: int) -> None:
    """Without colour; Ctrl-C gives the screen back and ends with 0."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 12, columns, 0, 0))
    from_outside = ("FORCE_COLOR", "COLUMNS", "LINES", "TTY_COMPATIBLE")  # would stand above what the terminal says
    environment = {k: v for k, v in os.environ.items() if k not in from_outside}
    environment |= {"TERM": "xterm-256color", "NO_COLOR": "1"}
    with on_board(lockstep=True, index=6) as there, Drone.connect(there.url) as pilot:
        pilot.run(0.2)
        with started([*COMMAND, there.url], stdin=theirs, stdout=theirs, stderr=theirs, env=environment) as process:
            os.close(theirs)
            raw = ""
            for _ in patiently():
                raw += read(ours)
                pilot.run(0.1)
                assert process.poll() is None, plain(raw)
                if any(re.search(r"disarmed +manual +[+-]\d", frame) for frame in plain(raw).split("drone")):
                    break
            process.send_signal(signal.SIGINT)
            for _ in patiently():
                raw += read(ours)
                if process.poll() is not None and "\x1b[?1049l" in raw:  # the screen of before
                    break
            assert process.returncode == 0
    os.close(ours)
    for word in ("theta, deg", "battery", "Ctrl-C ends", f"7 {there.url}" if columns > 80 else "7"):
        assert word in plain(raw)
    assert not re.search(r"\x1b\[[0-9;]*[34][0-9]", raw)
