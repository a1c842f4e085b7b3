"""The job that flies an experiment over MAVLink, as `twodof fly --url` does, and keeps its log."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

from twodof.errors import ExperimentError, LinkLost, Rejected, Timeout
from twodof.experiment.experiments import Experiment
from twodof.experiment.flight import Flight
from twodof.experiment.fly import fly
from twodof.flightlog.atomic import numbered
from twodof.flightlog.files import write_log
from twodof.gcs.drone import Drone
from twodof.lab.jobs.worker import in_real_time


@in_real_time
def fly_experiment(
    progress: Callable[[float, str], None],
    stop: Event,
    url: str,
    system: int,
    key: str | None,
    experiment: Experiment,
    seed: int,
    folder: str,
) -> dict[str, Any]:
    """Fly, write the log into `folder`, tell how good the data are. When `stop` is set the drone is disarmed at once.

    What was flown until then is kept as well. A virtual drone is put to its start again with its rings as they were,
    but for one that was stopped: that is for a person to release.
    """
    doing = "connect"
    stopped: list[Flight] = []

    def say(text: str, share: float) -> None:
        nonlocal doing
        doing = text or doing
        progress(share, doing)
        if stop.is_set():
            raise KeyboardInterrupt  # the way in which a flight is ended by hand: it disarms and keeps what there is

    progress(0.0, doing)
    with Drone.connect(url, key=key, drone=system) as drone:
        before = drone.state.rig
        try:
            flight = fly(experiment, drone, seed=seed, progress=say, interrupted=stopped.append)
        except KeyboardInterrupt:
            if not stopped:
                raise ExperimentError("it was stopped before it had begun", experiment.name) from None
            flight = stopped[0]
        put_back = False
        if before.virtual and not drone.state.killed:
            with suppress(Rejected, Timeout, LinkLost):  # the log is kept all the same
                drone.reset(seed=before.seed, rings=before.rings_locked)
                put_back = True
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    path = numbered(place / f"{datetime.now():%Y-%m-%d-%H-%M-%S}-{experiment.name}.mcap")
    write_log(flight.log, path)
    return {
        "log": path.name,
        "experiment": experiment.name,
        "rig": before.name,
        "rings_locked": before.rings_locked if put_back else experiment.rings,
        "put_back": put_back,
        "seed": flight.seed,
        "x_start": flight.x_start,
        "good": flight.good,
        "reason": flight.reason,
        "checks": [{"name": one.name, "passed": one.passed, "seen": one.seen} for one in flight.checks],
    }
