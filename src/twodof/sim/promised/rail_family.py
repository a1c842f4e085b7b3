"""RailFamily: the pitch and the cart as logs show them, each an estimate with its covariance, as rigs that fly."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from twodof.design.pitch_family import PitchFamily
from twodof.errors import ParameterError, shown
from twodof.rig.parameters import load_rig
from twodof.sim.resimulation import identified_rig

Array = NDArray[np.float64]

RAIL = ("k_v", "p_v")
_BOUNDS: Mapping[str, tuple[float, float]] = {"k_v": (0.1, 100.0), "p_v": (0.0, 50.0)}
_REFUSED = 0.5  # of the draws


@dataclass(frozen=True, eq=False)
class RailFamily:
    """`pitch`, and the cart v = -k_v / (s + p_v) theta with the `covariance` (2, 2) of (k_v [m/s2], p_v [1/s]).

    What neither tells, such as sensors and battery, is that of the rig `base`. Raises ParameterError for numbers that
    cannot be.
    """

    pitch: PitchFamily
    k_v: float
    p_v: float
    covariance: Array = field(default_factory=lambda: np.zeros((2, 2)))
    base: str = "paper"

    def __post_init__(self) -> None:
        for name, (low, high) in _BOUNDS.items():
            if not low <= getattr(self, name) <= high:
                raise _error(f"{name} = {getattr(self, name)!r}", f"{low:g} to {high:g} is possible")
        p = np.asarray(self.covariance, dtype=float)
        if p.shape != (2, 2) or not np.isfinite(p).all() or not np.allclose(p, p.T, rtol=1e-6, atol=1e-300):
            raise _error(f"a covariance of shape {p.shape}", "give finite numbers, symmetric, (2, 2)")
        if (np.diag(p) < 0.0).any() or float(np.linalg.det(p)) < -1e-12 * float(np.prod(np.diag(p)) + 1e-300):
            raise _error("the covariance has a negative direction", "identify again")

    @classmethod
    def from_identified(cls, pitch: object, rail: object, base: str = "paper", where: str = "model") -> Self:
        """Of two documents of `twodof identify --out`: the pitch's, and that of a flight that moved the cart.

        Raises ParameterError for others, and where k_v or p_v is missing.
        """
        family = PitchFamily.from_identified(pitch, where)
        try:
            if not isinstance(rail, Mapping):
                raise TypeError(shown(rail))
            rows: Mapping[str, Any] = rail["estimates"]
            at = [list(rows).index(name) for name in RAIL]
            sigma = np.array([max(_sigma(rows[n], key) for key in ("sigma", "sigma_robust")) for n in RAIL])
            correlation = np.array(rail["correlation"], dtype=float)[np.ix_(at, at)]
            correlation = np.where(np.isfinite(correlation), correlation, np.eye(2))
            k_v, p_v = (float(rows[name]["value"]) for name in RAIL)
        except (KeyError, TypeError, ValueError, IndexError) as reason:
            raise ParameterError(
                f"it is not a model of the cart ({type(reason).__name__}: {reason!s:.80})",
                where,
                "give what `twodof identify LOG --out` wrote of a velocity-doublet",
            ) from reason
        return cls(family, k_v, p_v, 0.5 * (correlation + correlation.T) * np.outer(sigma, sigma), base)

    def rigs(self, count: int, seed: int = 1) -> list[dict[str, float]]:
        """`count` rigs, each a member that was drawn, with the family's gust and noise.

        Raises ParameterError as `PitchFamily.draw`, and for members that no rig is.
        """
        drawn, cart = self.pitch.draw(count, seed), self._cart(count, np.random.default_rng(seed + 1))
        base = dict(load_rig(self.base).snapshot())
        return [self._rig(drawn.one(k), cart[k], base) for k in range(count)]

    def nominal(self) -> dict[str, float]:
        """Return the rig with the estimated values."""
        base = dict(load_rig(self.base).snapshot())
        return self._rig(self.pitch.nominal().one(0), np.array([self.k_v, self.p_v]), base)

    def _rig(self, member: Mapping[str, float], cart: Array, base: Mapping[str, float]) -> dict[str, float]:
        tau = member["dead_time"] + member["lag"]
        model = {**member, "tau": tau, "k_v": float(cart[0]), "p_v": float(cart[1])}
        rig = identified_rig(model, base)
        if self.pitch.gust > 0.0:
            rig["gust"], rig["gust_time"] = self.pitch.gust * rig["inertia"], self.pitch.gust_time
        if self.pitch.q_noise > 0.0:
            rig["gyro_hover"] = self.pitch.q_noise
        return rig

    def _cart(self, count: int, rng: np.random.Generator) -> Array:
        """(count, 2), drawn again where it is beyond the bounds."""
        bounds = np.array([_BOUNDS[name] for name in RAIL])
        values, vectors = np.linalg.eigh(np.asarray(self.covariance, dtype=float))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        kept, tried = np.zeros((0, 2)), 0
        while len(kept) < count:
            rows = np.array([self.k_v, self.p_v]) + rng.standard_normal((2 * count + 16, 2)) @ root.T
            kept = np.concatenate([kept, rows[((rows >= bounds[:, 0]) & (rows <= bounds[:, 1])).all(axis=1)]])
            tried += len(rows)
            if len(kept) < (1.0 - _REFUSED) * tried:
                raise _error("most carts that are drawn cannot be: the data hardly tell k_v and p_v", "identify again")
        return kept[:count]

    def to_json(self) -> dict[str, Any]:
        """Plain data, which `from_json` reads back."""
        cart = {"k_v": self.k_v, "p_v": self.p_v, "covariance": np.asarray(self.covariance).tolist()}
        return {"pitch": self.pitch.to_json(), **cart, "base": self.base}

    @classmethod
    def from_json(cls, data: Mapping[str, Any], where: str = "family") -> Self:
        """Return the family of a `to_json`. Raise an error for anything else."""
        pitch = PitchFamily.from_json(data["pitch"], where)
        covariance = np.array(data["covariance"], dtype=float)
        return cls(pitch, float(data["k_v"]), float(data["p_v"]), covariance, str(data["base"]))


def _sigma(row: Mapping[str, Any], name: str) -> float:
    value = row.get(name)
    return float(value) if value is not None and math.isfinite(value) else 0.0


def _error(what: str, remedy: str) -> ParameterError:
    return ParameterError(what, "RailFamily", remedy)
