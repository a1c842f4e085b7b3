"""TuningGuard: what a change of parameters does on the model that guards a drone, and whether it needs confirming."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Mapping
from typing import Any

from twodof.design.tuning_preview import GAINS
from twodof.errors import DiagramError, Rejected
from twodof.flight.templates import ATTITUDE
from twodof.gcs.active_controller import ActiveController
from twodof.gcs.parameters import BY_NAME
from twodof.lab.drones.lab_drone import LabDrone
from twodof.lab.models.judgement import judge
from twodof.lab.models.model_folder import ModelFolder
from twodof.lab.workbench.workbench import Workbench

SECONDS = 60.0
"""What a judgement may take: 1 s of one core as a rule, on a computer that does much else."""


class TuningGuard:
    """Refuses changes of the law that the chosen model's uncertainty does not keep stable, unless they are confirmed.

    The token that confirms is told by a preview only. It is of this law and this model, and of this server's run.
    """

    def __init__(self, models: ModelFolder, bench: Workbench) -> None:
        self._models, self._bench = models, bench
        self._secret = secrets.token_bytes(32)

    async def judge(self, one: LabDrone, changes: Mapping[str, float], model: str, goal: float | None) -> Any:
        """What `judgement.judge` says of changes by name or path. Raises as it, NotThere, LinkLost, Timeout."""
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
        """Raises Rejected for a change that needs confirming and is not, or by another change's token.

        So does a change of the law that cannot be judged.
        """
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
        """The changes by the names on board, and what flies there."""
        active = await one.connection.parameters.active()
        names = {path: name for name, path in active.paths.items()}
        on_board = one.drone.parameters.name_on_board
        return _own_names({names.get(name) or on_board(name): value for name, value in changes.items()}), active

    def token(self, model: str, told: Mapping[str, Any]) -> str:
        """What confirms a judged law on this model."""
        said = f"{self._models.digest(model)} {told['digest']}".encode()
        return hmac.new(self._secret, said, hashlib.sha256).hexdigest()[:32]


def _own_names(values: Mapping[str, float]) -> dict[str, float]:
    """By the package's names: each gain of the real drone's list has two, and both change it."""
    return {BY_NAME[name].name if name in BY_NAME else name: value for name, value in values.items()}
