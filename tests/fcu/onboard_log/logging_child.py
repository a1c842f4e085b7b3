"""Logs steps until it is killed, or until the disk is full; says on stdout what became of it."""

import resource
import signal
import sys
from contextlib import suppress
from pathlib import Path

from tests.fcu.steps import plain_step
from twodof.errors import LogError
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.fcu.parameters.parameter_store import ParameterStore

FLUSHED_EACH = 100


def until_killed(folder: Path) -> None:
    """Prints after each flush how many steps are on the disk."""
    with OnboardLogger(folder, ParameterStore(values={"SDLOG_MODE": 2}), lockstep=True) as log:
        tick = 0
        while True:
            for _ in range(FLUSHED_EACH):
                log.step(plain_step(tick))
                tick += 1
            log.flush()
            sys.stdout.write(f"{tick}\n")
            sys.stdout.flush()


def disk_full(folder: Path, most: int) -> None:
    """No file may grow beyond `most` bytes; flies 3000 steps, armed in the middle, then again once there is room."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
    log = OnboardLogger(folder, ParameterStore(), lockstep=True)
    for tick in range(3000):
        log.step(plain_step(tick, armed=400 <= tick < 2600))
        if tick % 100 == 0:
            with suppress(LogError):
                log.flush()
    log.end()
    sys.stdout.write(f"{log.failure}\n")
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    for tick in range(3000, 4000):
        log.step(plain_step(tick, armed=3300 <= tick < 3600))
    log.close()
    sys.stdout.write(f"{log.failure}\n")


if __name__ == "__main__":
    if sys.argv[1] == "full":
        disk_full(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        until_killed(Path(sys.argv[2]))
