"""The virtual rig as an identified model says: its parameters from w_n, xi, mu, tau, k_v and p_v."""

import json
from collections.abc import Mapping
from pathlib import Path

from twodof.errors import LogError, ParameterError, listed
from twodof.flightlog.provenance import read_bytes
from twodof.rig.parameters import load_rig
from twodof.rig.steady_state import model_parameters, moment_gain, velocity_gain
from twodof.signals import GRAVITY, HOVER, Q_AGE

MODEL = ("w_n", "xi", "mu", "tau", "k_v", "p_v")
"""What of a model is taken over, SI units; `lag` [s] too, the part of tau that is the rotors' lag."""

_USED = (*MODEL, "lag")
MAX_BYTES = 1 << 20


def identified_rig(model: Mapping[str, float], base: str | Mapping[str, float] = "paper") -> dict[str, float]:
    """Parameters of the rig that behaves as `model` in hover; what the model does not say stays as in `base`.

    The rig then has the model's figures: `rig.steady_state.model_parameters` gives them back. Names other than `MODEL`
    and "lag" are not looked at. Raises ParameterError for a model without any of them, and for one that is not a
    finite number or that no rig has.
    """
    given = {name: float(model[name]) for name in _USED if name in model}
    if not given.keys() & set(MODEL):
        raise ParameterError(
            f"the model says none of {', '.join(MODEL)}, but {listed(model)}", "rig", "identify pitch-rate or velocity"
        )
    values = dict(load_rig(base).snapshot() if isinstance(base, str) else base)
    rig = {name: float(value) for name, value in values.items()}
    wanted = model_parameters(rig) | given
    mass = rig["mass_drone"] + rig["mass_cart"]
    if "k_v" in given:
        rig["pair_thrust"] *= given["k_v"] / velocity_gain(rig)
    if "p_v" in given:
        rig["rail_viscous"] = given["p_v"] * mass
    if given.keys() & {"mu", "k_v"}:
        rig["inertia"] *= moment_gain(rig, HOVER) / wanted["mu"]
    inertia = rig["inertia"]
    rig["spring"] = wanted["w_n"] ** 2 * inertia - GRAVITY * rig["mass_drone"] * rig["offset"]
    damping = 2.0 * wanted["w_n"] * inertia
    if "xi" in given:
        rig["viscous_idle"] = rig["viscous_run"] = given["xi"] * damping
    if "tau" in given:
        rig["lag"] = given.get("lag", rig["lag"])
        rig["delay"] = given["tau"] + Q_AGE - rig["lag"]
    _check(rig, given)
    return rig


def load_rig_or_model(source: str | Path) -> dict[str, float]:
    """Parameters of the rig called `source` ("lab", "paper"), of a rig's JSON file, or of an identified model's.

    A model's file is what `twodof identify --json` prints, an `Estimate.to_json()`, or {"mu": 358.5, ...}. Raises
    ParameterError for a file that is neither, and as `identified_rig`.
    """
    if str(source) not in ("lab", "paper"):
        try:
            found = json.loads(read_bytes(source, MAX_BYTES))
        except (LogError, ValueError, RecursionError):
            found = None  # load_rig says what is wrong
        estimates = estimates_in(found)
        if estimates is not None:
            return identified_rig(estimates)
    return {name: float(value) for name, value in load_rig(source).snapshot().items()}


def estimates_in(found: object) -> dict[str, float] | None:
    """The values in a fit's JSON, those held among them, or in {"mu": 358.5, ...}; None for anything else."""
    if not isinstance(found, dict):
        return None
    rows = found.get("estimates", found)
    if not isinstance(rows, dict) or not rows.keys() & set(MODEL):
        return None
    held = found.get("fixed")
    values = dict(held) if isinstance(held, dict) else {}
    values |= {name: row.get("value") if isinstance(row, dict) else row for name, row in rows.items()}
    return {
        str(name): float(value)
        for name, value in values.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }


def _check(rig: Mapping[str, float], given: Mapping[str, float]) -> None:
    load = load_rig("paper")
    _, faults = load.check(dict(rig))
    if faults:
        said = ", ".join(f"{name} {value:.4g}" for name, value in given.items())
        raise ParameterError(
            f"no rig has {said}: {'; '.join(faults)}", "identified_rig", "identify it again, or fix what is not known"
        )
