"""Series of flights over MAVLink, with one process and one virtual drone for each rig."""

import multiprocessing
import signal
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from multiprocessing.resource_tracker import ensure_running

from twodof.errors import ExperimentError, TwodofError
from twodof.experiment.flight import Flight, Laboratory
from twodof.experiment.fly import fly
from twodof.fleet.virtual_drone import virtual_drone
from twodof.gcs.drone import Drone

FLIGHT_S = 300.0
"""Longest wait for the next flight [s]; the first one includes compilation."""

_END_S = 10.0


SeriesFlight = tuple[str, str, int, Flight]
"""Rig, experiment, seed and the flight."""


def fly_series(rigs: Iterable[str], names: Sequence[str], seeds: Iterable[int]) -> Iterator[SeriesFlight]:
    """Fly the experiments `names` with each of the `seeds` on a virtual drone of each rig, in lockstep, in parallel.

    Yields each flight when it ends. Raises what `fly` raises, and ExperimentError if a process dies or hangs. All
    processes end with the iterator.
    """
    spawning = multiprocessing.get_context("spawn")
    seeds = list(seeds)
    left: dict[Connection, str] = {}
    processes = []
    try:
        for rig in rigs:
            ours, theirs = spawning.Pipe(duplex=False)
            process = spawning.Process(target=_fly_all, args=(theirs, rig, list(names), seeds), name=f"rig {rig}")
            with _no_interrupt_for_children():
                process.start()
                processes.append(process)
            theirs.close()
            left[ours] = rig
        while left:
            ready = wait(list(left), FLIGHT_S)
            if not ready:
                raise ExperimentError(f"no flight ended within {FLIGHT_S:g} s", ", ".join(left.values()), "try again")
            for connection in ready:
                if isinstance(connection, Connection):
                    yield from _taken(connection, left)
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.join(_END_S)
            process.kill()
            process.join()
        for connection in left:
            connection.close()


@contextmanager
def _no_interrupt_for_children() -> Iterator[None]:
    """Block SIGINT in processes started within the block; Ctrl-C then reaches the parent, which ends them.

    A Ctrl-C during the block is delivered at its end.
    """
    ensure_running()  # starting the resource tracker unblocks the signal: start it before the block
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _taken(connection: Connection, left: dict[Connection, str]) -> Iterator[SeriesFlight]:
    """Yield the flight received from a rig; forget the connection after the last one."""
    rig = left[connection]
    try:
        got = connection.recv()
    except EOFError:
        raise ExperimentError("the process of this rig died", f"rig {rig}", "read its output, then fly again") from None
    if got is None:
        del left[connection]
        connection.close()
    elif isinstance(got, TwodofError):
        raise got
    else:
        name, seed, flight = got
        yield rig, name, seed, flight


def _fly_all(connection: Connection, rig: str, names: list[str], seeds: list[int]) -> None:
    """Run the process of a rig: fly every experiment and send the flights."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    sys.unraisablehook = lambda _: None  # SystemExit in a destructor is not an error to print
    try:
        laboratory = Laboratory(rig)
        with virtual_drone(rig) as url, Drone.connect(url) as drone:
            drone.parameters["SDLOG_MODE"] = -1  # no log on board
            for name in names:
                for seed in seeds:
                    connection.send((name, seed, fly(name, drone, seed, laboratory=laboratory)))
    except TwodofError as error:
        connection.send(error)
    connection.send(None)
