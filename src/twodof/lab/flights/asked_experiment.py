"""AskedExperiment: an experiment as a client asks for it, ready-made or with an excitation of its own."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Annotated, Any

from pydantic import Field

from twodof.excitation import KINDS, LIMITS
from twodof.experiment.experiments import EXPERIMENTS, UNIT, Experiment, experiment
from twodof.identify.experiments import KINDS as IDENTIFIED
from twodof.identify.from_flight.ready_made import FLOWN_AS
from twodof.lab.request_body import RequestBody
from twodof.lab.routes.commands import excitation_of

Seconds = Annotated[float, Field(ge=0.0, le=600.0, allow_inf_nan=False)]


class AskedExperiment(RequestBody):
    """The ready-made experiment that is flown; what is given beside its name takes the place of its own.

    `excitation` is as the reference describes it, in the unit of the experiment's loop. `thrust` is 0 to 1; times [s].
    """

    name: Annotated[str, Field(max_length=60)]
    excitation: dict[str, Any] | None = None
    thrust: Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)] | None = None
    hold: Seconds | None = None
    rest: Seconds | None = None

    def experiment(self) -> Experiment:
        """The experiment itself. Raises ExperimentError for a name or value that cannot be."""
        given = {key: value for key in ("thrust", "hold", "rest") if (value := getattr(self, key)) is not None}
        made = experiment(self.name)
        if self.excitation is not None:
            given["excitation"] = excitation_of(self.excitation)
        return replace(made, **given) if given else made


def offered() -> dict[str, Any]:
    """What can be asked for: the experiments, the kinds of excitation with their numbers, and what is identified."""
    return {
        "experiments": [_row(one) for one in EXPERIMENTS.values()],
        "excitations": {
            name: [one.name for one in fields(kind) if one.name not in ("unit", "lead", "settle", "pause", "repeat")]
            for name, kind in KINDS.items()
        },
        "limits": dict(LIMITS),
        "kinds": [{"name": one.name, "text": one.text} for one in IDENTIFIED.values()],
    }


def _row(one: Experiment) -> dict[str, Any]:
    return {
        "name": one.name,
        "text": one.text,
        "mode": one.mode,
        "unit": UNIT[one.mode],
        "rings": one.rings,
        "thrust": one.thrust,
        "hold": one.hold,
        "rest": one.rest,
        "duration": one.duration,
        "excitation": one.excitation.to_dict(),
        "kind": FLOWN_AS.get(one.name, one.name if one.name in IDENTIFIED else None),
    }
