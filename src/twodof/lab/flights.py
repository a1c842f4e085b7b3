"""Work on experiments in processes of their own: excitations, flights, identification, design of a controller."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, replace
from datetime import datetime
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from twodof.blocks.declarations import name_of_file
from twodof.design.designed_controller import design_controller
from twodof.design.pitch_family import PitchFamily
from twodof.errors import ExperimentError, IdentificationError, LinkLost, LogError, Rejected, Timeout
from twodof.excitation import KINDS, LIMITS, from_dict
from twodof.experiment.expected_accuracy import expected_accuracy
from twodof.experiment.experiments import EXPERIMENTS, LOOP, UNIT, Experiment, experiment
from twodof.experiment.flight import Flight, Laboratory
from twodof.experiment.fly import fly
from twodof.flight.starters import save_diagram
from twodof.flightlog.atomic import check_free, make_folder, numbered
from twodof.flightlog.files import read_log, write_log
from twodof.gcs.drone import Drone
from twodof.identify.experiments import KINDS as IDENTIFIED
from twodof.identify.identified_flight import identify_flight
from twodof.identify.ready_made import FLOWN_AS
from twodof.lab.answers import RequestBody
from twodof.rig.parameters import NAMES

Seconds = Annotated[float, Field(ge=0.0, le=600.0)]


class ExperimentRequest(RequestBody):
    """Ready-made experiment to fly; the fields beside its name replace those of the experiment.

    `excitation` is a form as in the reference, in the unit of the experiment's loop. `thrust` is 0 to 1; `hold` and
    `rest` are in s.
    """

    name: Annotated[str, Field(max_length=60)]
    excitation: dict[str, Any] | None = None
    thrust: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    hold: Seconds | None = None
    rest: Seconds | None = None

    def experiment(self) -> Experiment:
        """Return the experiment. Raises ExperimentError for an unknown name or a value out of bounds."""
        given = {key: value for key in ("thrust", "hold", "rest") if (value := getattr(self, key)) is not None}
        made = experiment(self.name)
        if self.excitation is not None:
            given["excitation"] = from_dict({"version": 1, **self.excitation})
        return replace(made, **given) if given else made


def check(asked: ExperimentRequest) -> None:
    """Raise ExperimentError for an unknown name or a value out of bounds."""
    asked.experiment()


def offered() -> dict[str, Any]:
    """Return the experiments, the kinds of excitation with their fields, and the kinds of identification."""
    return {
        "experiments": [*experiments()],
        "excitations": {
            name: [one.name for one in fields(kind) if one.name not in ("unit", "lead", "settle", "pause", "repeat")]
            for name, kind in KINDS.items()
        },
        "limits": dict(LIMITS),
        "kinds": [{"name": one.name, "text": one.text} for one in IDENTIFIED.values()],
    }


def drawn(given: dict[str, Any], points: int) -> dict[str, Any]:
    """Return the final form of an excitation, and its values at `points` times. Raises ExperimentError."""
    played = from_dict({"version": 1, **given})
    times = [played.duration * k / (points - 1) for k in range(points)]
    return {
        "excitation": played.to_dict(),
        "unit": played.unit,
        "duration": played.duration,
        "peak": played.peak,
        "time": times,
        "value": played.at(times).tolist(),
    }


def experiments() -> Iterator[dict[str, Any]]:
    """Return the ready-made experiments as plain data, the paper's first; `kind` is that of their identification."""
    shown = ("name", "text", "mode", "rings", "thrust", "hold", "rest", "duration")
    for one in EXPERIMENTS.values():
        yield {
            **{key: getattr(one, key) for key in shown},
            "loop": LOOP[one.mode],
            "unit": UNIT[one.mode],
            "excitation": one.excitation.to_dict(),
            "kind": FLOWN_AS.get(one.name, one.name if one.name in IDENTIFIED else None),
        }


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
    """Fly an experiment, write the log into `folder`, and judge the data; setting `stop` disarms the drone at once.

    The log of a stopped flight is kept. A virtual drone is reset afterwards with its rings as before, unless it was
    killed: a person must release it.
    """
    doing = "connect"
    stopped: list[Flight] = []

    def say(text: str, share: float) -> None:
        nonlocal doing
        doing = text or doing
        progress(share, doing)
        if stop.is_set():
            raise KeyboardInterrupt  # ends a flight as Ctrl-C does: it disarms and keeps the log

    progress(0.0, doing)
    with Drone.connect(url, key=key, drone=system) as drone:
        before = drone.state.rig
        try:
            flight = fly(experiment, drone, seed=seed, progress=say, interrupted=stopped.append)
        except KeyboardInterrupt:
            if not stopped:
                what = "the flight was stopped before it began"
                raise ExperimentError(what, experiment.name, "start it again") from None
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


def plan(
    progress: Callable[[float, str], None],
    wanted: ExperimentRequest,
    rig: str,
    values: Mapping[str, float],
    rehearse: bool,
) -> dict[str, Any]:
    """Predict accuracy and motion of an experiment on the drone's virtual rig, or on `lab` for another rig.

    With `rehearse` the experiment is also flown there with noise and gusts, and identified.
    """
    asked = wanted.experiment()
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
    prior: dict[str, tuple[float, float]],
) -> dict[str, Any]:
    """Identify a model from a log; return the `view` of the fit for the page, and the `model` as it is kept."""
    progress(0.05, "reading the log")
    log = read_log(path)
    free = None if impulse is None else read_log(impulse)
    checks = [read_log(other) for other in others]
    progress(0.2, "searching the model")
    found = identify_flight(
        log, kind, structure=structure, impulse=free, others=checks, window=window, disturbance=disturbance, prior=prior
    )
    progress(0.9, "testing the residuals")
    view = found.view()
    return {"view": view, "model": {**found.model(), "informative": view["informative"]}}


def design(
    progress: Callable[[float, str], None],
    model: dict[str, Any],
    place: str,
    crossover: float,
    phase_margin: float | None,
    method: str,
    overwrite: bool,
) -> dict[str, Any]:
    """Design a controller for the family of `model`, promise its step, and write its diagram to the file `place`.

    A controller that does not keep the family stable is not written: `file` is None.
    """
    path = Path(place)
    make_folder(path.parent)
    check_free(path, overwrite)
    progress(0.02, "the gains")
    family = PitchFamily.from_identified(model)
    made = design_controller(
        family, crossover, phase_margin, method=method, progress=lambda text, share: progress(share, text)
    )
    made.diagram.name = name_of_file(path.stem)  # as where it is saved by hand: one name on the page and on board
    if made.robustness.robust:
        save_diagram(made.diagram, path, overwrite=overwrite)
    told = made.to_json()
    promised = told["promise"]
    return {
        "file": path.name if made.robustness.robust else None,
        "name": made.diagram.name,
        "method": made.method,
        "design": told["design"],
        "robustness": {**told["robustness"], "text": made.robustness.text},
        **{key: promised[key] for key in ("figures", "goal", "level", "period")},
        "bands": {key: promised["bands"][key] for key in ("theta", "M")},
    }
