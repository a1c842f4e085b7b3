"""Folder of identified models, and the guard that first tries a change of gains on a model."""

import hashlib
import hmac
import json
import secrets
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError

from twodof.design.pitch_family import PitchFamily, family_in
from twodof.design.tuning_preview import GAINS, PitchLaw
from twodof.errors import DiagramError, LogError, ParameterError, Rejected, TwodofError
from twodof.flight.templates import ATTITUDE
from twodof.flightlog.atomic import make_folder, write_text
from twodof.flightlog.provenance import read_bytes
from twodof.gcs.active_controller import ActiveController
from twodof.gcs.parameters import BY_NAME
from twodof.lab.answers import mistakes_in_words
from twodof.lab.drones.lab_drone import LabDrone
from twodof.lab.folders import NamedFiles
from twodof.lab.log_work import kept_log
from twodof.lab.processes import Workbench
from twodof.report.step_responses import step_responses

MAX_BYTES = 1 << 20
_CHOICES = ".chosen"
"""File of the chosen models beside the models; no model can have this name."""


class _Estimated(BaseModel):
    """Estimate of one unknown in a model's document."""

    value: float | None = None
    sigma: float | None = None
    sigma_quoted: float | None = None
    unit: str | None = None

    @property
    def quoted(self) -> float | None:
        """Return the standard deviation of the fit's table, perhaps null; sums and old files have `sigma` alone."""
        return self.sigma_quoted if "sigma_quoted" in self.model_fields_set else self.sigma


class _Identified(BaseModel):
    """Part of a model's document that lists show."""

    experiment: str | None = None
    structure: str | None = None
    method: str | None = None
    informative: Any = None
    estimates: dict[str, _Estimated] = {}
    sums: dict[str, _Estimated] | None = None
    fixed: dict[str, float | None] = {}


Parsed = TypeVar("Parsed")
_DOCUMENT, _IDENTIFIED = TypeAdapter(dict[str, Any]), TypeAdapter(_Identified)
_CHOSEN = TypeAdapter(dict[str, str])


class ModelFolder(NamedFiles):
    """Folder of models, each read when it is needed, and the choice of the models that guard tuning."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, ".json", "model", 500, MAX_BYTES)

    def read(self, name: str) -> dict[str, Any]:
        """Read a model's document. Raises NotThere, ParameterError for a damaged file."""
        return self._parsed(name, _DOCUMENT)

    def family(self, name: str) -> PitchFamily:
        """Return a pitch model's family, without its noise. Raises NotThere, ParameterError for another kind."""
        return PitchFamily.from_identified(self.read(name), f"model {name}", noise=False)

    def digest(self, name: str) -> str:
        """Return the digest of a model's bytes. Raises NotThere."""
        return hashlib.sha256(self.content(name)).hexdigest()

    def keep(self, name: str, document: Mapping[str, Any], overwrite: bool = False) -> dict[str, Any]:
        """Save a model and return its row. Raises as `save`, and ParameterError for what JSON cannot hold."""
        try:
            text = json.dumps(document, indent=1, allow_nan=False)
            _DOCUMENT.validate_json(text)
        except (ValueError, RecursionError) as reason:
            what = "it holds NaN, infinity, half a character, or nests too deep"
            raise ParameterError(what, f"model {name}", "give null for such a number, and nest it less") from reason
        self.save(name, text, overwrite)
        return self.row(name)

    def values(self, name: str) -> dict[str, float]:
        """Return a model's values by unknown, estimated and held ones. Raises NotThere, ParameterError."""
        found = self._parsed(name, _IDENTIFIED)
        values = {**{key: row.value for key, row in found.estimates.items()}, **found.fixed}
        return {key: value for key, value in values.items() if value is not None}

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows of all models, by name."""
        return sorted((self.row(one["name"]) for one in self.listed()), key=lambda row: str(row["name"]))

    def row(self, name: str) -> dict[str, Any]:
        """Return a model's row of the list: `pitch` is True for tuning and design, else `why` has the reason."""
        told: dict[str, Any] = {"name": name, "kept": self.there(name).stat().st_mtime, "values": [], "pitch": False}
        try:
            found = self._parsed(name, _IDENTIFIED)
            told |= {key: (getattr(found, key) or "")[:80] for key in ("experiment", "structure", "method")}
            told["values"] = [
                {"name": key, "value": one.value, "sigma": one.quoted, "unit": one.unit or ""}
                for key, one in [*found.estimates.items(), *(found.sums or {}).items()][:50]
                if not key.endswith(("_0", "_trim", "_bias"))
            ]
            told["informative"] = found.informative
            told |= {"pitch": True, "why": "", "family": dict(self.family(name).values)}
        except TwodofError as reason:
            told |= {"pitch": False, "why": reason.what}
        return told

    def _parsed(self, name: str, form: TypeAdapter[Parsed]) -> Parsed:
        try:
            return form.validate_json(self.content(name))
        except ValidationError as reason:
            what = f"this is not a model: {mistakes_in_words(reason.errors())[0]}"
            raise ParameterError(what, f"model {name}", "identify it again") from reason

    def chosen(self, drone: int) -> str | None:
        """Return the model that guards a drone's tuning, or None."""
        name = self._choices().get(str(drone))
        return name if name in (row["name"] for row in self.listed()) else None

    def choose(self, drone: int, name: str | None) -> None:
        """Choose the model that guards a drone's tuning, None for no model. Raises as `family`."""
        if name is not None:
            self.family(name)
        choices = {**self._choices(), str(drone): name}
        make_folder(self.folder)
        kept = {key: value for key, value in choices.items() if value is not None}
        write_text(self.folder / _CHOICES, json.dumps(kept))

    def _choices(self) -> dict[str, str]:
        try:
            return _CHOSEN.validate_json(read_bytes(self.folder / _CHOICES, MAX_BYTES))
        except (ValidationError, LogError):  # none yet, or damaged: no model guards then, until one is chosen
            return {}


LEAST = 0.035
"""Smallest step [rad] that is shown: a smaller one is mostly noise after scaling."""
MOST_STEPS = 12


def measured_steps(path: str, goal: float) -> dict[str, Any]:
    """Return the last steps of the attitude's set-point in a log, each scaled to go from 0 to `goal` [rad].

    `unclear` has the reason if there are none, as in a log that has no modes or cannot be read.
    """
    try:
        log = kept_log(path)
        flown = [one for one in step_responses(log) if one.loop == "attitude"]
    except LogError as reason:
        return {"steps": [], "unclear": reason.what}
    found = [one.scaled(log, goal) for one in flown if abs(one.after - one.before) >= LEAST]
    return {"steps": found[-MOST_STEPS:], "unclear": ""}


def judge(
    values: dict[str, float],
    changes: dict[str, float],
    diagram: str | None,
    paths: dict[str, str],
    model: str,
    goal: float | None,
) -> dict[str, Any]:
    """Judge the pitch law with `changes` on the family of a `model` (JSON); with a `goal` [rad] add the page's preview.

    `touches` is True if the changes affect the law; if it is False and `goal` is None, the verdict is missing.
    `unstable` is True if a sampled drone, or one that the search found, is unstable.
    """
    before, after = PitchLaw.flown(values, diagram, paths), PitchLaw.flown({**values, **changes}, diagram, paths)
    own = family_in(model)
    told: dict[str, Any] = {
        "controller": after.name,
        "touches": before.digest != after.digest,
        "parameters": sorted(after.parameters),
        "digest": after.digest,
        "unstable": False,
        "text": "",
        "preview": None,
    }
    if goal is None and not told["touches"]:
        return told
    shown = None if goal is None else after.preview(own, goal)
    verdict = after.verdict(own) if shown is None else shown.verdict
    preview = None if shown is None else shown.to_json()
    return {**told, "unstable": not verdict.robust, "text": verdict.text, "preview": preview}


def predicted_step(
    values: dict[str, float],
    changes: dict[str, float],
    diagram: str | None,
    paths: dict[str, str],
    model: str,
    goal: float,
) -> dict[str, Any]:
    """Predict the step of theta by `goal` [rad] under the pitch law with `changes`."""
    return PitchLaw.flown({**values, **changes}, diagram, paths).step(family_in(model), goal)


SECONDS = 60.0
"""Longest judgement [s]: 1 s of one core as a rule, on a busy computer."""


class TuningGuard:
    """Guard that refuses gains that are unstable within the uncertainty of the chosen model, unless confirmed.

    Only a preview has the token for the confirmation, which is valid for these gains, this model and this run of the
    server. Steps are predicted in a process of their own: they follow a slider, and a verdict takes a second.
    """

    def __init__(self, models: ModelFolder, bench: Workbench) -> None:
        self._models, self._bench, self._steps = models, bench, Workbench()
        self._secret = secrets.token_bytes(32)

    async def ask(
        self,
        what: Callable[..., dict[str, Any]],
        one: LabDrone,
        changes: Mapping[str, float],
        model: str,
        goal: float | None,
    ) -> dict[str, Any]:
        """Return `judge` or `predicted_step` of changes by name or path. Raises as these, NotThere, LinkLost."""
        document = json.dumps(self._models.read(model))
        given, active = await self._named(one, changes)
        entries = await one.connection.parameters.entries()
        diagram = active.diagrams.get(ATTITUDE.name)
        law = None if diagram is None else diagram.decode()
        values = _own_names({entry.name: entry.value for entry in entries})
        bench = self._steps if what is predicted_step else self._bench
        return await bench.do(what, values, given, law, dict(active.paths), document, goal, seconds=SECONDS)

    async def close(self) -> None:
        """End the process that predicts steps."""
        await self._steps.close()

    async def check(self, one: LabDrone, changes: Mapping[str, float], confirm: str) -> None:
        """Check a change. Raises Rejected for a missing or wrong token, or if the change cannot be judged."""
        model = self._models.chosen(one.number)
        if model is None:
            return
        given, active = await self._named(one, changes)
        own = {name for name, path in active.paths.items() if path.startswith(f"{ATTITUDE.name}.")}
        if not given.keys() & (own if ATTITUDE.name in active.diagrams else {*GAINS}):
            return
        where = f"drone {one.number}"
        try:
            told = await self.ask(judge, one, changes, model, None)
        except DiagramError as reason:
            what = f"the model '{model}', which guards the drone, cannot judge this: {reason.what}"
            raise Rejected(what, where, "let no model guard the drone, and fly it with care") from reason
        if told["unstable"] and not hmac.compare_digest(confirm.encode(), self.token(model, told).encode()):
            what = f"unstable within the uncertainty of the model '{model}'. {told['text']}"
            raise Rejected(what, where, "choose other gains, or confirm these with the token of their preview")

    async def _named(self, one: LabDrone, changes: Mapping[str, float]) -> tuple[dict[str, float], ActiveController]:
        """Return the changes by the parameters' names on board, and the active controller."""
        active = await one.connection.parameters.active()
        names = {path: name for name, path in active.paths.items()}
        on_board = one.drone.parameters.name_on_board
        return _own_names({names.get(name) or on_board(name): value for name, value in changes.items()}), active

    def token(self, model: str, told: Mapping[str, Any]) -> str:
        """Return the token that confirms a judged law on this model."""
        said = f"{self._models.digest(model)} {told['digest']}".encode()
        return hmac.new(self._secret, said, hashlib.sha256).hexdigest()[:32]


def _own_names(values: Mapping[str, float]) -> dict[str, float]:
    """Return the values by twodof's names; a gain of the real drone has another name too."""
    return {BY_NAME[name].name if name in BY_NAME else name: value for name, value in values.items()}
