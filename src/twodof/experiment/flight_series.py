"""Series of flights over MAVLink, with one thread and one virtual drone for each rig."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from queue import SimpleQueue
from threading import Event, Thread

from twodof.errors import ExperimentError, TwodofError
from twodof.experiment.flight import Flight, Laboratory
from twodof.experiment.fly import fly
from twodof.fleet.virtual_drone import virtual_drone
from twodof.gcs.drone import Drone

SeriesFlight = tuple[str, str, int, Flight]
"""Rig, experiment, seed and the flight."""


def fly_series(rigs: Iterable[str], names: Sequence[str], seeds: Iterable[int]) -> Iterator[SeriesFlight]:
    """Fly the experiments `names` with each of the `seeds` on a virtual drone of each rig, in lockstep, side by side.

    Yields each flight when it ends. Raises what `fly` raises. All drones end with the iterator.
    """
    plan = list(product(names, seeds))
    events: SimpleQueue[SeriesFlight | TwodofError | None] = SimpleQueue()
    ended = Event()

    def go_on(phase: str, share: float) -> None:
        if ended.is_set():
            raise ExperimentError("the series has ended", "fly_series")

    def fly_all(rig: str) -> None:
        last: TwodofError | None = ExperimentError("its flights ended by a fault", f"rig {rig}", "read the output")
        try:
            laboratory = Laboratory(rig)
            with virtual_drone(rig) as url, Drone.connect(url) as drone:
                drone.parameters["SDLOG_MODE"] = -1  # no log on board
                for name, seed in plan:
                    events.put((rig, name, seed, fly(name, drone, seed, laboratory=laboratory, progress=go_on)))
            last = None
        except TwodofError as error:
            last = error
        finally:
            events.put(last)

    threads = [Thread(target=fly_all, args=(rig,), daemon=True) for rig in rigs]
    for thread in threads:
        thread.start()
    left = len(threads)
    try:
        while left:
            event = events.get()
            if isinstance(event, TwodofError):
                raise event
            if event is None:
                left -= 1
            else:
                yield event
    finally:
        ended.set()
        for thread in threads:
            thread.join()
