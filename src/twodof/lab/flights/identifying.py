"""The jobs that plan an experiment's accuracy and that identify a model from flights' logs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from twodof.errors import IdentificationError, LogError
from twodof.experiment.expected_accuracy import expected_accuracy
from twodof.experiment.experiments import Experiment, experiment
from twodof.experiment.flight import Laboratory
from twodof.identify.from_flight.identified_flight import identify_flight
from twodof.lab.logbook.read_logs import named_log
from twodof.rig.parameters import NAMES


def plan(
    progress: Callable[[float, str], None],
    asked: Experiment,
    rig: str,
    values: Mapping[str, float],
    rehearse: bool,
) -> dict[str, Any]:
    """What the experiment will tell on the virtual rig that is most like the drone's; the motion it will make.

    With `rehearse` it is flown there with all its noise and gusts too, and identified: what a real flight may give.
    """
    name = rig if rig in NAMES else "lab"
    progress(0.05, "flying it without noise")
    told = expected_accuracy(asked, Laboratory(name, noise=0.0), values).to_json()
    told["rig"] = name
    told["rehearsed"] = None
    if rehearse and told["unknowns"]:
        progress(0.2, "rehearsing it with noise and gusts")
        laboratory = Laboratory(name)
        impulse = laboratory.fly(experiment("impulse")).log if told["kind"] == "doublet" else None
        flown = laboratory.fly(asked)
        progress(0.4, "identifying the rehearsal")
        try:
            found = identify_flight(flown.log, told["kind"], impulse=impulse)
        except (IdentificationError, LogError) as reason:
            told["rehearsed"] = {"estimates": [], "informative": {"enough": False, "text": str(reason)}}
        else:
            view = found.view()
            told["rehearsed"] = {key: view[key] for key in ("estimates", "informative", "remarks")}
    return told


def identify(
    progress: Callable[[float, str], None],
    path: str,
    kind: str | None,
    structure: str,
    impulse: str | None,
    others: list[str],
    window: tuple[float, float] | None,
    disturbance: Any,
) -> dict[str, Any]:
    """The `view` of a log's fit, and the `model` that can be kept."""
    progress(0.05, "reading the log")
    log = named_log(path)
    free = None if impulse is None else named_log(impulse)
    checks = [named_log(other) for other in others]
    progress(0.2, "searching the model")
    found = identify_flight(
        log, kind, structure=structure, impulse=free, others=checks, window=window, disturbance=disturbance
    )
    progress(0.9, "testing the residuals")
    view = found.view()
    return {"view": view, "model": {**found.model(), "informative": view["informative"]}}
