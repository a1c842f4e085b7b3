"""Folder of identified models, and the guard that tries a change of gains on a model first."""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twodof.design.pitch_family import PitchFamily
from twodof.design.robustness import Robustness
from twodof.design.tuning_preview import GAINS, PitchLaw
from twodof.errors import DiagramError, LogError, ParameterError, Rejected, TwodofError, shown
from twodof.flight.templates import ATTITUDE
from twodof.flightlog.atomic import atomic_write, check_free
from twodof.flightlog.log import FlightLog
from twodof.flightlog.provenance import read_bytes
from twodof.gcs.active_controller import ActiveController
from twodof.gcs.parameters import BY_NAME
from twodof.lab.answers import NotThere
from twodof.lab.drones.lab_drone import LabDrone
from twodof.lab.log_work import kept_log
from twodof.lab.processes import Workbench
from twodof.report.step_responses import FlownStep, step_responses

MAX_BYTES = 1 << 20
MOST = 500
SUFFIX = ".json"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]{0,59}")
_CHOICES = ".chosen"
"""File beside the models, under a name that a model cannot have."""


class ModelFolder:
    """Models in `folder`; each is read when it is asked for."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def names(self) -> list[str]:
        """Return the names of the models."""
        found = (path.stem for path in self._folder.glob(f"*{SUFFIX}") if _NAME.fullmatch(path.stem))
        return sorted(found)[:MOST]

    def read(self, name: str) -> dict[str, Any]:
        """Read a model's document. Raises NotThere, ParameterError for a damaged file."""
        try:
            found = json.loads(self._content(name))
        except (ValueError, RecursionError) as reason:
            raise ParameterError(f"it is not JSON: {shown(reason)}", f"model {name}", "identify it again") from reason
        if not isinstance(found, dict):
            raise ParameterError("it is not a model", f"model {name}", "identify it again")
        return found

    def family(self, name: str) -> PitchFamily:
        """Return a pitch model's family, for tuning and design. Raises NotThere, ParameterError for another kind."""
        return PitchFamily.from_identified(self.read(name), f"model {name}")

    def digest(self, name: str) -> str:
        """Return the digest of a model's bytes. Raises NotThere."""
        return hashlib.sha256(self._content(name)).hexdigest()

    def save(self, name: str, document: Mapping[str, Any], overwrite: bool = False) -> None:
        """Keep a model. Raises ParameterError for a wrong name, Rejected for an existing one."""
        path = self._place(name)
        self._folder.mkdir(parents=True, exist_ok=True)
        if len(self.names()) >= MOST:
            raise Rejected(f"there are {MOST} models", "models", "delete some that you no longer need")
        try:
            check_free(path, overwrite)
        except LogError as reason:
            raise Rejected(f"there is a model '{name}' already", "models", "choose another name") from reason
        with atomic_write(path, "w") as file:
            json.dump(document, file, indent=1, allow_nan=False)

    def delete(self, name: str) -> None:
        """Delete a model. Raises NotThere."""
        path = self._place(name)
        if not path.is_file():
            raise _missing(name)
        path.unlink()

    def row(self, name: str) -> dict[str, Any]:
        """Return a model's row of the list: `pitch` is True for tuning and design, else `why` has the reason."""
        told: dict[str, Any] = {"name": name, "kept": self._place(name).stat().st_mtime, "values": [], "pitch": False}
        try:
            document = self.read(name)
            told |= {key: shown_text(document.get(key)) for key in ("experiment", "structure", "method")}
            told["values"] = _values(document)
            told["informative"] = document.get("informative")
            family = PitchFamily.from_identified(document, name)
            told |= {"pitch": True, "why": "", "family": {key: family.values[key] for key in family.values}}
        except TwodofError as reason:
            told["why"] = reason.what
        return told

    def chosen(self, drone: int) -> str | None:
        """Return the model that guards a drone's tuning, or None."""
        name = self._choices().get(str(drone))
        return name if isinstance(name, str) and name in self.names() else None

    def choose(self, drone: int, name: str | None) -> None:
        """Let a model guard a drone's tuning, or none. Raises as `family`."""
        if name is not None:
            self.family(name)
        choices = {**self._choices(), str(drone): name}
        self._folder.mkdir(parents=True, exist_ok=True)
        with atomic_write(self._folder / _CHOICES, "w") as file:
            json.dump({key: value for key, value in choices.items() if value is not None}, file)

    def _choices(self) -> dict[str, Any]:
        try:
            found = json.loads((self._folder / _CHOICES).read_bytes()[:MAX_BYTES])
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def _content(self, name: str) -> bytes:
        path = self._place(name)
        if not path.is_file():
            raise _missing(name)
        return read_bytes(path, MAX_BYTES)

    def _place(self, name: str) -> Path:
        if not _NAME.fullmatch(name) or name.endswith(SUFFIX):
            remedy = "take letters, digits, space, . _ + -, at most 60, and begin with a letter or digit"
            raise ParameterError(f"{shown(name)} cannot be a model's name", "models", remedy)
        return self._folder / f"{name}{SUFFIX}"


def shown_text(value: object) -> str:
    """Return a text of a file, at most 80 letters, or ""."""
    return value[:80] if isinstance(value, str) else ""


def _values(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return name, value, standard deviation and unit of each unknown of the machine."""
    estimates, sums = document.get("estimates"), document.get("sums")
    rows = {**(estimates if isinstance(estimates, dict) else {}), **(sums if isinstance(sums, dict) else {})}
    found = []
    for name, row in [*rows.items()][:50]:
        if isinstance(row, dict) and not name.endswith(("_0", "_trim", "_bias")):
            sigma = row.get("sigma_robust", row.get("sigma"))
            found.append({"name": name, "value": row.get("value"), "sigma": sigma, "unit": row.get("unit", "")})
    return found


def _missing(name: str) -> NotThere:
    return NotThere("there is no such model", f"model {name[:60]}", "GET /api/models lists them")


SHOWN_S = 3.0
LEAST = 0.035
"""A smaller step [rad] is mostly noise once it is scaled."""
MOST_STEPS = 12


def measured_steps(path: str, goal: float) -> dict[str, Any]:
    """Return the last steps of the attitude's set-point in a log, each scaled to go from 0 to `goal` [rad].

    `time` [s] is from the step on, up to the next. `unclear` has the reason if there are none, as in a log that has no
    modes or cannot be read.
    """
    try:
        log = kept_log(path)
        flown = [one for one in step_responses(log) if one.loop == "attitude"]
    except LogError as reason:
        return {"steps": [], "unclear": reason.what}
    ends = [*(one.time for one in flown[1:]), float("inf")]
    found = [
        _scaled(log, one, goal, min(SHOWN_S, end - one.time))
        for one, end in zip(flown, ends, strict=False)
        if abs(one.after - one.before) >= LEAST
    ]
    return {"steps": found[-MOST_STEPS:], "unclear": ""}


def _scaled(log: FlightLog, step: FlownStep, goal: float, shown: float) -> dict[str, Any]:
    factor = goal / (step.after - step.before)
    flown = log["theta"].slice(step.time, step.time + shown)
    figures = step.to_json()
    return {
        "at": step.time,
        "size": step.after - step.before,
        "time": [round(float(t - step.time), 4) for t in flown.time],
        "theta": [float(f"{(v - step.before) * factor:.5g}") for v in flown.value],
        "figures": {name: figures.get(name) for name in ("rise_time", "overshoot", "settling_time", "peak_moment")},
    }


def judge(
    values: dict[str, float],
    changes: dict[str, float],
    diagram: str | None,
    paths: dict[str, str],
    family: dict[str, Any],
    goal: float | None,
) -> dict[str, Any]:
    """Judge the law with `changes` on the `family`; with a `goal` [rad] add the preview of the page.

    `touches` is True if the changes affect the law; without that and without a goal the verdict is missing. `unstable`
    is True if a sampled drone, or one that the search found, is unstable.
    """
    before, after = PitchLaw.flown(values, diagram, paths), PitchLaw.flown({**values, **changes}, diagram, paths)
    own = PitchFamily.from_json(family)
    told: dict[str, Any] = {
        "controller": after.name,
        "touches": before.digest != after.digest,
        "parameters": sorted(after.parameters),
        "digest": after.digest,
        "unstable": False,
        "text": "",
        "preview": None,
    }
    if goal is not None:
        shown = after.preview(own, goal)
        return {**told, **_verdict(shown.verdict), "preview": shown.to_json()}
    return {**told, **_verdict(after.verdict(own))} if told["touches"] else told


def _verdict(found: Robustness) -> dict[str, Any]:
    return {"unstable": not found.robust, "text": found.text}


SECONDS = 60.0
"""Longest judgement [s]: 1 s of one core as a rule, on a busy computer."""


class TuningGuard:
    """Guard that refuses a law which the chosen model's uncertainty does not keep stable, unless it is confirmed.

    Only a preview tells the token that confirms; it is valid for this law, this model and this run of the server.
    """

    def __init__(self, models: ModelFolder, bench: Workbench) -> None:
        self._models, self._bench = models, bench
        self._secret = secrets.token_bytes(32)

    async def judge(self, one: LabDrone, changes: Mapping[str, float], model: str, goal: float | None) -> Any:
        """Judge changes by name or path on a model. Raises as `judge`, NotThere, LinkLost, Timeout."""
        family = self._models.family(model)
        given, active = await self._named(one, changes)
        entries = await one.connection.parameters.entries()
        diagram = active.diagrams.get(ATTITUDE.name)
        return await self._bench.do(
            judge,
            _own_names({entry.name: entry.value for entry in entries}),
            given,
            None if diagram is None else diagram.decode(),
            dict(active.paths),
            family.to_json(),
            goal,
            seconds=SECONDS,
        )

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
            told = await self.judge(one, changes, model, None)
        except DiagramError as reason:
            what = f"the model '{model}', which guards it, cannot judge this: {reason.what}"
            raise Rejected(what, where, "let no model guard the drone, and fly it with care") from reason
        if told["unstable"] and not hmac.compare_digest(confirm.encode(), self.token(model, told).encode()):
            raise Rejected(
                f"the uncertainty of the model '{model}' does not keep this stable. {told['text']}",
                where,
                "take other gains, or confirm it with the token of its preview",
            )

    async def _named(self, one: LabDrone, changes: Mapping[str, float]) -> tuple[dict[str, float], ActiveController]:
        """Return the changes by the names on board, and the active controller."""
        active = await one.connection.parameters.active()
        names = {path: name for name, path in active.paths.items()}
        on_board = one.drone.parameters.name_on_board
        return _own_names({names.get(name) or on_board(name): value for name, value in changes.items()}), active

    def token(self, model: str, told: Mapping[str, Any]) -> str:
        """Return the token that confirms a judged law on this model."""
        said = f"{self._models.digest(model)} {told['digest']}".encode()
        return hmac.new(self._secret, said, hashlib.sha256).hexdigest()[:32]


def _own_names(values: Mapping[str, float]) -> dict[str, float]:
    """Return the values by the package's names; a gain of the real drone has two names."""
    return {BY_NAME[name].name if name in BY_NAME else name: value for name, value in values.items()}
