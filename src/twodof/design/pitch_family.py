"""PitchFamily: a pitch model identified from logs, with the covariance of its parameters and its noise."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from twodof.errors import ParameterError, is_number, listed, shown
from twodof.signals import PERIOD

Array = NDArray[np.float64]

_LOWEST_HZ = 1.0
"""A noise model of .24 s says nothing of slower noise, and the loop takes it away."""

_TURN = 2.0 * math.pi * PERIOD * np.arange(_LOWEST_HZ, 0.5 / PERIOD, 0.5)
_DELAY = np.exp(-1j * _TURN)
_USUAL_S, _FACTOR, _SAMPLES = 0.15, 2.0, 2000
"""Prior of the gust's correlation time, as in `identify.disturbance.gust`, beside a record of so many samples."""


@dataclass(frozen=True)
class FittedNoise:
    """A gust [rad/s2] of the correlation time `gust_time` [s], and the gyro's noise `q_noise` [rad/s].

    `q_band` is the middle [Hz] of the band of the gyro's noise and the squared radius of its poles, as those of the
    rig's vibration; (0, 0) is white noise.
    """

    gust: float
    gust_time: float
    q_noise: float
    q_band: tuple[float, float]

    @classmethod
    def of_rows(cls, rows: Iterable[Mapping[str, Any]], w_n: float, xi: float) -> Self:
        """Return the noise by autoregressions of q, each with `coefficients` and `sigma`, seen through the pitch.

        Gust, white noise and a band are fitted to the mean spectrum by Whittle's likelihood (1953).
        """
        from scipy.optimize import minimize  # imported late: most commands start without it

        spectra = [
            row["sigma"] ** 2 / np.abs(np.polynomial.polynomial.polyval(_DELAY, row["coefficients"])) ** 2
            for row in rows
        ]
        seen = np.mean(spectra, axis=0)
        size = float(seen.mean())
        omega = _TURN / PERIOD
        through = omega**2 / ((w_n**2 - omega**2) ** 2 + (2.0 * xi * w_n * omega) ** 2)

        def parts(theta: Array) -> tuple[Array, Array, Array]:
            time = math.exp(theta[1])
            gust = np.exp(theta[0]) * through * 2.0 * time / (1.0 + (omega * time) ** 2) / PERIOD
            return gust, np.full_like(omega, math.exp(theta[2])), math.exp(theta[3]) * _band(theta[4], theta[5])

        def cost(theta: Array) -> float:
            spectrum = sum(parts(theta)) * size
            prior = ((theta[1] - math.log(_USUAL_S)) / math.log(_FACTOR)) ** 2 / _SAMPLES
            return float(np.mean(np.log(spectrum) + seen / spectrum) + prior)

        fast = _TURN > 0.3
        peak = float(_TURN[fast][seen[fast].argmax()])
        floor = math.log(float(seen[fast].mean()) / size)
        bounds = ((-30.0, 30.0), (math.log(0.01), math.log(3.0)), (-15.0, 5.0), (-15.0, 5.0), (0.3, 2.8), (0.1, 0.98))
        guesses = [
            np.array([math.log(gust / size), math.log(_USUAL_S), floor - 2.0, floor, peak, 0.6])
            for gust in (1e-4, 0.1, 2.0)
        ]
        found = min((minimize(cost, x, method="L-BFGS-B", bounds=bounds) for x in guesses), key=lambda one: one.fun)
        push, white, narrow = np.sqrt(np.exp(found.x[[0, 2, 3]]) * size).tolist()
        time, hertz = math.exp(found.x[1]), float(found.x[4]) / (2.0 * math.pi * PERIOD)
        return cls.of_parts(push, time, white, narrow, hertz, float(found.x[5]))

    @classmethod
    def of_parts(
        cls, gust: float, gust_time: float, white: float, narrow: float, frequency: float, radius2: float
    ) -> Self:
        """Return the noise with the gyro's `white` and `narrow` parts taken together, in the colour of the larger."""
        band = (frequency, radius2) if narrow > white and radius2 > 0.0 else (0.0, 0.0)
        return cls(gust, gust_time, math.hypot(white, narrow), band)


def _band(turn: float, radius2: float) -> Array:
    """Return the spectrum of noise of variance 1 through the band-pass of the rig's vibration (`rig.sensors`)."""
    poles = 1.0 - (1.0 + radius2) * math.cos(turn) * _DELAY + radius2 * _DELAY**2
    return np.asarray(0.5 * (1.0 - radius2) * np.abs(1.0 - _DELAY**2) ** 2 / np.abs(poles) ** 2)


PARAMETERS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"w_n": (1e-3, 100.0), "xi": (0.0, 10.0), "mu": (1e-3, 1e5), "dead_time": (0.0, 0.25), "lag": (0.0, 1.0)}
)
"""Parameters of a member with their physical bounds; a member drawn outside of them is drawn again."""

NOISE_SEED = 1
_UNKNOWNS = 8
"""Unknowns of a pitch and its flight: each takes one independent gust to estimate."""
_SHORTEST, _LONGEST = 1e-3, 100.0
"""Correlation times that a rig can have [s]."""
MOST_MEMBERS = 100_000
_LEAST_TIME, _MOST = 1e-9, 1e300
_USUAL_RADIUS = 0.775  # of the vibration's poles, which earlier models do not tell
_REFUSED, _TRIED = 0.95, 1000  # share of the draws from which on the estimate contradicts the bounds, of so many


@dataclass(frozen=True, eq=False)
class PitchMembers:
    """Members of a family, each array of shape (n,): w_n [rad/s], xi, mu [rad/s2], dead_time [s], lag [s]."""

    w_n: Array
    xi: Array
    mu: Array
    dead_time: Array
    lag: Array

    @classmethod
    def of(cls, values: Mapping[str, float]) -> Self:
        """Return the only member with these `values`."""
        return cls(**{name: np.array([float(values[name])]) for name in PARAMETERS})

    def __len__(self) -> int:
        return int(self.mu.size)

    def one(self, index: int) -> dict[str, float]:
        """Return the parameters of the member `index` by name."""
        return {name: float(getattr(self, name)[index]) for name in PARAMETERS}


@dataclass(frozen=True, eq=False)
class PitchFamily:
    """Family of drones with theta'' = -w_n^2 theta - 2 xi w_n theta' + mu m + gust.

    m follows M behind `dead_time` and the rotors' `lag`. `values` has the estimate by the names of `PARAMETERS`.
    `covariance` (k, k) is that of the parameters named in `uncertain`, in their order. `gust` [rad/s2] is the standard
    deviation of the disturbance, a Gauss-Markov process with the correlation time `gust_time` [s]. `q_noise` [rad/s] is
    the standard deviation of a sample of the measured rate, and `q_band` its colour (`FittedNoise`). `gust_freedom` is
    the number of independent gusts in the `gust_flights` flights that told `gust`; 0: it is known. `notes` say which
    estimates were taken for their physical bound. Raises ParameterError for an unknown or missing name and for a number
    out of its bounds.
    """

    values: Mapping[str, float]
    uncertain: tuple[str, ...] = ()
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    gust: float = 0.0
    gust_time: float = 0.1
    q_noise: float = 0.0
    q_band: tuple[float, float] = (0.0, 0.0)
    gust_freedom: float = 0.0
    gust_flights: int = 1
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if set(self.values) != set(PARAMETERS):
            raise _error(f"the values have the names {listed(self.values)}", f"give {', '.join(PARAMETERS)}")
        figures = {name: (self.values[name], *bounds) for name, bounds in PARAMETERS.items()}
        figures |= {name: (getattr(self, name), 0.0, _MOST) for name in ("gust", "q_noise")}
        figures["gust_time"] = (self.gust_time, _LEAST_TIME, _MOST)
        figures |= {"q_band[0]": (self.q_band[0], 0.0, 0.5 / PERIOD), "q_band[1]": (self.q_band[1], 0.0, 0.999)}
        figures["gust_freedom"] = (self.gust_freedom, 1e-6 if self.gust_freedom else 0.0, _MOST)
        figures["gust_flights"] = (self.gust_flights, 0, _MOST)
        for name, (value, low, high) in figures.items():
            if not is_number(value, low, high):
                raise _error(f"{name} = {shown(value)} is out of range", f"give a number from {low:g} to {high:g}")
        k = len(self.uncertain)
        if not set(self.uncertain) <= set(PARAMETERS) or len(set(self.uncertain)) < k:
            what = f"the uncertain parameters {listed(self.uncertain)} are unknown or named twice"
            raise _error(what, f"name some of {', '.join(PARAMETERS)}, each once")
        p = check_covariance(self.covariance, k)
        if k and float(np.linalg.eigvalsh(_scaled(p)).min()) < -1e-6:
            raise _error("the covariance has a negative eigenvalue", "identify again, or give sigmas alone")

    @classmethod
    def of(
        cls,
        values: Mapping[str, float],
        sigmas: Mapping[str, float] | None = None,
        gust: float = 0.0,
        gust_time: float = 0.1,
        q_noise: float = 0.0,
    ) -> Self:
        """Return a family with `values` and independent standard deviations `sigmas`, both by parameter name.

        `tau` may replace dead_time and lag in both.

        Raises ParameterError as the class does.
        """
        spread = {_own(name): sigma for name, sigma in (sigmas or {}).items()}
        p = np.diag(np.square(np.array(list(spread.values()), dtype=float))) if spread else np.zeros((0, 0))
        return cls(_complete(values), tuple(spread), p, gust, gust_time, q_noise)

    @classmethod
    def from_identified(cls, document: object, where: str = "model", noise: bool = True) -> Self:
        """Return the family in `document`, the output of `twodof identify --json` for one flight or for several.

        For one flight each parameter has the larger of its plain and its robust standard deviation. Gust and gyro have
        the spectrum of the noise that was fitted (`FittedNoise`); residuals taken for white are the gyro's. For several
        flights their spread counts, for what differs between them also differs in the next one. An estimate beyond its
        physical bound is taken for the bound. Without `noise` that of the fit is left out, whose parting takes a part
        of a second. Raises ParameterError for another document and where w_n, xi, mu or tau is missing.
        """
        if not isinstance(document, Mapping):
            raise _error(f"{shown(document)} is not a model", "give the output of `twodof identify --json`", where)
        try:
            if "repeated" in document:
                return cls._of_several(document, where, noise)
            if "model" in document and "estimates" not in document:
                return cls.of({k: float(v) for k, v in document["model"].items()})
            return cls._of_one(document, where, noise)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as reason:
            what = f"this is not an identified model ({type(reason).__name__}: {reason!s:.80})"
            raise _error(what, "give the output of `twodof identify --json`", where) from reason

    @classmethod
    def _of_one(cls, document: Mapping[str, Any], where: str, noise: bool) -> Self:
        estimates = document["estimates"]
        labels = list(estimates)
        given = {name: float(value) for name, value in document.get("fixed", {}).items()}
        given |= {label: float(row["value"]) for label, row in estimates.items()}
        values = {name: given[name] for name in (*PARAMETERS, "tau") if name in given}
        missing = [
            name for name in ("w_n", "xi", "mu", "tau") if name not in {*values, "tau" if "dead_time" in values else ""}
        ]
        if missing:
            raise _error(
                f"the model has no {', '.join(missing)}",
                "identify the pitch: twodof identify LOG --experiment doublet --impulse LOG --json",
                where,
            )
        wanted = [label for label in _told_apart(labels) if _own(label) in PARAMETERS]
        sigmas = np.array([max(sigma_in(estimates[n], k) for k in ("sigma", "sigma_robust")) for n in wanted])
        delay = (document.get("sums") or {}).get("tau")
        if delay and {"dead_time", "lag"} <= set(wanted) and estimates["lag"]["sigma"] is None:
            # Of a lag that its bound holds, the dead time has all the doubt of the sum, and no more.
            sigmas[wanted.index("dead_time")] = sigma_in(delay, "sigma")
        at = [labels.index(label) for label in wanted]
        correlation = np.array(document["correlation"], dtype=float)[np.ix_(at, at)]
        correlation = np.where(np.isfinite(correlation), correlation, np.eye(len(at)))
        residual = float(document.get("noise", {}).get("q", 0.0))
        covariance = correlation * np.outer(sigmas, sigmas)
        covariance = 0.5 * (covariance + covariance.T)
        physical, notes = _physical(_complete(values))
        found = cls(physical, tuple(map(_own, wanted)), covariance, q_noise=residual, notes=notes)
        fitted = document.get("disturbance") or {}
        gusts, rows = fitted.get("gusts", {}).get("q"), list(fitted.get("noise", {}).values())
        if gusts is not None:
            # A gust as the input that would push as hard; what is left of q is the sensor's noise and the vibration.
            push, band = (
                float(gusts["std"]) * physical["mu"],
                (gusts["frequency"], gusts.get("radius", _USUAL_RADIUS) ** 2),
            )
            seen = FittedNoise.of_parts(push, gusts["correlation_time"], gusts["white"], gusts["narrow"], *band)
        elif rows and noise:
            seen = FittedNoise.of_rows(rows, physical["w_n"], physical["xi"])
        else:
            return found
        seconds = sum(one["samples"] for one in document.get("identification", ()) if one["output"] == "q") * PERIOD
        return replace(found, **vars(seen), gust_freedom=seconds / seen.gust_time)

    @classmethod
    def _of_several(cls, document: Mapping[str, Any], where: str, noise: bool) -> Self:
        flights = [cls._of_one(one, where, noise) for one in document["flights"].values()]
        wanted = [name for name in map(_own, _told_apart(document["repeated"])) if name in PARAMETERS]
        rows = np.array([[one.values[name] for name in wanted] for one in flights])
        mean = dict(zip(wanted, rows.mean(axis=0).tolist(), strict=True))
        # The next flight differs from this mean by its own part and by what the mean is off.
        p = np.atleast_2d(np.cov(rows, rowvar=False, ddof=1)) * (1.0 + 1.0 / len(rows))
        gyro = math.sqrt(float(np.mean([one.q_noise**2 for one in flights])))
        lasting = 1.0 / float(np.mean([1.0 / one.gust_time for one in flights]))
        gust = math.sqrt(lasting * float(np.mean([one.gust**2 / one.gust_time for one in flights])))
        told = [one.gust_freedom * one.gust_time for one in flights if one.gust_freedom]
        disturbance = gust, lasting, gyro, flights[0].q_band, sum(told) / lasting, len(told)
        return cls({**flights[0].values, **mean}, tuple(wanted), p, *disturbance, flights[0].notes)

    def disturbed(
        self, gust: float | None = None, gust_time: float | None = None, q_noise: float | None = None
    ) -> Self:
        """Return the family with another disturbance; None leaves a figure as it is. A given gust is known."""
        given: dict[str, Any] = {"gust": gust, "gust_time": gust_time, "q_noise": q_noise}
        given["gust_freedom"] = None if gust is None and gust_time is None else 0.0
        return replace(self, **{name: value for name, value in given.items() if value is not None})

    def nominal(self) -> PitchMembers:
        """Return the estimate itself, as the only member."""
        return PitchMembers.of(self.values)

    def draw(self, count: int, seed: int = NOISE_SEED) -> PitchMembers:
        """Draw `count` members by the estimate's normal distribution; draw those out of bounds (`PARAMETERS`) again.

        Raises ParameterError for a count that is not 1 to `MOST_MEMBERS`, and if most draws are out of bounds.
        """
        if not is_number(count, 1, MOST_MEMBERS, whole=True):
            raise _error(f"{shown(count)} members cannot be drawn", f"give 1 to {MOST_MEMBERS}")
        columns = {name: np.full(count, float(self.values[name])) for name in PARAMETERS}
        if self.uncertain:
            centre = np.array([self.values[name] for name in self.uncertain], dtype=float)
            bounds = np.array([PARAMETERS[name] for name in self.uncertain])
            drawn = draw_within(centre, self.root(), bounds, count, np.random.default_rng(seed))
            columns |= {name: drawn[:, i] for i, name in enumerate(self.uncertain)}
        return PitchMembers(**columns)

    def gusts(self, count: int, seed: int = NOISE_SEED) -> tuple[Array, Array]:
        """Draw standard deviation and correlation time [s] of the gust, each (count,), as far as they are open.

        A flight of length S tells the power of what is new in a gust, 2 gust^2 / gust_time, by its freedom less the
        unknowns of the fit. It tells the rate r = 1 / gust_time to sqrt(2 r / S), and takes it for 4 / S too fast
        (Marriott and Pope, 1954; Kendall, 1954). So a short flight has gusts that are too weak and too short. None is
        drawn longer than all flights together: of fewer than 6 gusts half of the draws are as long.
        """
        if not self.gust_freedom:
            return np.full(count, self.gust), np.full(count, self.gust_time)
        rng, flights = np.random.default_rng((seed, 1)), max(1, self.gust_flights)
        length, freedom = self.gust_freedom * self.gust_time, max(self.gust_freedom - flights * _UNKNOWNS, 4.0)
        slowest, variance = max(1.0 / length, 1.0 / _LONGEST), 2.0 / (self.gust_time * length)
        mean = max(1.0 / self.gust_time - 4.0 * flights / length, slowest)
        rate = np.clip(rng.gamma(mean**2 / variance, variance / mean, count), slowest, 1.0 / _SHORTEST)
        power = freedom / rng.chisquare(freedom, count) / self.gust_time
        return np.asarray(self.gust * np.sqrt(power / rate)), np.asarray(1.0 / rate)

    def root(self) -> Array:
        """Return a square root of the covariance, (k, k): the root times its transpose is the covariance."""
        size = np.sqrt(np.diag(self.covariance))
        values, vectors = np.linalg.eigh(_scaled(self.covariance))
        return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))

    def to_json(self) -> dict[str, Any]:
        """Return plain data, which `from_json` reads back."""
        return {
            "values": {name: float(value) for name, value in self.values.items()},
            "uncertain": list(self.uncertain),
            "covariance": np.asarray(self.covariance).tolist(),
            "gust": self.gust,
            "gust_time": self.gust_time,
            "q_noise": self.q_noise,
            "q_band": list(self.q_band),
            "gust_freedom": self.gust_freedom,
            "gust_flights": self.gust_flights,
        }

    @classmethod
    def from_json(cls, data: object, where: str = "family") -> Self:
        """Return the family that `to_json` wrote. Raise ParameterError for anything else."""
        try:
            if not isinstance(data, Mapping):
                raise TypeError(shown(data))
            k, band = len(data["uncertain"]), data.get("q_band", (0.0, 0.0))
            return cls(
                dict(data["values"]),
                tuple(data["uncertain"]),
                np.array(data["covariance"], dtype=float).reshape(k, k),
                float(data["gust"]),
                float(data["gust_time"]),
                float(data["q_noise"]),
                (float(band[0]), float(band[1])),
                float(data.get("gust_freedom", 0.0)),
                int(data.get("gust_flights", 1)),
            )
        except (KeyError, TypeError, ValueError, IndexError) as reason:
            raise _error(f"this is not a family ({reason!s:.80})", "give the `family` of a promise", where) from reason


def check_covariance(covariance: Array, size: int, where: str = "PitchFamily") -> Array:
    """Check that a covariance is finite and symmetric, (size, size), and return it. Raises ParameterError."""
    p = np.asarray(covariance, dtype=float)
    if p.shape != (size, size) or not np.isfinite(p).all() or not np.allclose(p, p.T, rtol=1e-6, atol=1e-300):
        what = f"a covariance of shape {p.shape} is not finite, not symmetric or not ({size}, {size})"
        raise _error(what, f"give finite numbers, symmetric, ({size}, {size})", where)
    return p


def draw_within(centre: Array, root: Array, bounds: Array, count: int, rng: np.random.Generator) -> Array:
    """Draw (count, k) parameters around `centre` (k,); draw those outside `bounds` (k, 2) again.

    `root` (k, k) is a square root of the covariance. Raises ParameterError if hardly a draw is within the bounds.
    """
    kept, tried = np.zeros((0, len(centre))), 0
    while len(kept) < count:
        rows = centre + rng.standard_normal((2 * count + 16, len(centre))) @ root.T
        kept = np.concatenate([kept, rows[((rows >= bounds[:, 0]) & (rows <= bounds[:, 1])).all(axis=1)]])
        tried += len(rows)
        if tried > _TRIED and len(kept) < (1.0 - _REFUSED) * tried:
            what = "95 % of the drawn members are not physical: the data contradict the bounds of the parameters"
            raise _error(what, "identify again, with more excitation or with w_n and xi held")
    return kept[:count]


def _told_apart(labels: Iterable[str]) -> list[str]:
    """Return the labels without the sum tau if its parts, dead time and lag, are among them."""
    every = list(labels)
    return [label for label in every if label != "tau" or "dead_time" not in every]


def _own(label: str) -> str:
    """Return the parameter that a label stands for: the paper's one delay tau is a dead time without lag."""
    return "dead_time" if label == "tau" else label


def _complete(values: Mapping[str, float]) -> dict[str, float]:
    own = {name: value for name, value in values.items() if name in PARAMETERS}
    if "dead_time" not in own and "tau" in values:
        own["dead_time"] = values["tau"] - own.get("lag", 0.0)
    return {"lag": 0.0, **own}


@lru_cache(maxsize=8)
def family_in(text: str) -> PitchFamily:
    """Return the family in a model's JSON, kept, as to part its noise takes a search. Raises as `from_identified`."""
    return PitchFamily.from_identified(json.loads(text))


def _physical(values: Mapping[str, float]) -> tuple[dict[str, float], tuple[str, ...]]:
    """Return the values within the bounds of `PARAMETERS`, and a note on each that was not, but is finite."""
    clipped = {name: min(max(value, PARAMETERS[name][0]), PARAMETERS[name][1]) for name, value in values.items()}
    notes = tuple(
        f"{name} {values[name]:.3g} is taken for {value:g}, the physical bound"
        for name, value in clipped.items()
        if value != values[name] and math.isfinite(values[name])
    )
    return {name: value if math.isfinite(values[name]) else values[name] for name, value in clipped.items()}, notes


def sigma_in(row: Mapping[str, Any], name: str) -> float:
    """Return a standard deviation of an estimate's row; 0 where it is missing or not finite."""
    value = row.get(name)
    return float(value) if value is not None and math.isfinite(value) else 0.0


def _scaled(p: Array) -> Array:
    """Return the correlation of a covariance; a parameter without variance correlates with none."""
    size = np.sqrt(np.maximum(np.diag(p), 0.0))
    size = np.where(size > 0.0, size, 1.0)
    return np.asarray(p / np.outer(size, size))


def _error(what: str, remedy: str, where: str = "PitchFamily") -> ParameterError:
    return ParameterError(what, where, remedy)
