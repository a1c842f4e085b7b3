"""The job that designs a controller for an identified model, and writes it among the user's diagrams."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from twodof.design.designed_controller import design_controller
from twodof.design.pitch_family import PitchFamily
from twodof.errors import ParameterError, shown
from twodof.flight.starters import save_diagram
from twodof.flightlog.atomic import check_free

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]{0,59}")


def design(
    progress: Callable[[float, str], None],
    family: dict[str, Any],
    folder: str,
    name: str,
    crossover: float,
    phase_margin: float | None,
    method: str,
    overwrite: bool,
) -> dict[str, Any]:
    """Design, promise, and write NAME.json into `folder`; `file` is None where the family is not kept stable."""
    if not _NAME.fullmatch(name) or name.endswith(".json"):
        remedy = "take letters, digits, space, . _ + -, at most 60, without .json"
        raise ParameterError(f"{shown(name)} cannot be a diagram's name", "design", remedy)
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    path = place / f"{name}.json"
    check_free(path, overwrite)
    progress(0.02, "the gains")
    made = design_controller(
        PitchFamily.from_json(family),
        crossover,
        phase_margin,
        method=method,
        said=lambda text, share: progress(share, text),
    )
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
