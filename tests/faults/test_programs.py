"""The programs as they run: a cable that is pulled, a companion and a user's program that are killed with -9.

What is stated is measured on board, in control periods.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.stack.programs import Running, running
from tests.faults.cable import Cable
from tests.faults.whole import DESCEND, LEVEL, OFF, tell
from tests.patience import PATIENCE_S, patiently
from twodof.errors import LinkLost, Rejected, Timeout
from twodof.flightlog.mcap_file import recover
from twodof.flightlog.ulog_file import scan_ulog
from twodof.gcs.drone import Drone

PROJECT = Path(__file__).resolve().parents[2]
BAUD = 921_600
PERIOD_MS = 4.0
LEVEL_RAD = 0.06
# Of some twenty topics; of each that comes at the full rate a second and more is on the disk then.
ENOUGH_SAMPLES = 10_000
pytestmark = [pytest.mark.slow, pytest.mark.waits]


@dataclass
class Stack:
    """A flight controller that the companion reaches by a serial cable."""

    folder: Path
    cable: Cable
    fcu: Running
    direct: str

    def companion(self) -> Any:
        """One more companion, for `with`."""
        line = f"serial://{self.cable.other}?baud={BAUD}"
        return running(*("companion", "--fcu", line, "--onboard", "tcpin://127.0.0.1:0"), urls=1, folder=self.folder)

    def logs(self) -> list[Path]:
        """On board, the newest last."""
        return sorted((self.folder / "state" / "logs").glob("*.ulg"))


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    folder = tmp_path_factory.mktemp("stack")
    cable = Cable(folder)
    options = ("--listen", f"serial://{cable.one}?baud={BAUD}", "--listen", "tcpin://127.0.0.1:0")
    try:
        with running("fcu", "--rings", "--state", "state", *options, urls=2, folder=folder) as fcu:
            yield Stack(folder, cable, fcu, tcp(fcu.urls[1]))
    finally:
        cable.pull()


def tcp(url: str) -> str:
    return url.replace("tcpin", "tcp")


@contextmanager
def airborne(url: str) -> Iterator[Drone]:
    """A client whose drone flies at a pitch of .1 rad; leaving it works with a broken link too.

    Where a program stood still on the way there, so that the failsafe acted, it starts anew.
    """
    drone = Drone.connect(url, timeout=PATIENCE_S, system=250)
    try:
        for _ in patiently():
            with suppress(Rejected, Timeout):
                drone.disarm()  # whatever stopped it before is over; for half a second after that it does not arm
                drone.arm()
                drone.set_pitch(0.1, thrust=0.4)
                drone.run(1.0)
                if drone.state.armed and drone.state.safety.action == "none":
                    break
        yield drone
    finally:
        with suppress(LinkLost, Timeout):
            drone.close()


def until(true: Callable[[], bool]) -> None:
    for _ in patiently():
        if true():
            break


def made_safe(url: str, folder: Path) -> tuple[Mapping[str, np.ndarray], bytes]:
    """By another client, who reads the state, waits for the motors to be off, and fetches the log: its steps."""
    with Drone.connect(url, timeout=PATIENCE_S, system=251, take_lease=False) as other:
        # Two messages say it, at their own times.
        until(lambda: other.state.rig.virtual and other.state.safety.action == "off" and not other.state.armed)
        other.disarm()
        other.run(1.5)  # the log ends a second after the motors were stopped for good
        entry = other.logs.list(PATIENCE_S)[-1]
        raw = other.logs.download(entry, folder / f"fetched-{entry.number}.ulg", PATIENCE_S).read_bytes()
    rows = scan_ulog(raw, "log").topic("twodof_step")
    ticks = rows["tick"].tolist()
    assert ticks == [*range(ticks[0], ticks[-1] + 1)]  # whole
    return rows, raw


def first(rows: Mapping[str, np.ndarray], true: np.ndarray, after: int) -> float:
    """How long after row `after` something is true first, that period included [ms]."""
    later = np.flatnonzero(true[after + 1 :])
    assert len(later), f"never; the failsafe's actions: {set(rows['action'])}, reasons: {set(rows['reason'])}"
    return PERIOD_MS * (later[0] + 1)


def last(values: np.ndarray) -> int:
    return int(np.flatnonzero(values)[-1])


def check_silence(name: str, rows: Mapping[str, np.ndarray]) -> None:
    """Level within a second of the last set-point, down 3 s after the last word, the motors off a second later."""
    flown = {name: column[: last(rows["armed"] != 0) + 1] for name, column in rows.items()}
    down = last(flown["action"] != DESCEND) + 1
    silent = last(flown["asked_setpoint_new"][:down] != 0)
    word = last(flown["asked_link_new"][:down] != 0)
    stands = (rows["fore"] == 0.0) & (rows["aft"] == 0.0)
    tell(name, "level after the last set-point", first(rows, rows["action"] == LEVEL, silent), 1000)
    tell(name, "down after the last word", first(rows, rows["action"] == DESCEND, word), 3004)
    tell(name, "motors off after the last word", first(rows, stands, word), 4008)
    level = rows["theta"][silent + 250 : down]
    assert np.abs(level).max() < LEVEL_RAD
    assert rows["action"][rows["armed"] == 0][-1] == OFF


@pytest.mark.long
def test_a_serial_cable_that_is_pulled_and_a_companion_that_is_killed_in_flight(stack: Stack) -> None:
    # RuntimeError: it did not end by itself.
    with suppress(RuntimeError), stack.companion() as companion:
        url = tcp(companion.urls[0])
        with airborne(url) as drone, stack.cable.pulled():
            with pytest.raises(LinkLost):
                drone.run(PATIENCE_S)
            rows, _ = made_safe(stack.direct, stack.folder)
            check_silence("cable pulled", rows)
        with airborne(url) as again:  # both have opened it again, and everything works
            assert again.state.armed
            companion.process.kill()
            with pytest.raises(LinkLost):
                again.run(PATIENCE_S)
    assert companion.process.returncode == -9
    rows, _ = made_safe(stack.direct, stack.folder)
    check_silence("companion killed", rows)
    with stack.companion() as companion, airborne(tcp(companion.urls[0])) as again:
        assert again.state.armed
    assert stack.fcu.process.poll() is None


@pytest.mark.soak
def test_a_users_program_that_is_killed_in_mid_experiment(stack: Stack) -> None:
    """The excitation goes on without a link; 3 s after the last frame the drone descends. Both logs are whole."""
    recorded = stack.folder / "killed.mcap"
    with stack.companion() as companion:
        url = tcp(companion.urls[0])
        with subprocess.Popen(
            [sys.executable, "-m", "tests.faults.pilot_child", url, str(recorded)],
            stdout=subprocess.PIPE,
            text=True,
            cwd=PROJECT,
            env=os.environ | {"PYTHONPATH": str(PROJECT)},
        ) as child:
            try:
                assert child.stdout is not None
                lines = iter(child.stdout.readline, "")
                said = [*_until_excited(lines)]
            finally:
                child.kill()
                child.wait(PATIENCE_S)
            said += [*lines]
        acknowledged = max(int(line.split()[-1]) for line in said if line.split()[-1].isdecimal())
        rows, raw = made_safe(url, stack.folder)
        flown = {name: column[: last(rows["armed"] != 0) + 1] for name, column in rows.items()}
        word = last(flown["asked_link_new"][: last(flown["action"] != DESCEND) + 1] != 0)
        stands = (rows["fore"] == 0.0) & (rows["aft"] == 0.0)
        tell("user's program killed", "down after the last word", first(rows, rows["action"] == DESCEND, word), 3004)
        tell("user's program killed", "motors off after the last word", first(rows, stands, word), 4008)
        assert raw == stack.logs()[-1].read_bytes()
        rescued = recover(recorded)
        kept = sum(len(rescued.log[name]) for name in rescued.log)
        assert kept >= acknowledged >= ENOUGH_SAMPLES
        assert len(rescued.log["theta"]) > 250


def _until_excited(lines: Iterable[str]) -> Iterator[str]:
    """Yield its lines until a second after the excitation was sent and enough samples are on the disk."""
    looks = 0
    for line in lines:
        yield line
        doing, _, samples = line.strip().partition(" ")
        looks = looks + 1 if doing == "excite" else 0  # a flight that was broken off does not count
        if looks > 15 and int(samples) >= ENOUGH_SAMPLES:
            return
    raise AssertionError("it ended before it was excited")
