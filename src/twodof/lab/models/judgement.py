"""What a change of parameters does to the law of the pitch, judged in a process of its own: plain data in and out."""

from __future__ import annotations

from typing import Any

from twodof.design.pitch_family import PitchFamily
from twodof.design.robustness import Robustness
from twodof.design.tuning_preview import PitchLaw


def judge(
    values: dict[str, float],
    changes: dict[str, float],
    diagram: str | None,
    paths: dict[str, str],
    family: dict[str, Any],
    goal: float | None,
) -> dict[str, Any]:
    """The law with `changes` on the `family`: its verdict, and with a `goal` [rad] what a page shows of it.

    `touches` tells whether they change the law at all; where they do not, and nothing is shown, there is no verdict.
    `unstable`: a sampled drone, or one that the search found, is unstable.
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
