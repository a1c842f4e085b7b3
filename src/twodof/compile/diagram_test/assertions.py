"""Assertions over time about one signal: the text that a user writes, and its judgement.

    SIGNAL never above V [WHEN]             SIGNAL settles within B of V by T
    SIGNAL never below V [WHEN]             SIGNAL rises to V before T
    SIGNAL always within [A, B] [WHEN]      SIGNAL falls to V before T
    SIGNAL always equals V [WHEN]           SIGNAL final value within B of V

WHEN is `between T1 and T2`, `from T` or `until T`, ends included; without it the whole scenario counts. Times are
seconds. A limit itself is allowed; NaN is not.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twodof.errors import DiagramError, shown

_ROUNDING = 1e-6
"""In ticks: .3 s is tick 75 of 4 ms, although .3 / .004 is a little less than 75 in binary."""
_FAR = 2.0**53
"""A tick after the end of any scenario; it stands for infinite times."""

Index = tuple[int, ...]
"""() of a scalar, (i,) of a vector, (row, column) of a matrix; from 0 on."""


def first_tick(time: float, dt: float) -> int:
    """Return the first tick at or after `time` [s]."""
    return math.ceil(max(-_FAR, min(_FAR, time / dt)) - _ROUNDING)


def last_tick(time: float, dt: float) -> int:
    """Return the last tick at or before `time` [s]."""
    return math.floor(max(-_FAR, min(_FAR, time / dt)) + _ROUNDING)


_SIGNAL = r"[A-Za-z][\w.]*(?:\[\s*\d{1,7}\s*(?:,\s*\d{1,7}\s*)?\])?"


def parse_element(text: str, where: str) -> tuple[str, Index]:
    """Return the signal's name and the index in `y`, `part.port`, `v[2]` or `A[0, 1]`; DiagramError for other texts."""
    if not re.fullmatch(_SIGNAL, text, re.ASCII):
        raise DiagramError(f"{shown(text)} is not the name of a signal", where, "write y, part.port, v[0] or A[0, 1]")
    name, _, index = text.partition("[")
    return name, tuple(int(i) for i in index.rstrip("]").split(",")) if index else ()


def check_index(index: Index, axes: tuple[int, ...], name: str, where: str) -> None:
    """Raise DiagramError unless `index` names one number of a value with these axes."""
    if len(index) != len(axes) or any(i >= n for i, n in zip(index, axes, strict=True)):
        what = f"it is an array of {' x '.join(map(str, axes))}" if axes else "it is not an array"
        first = f"{name}[{', '.join('0' * len(axes))}]"
        raise DiagramError(what, where, f"name an element, {first}, from 0 on" if axes else f"write {name}")


def element_of(signals: Mapping[str, NDArray[Any]], text: str, where: str) -> NDArray[Any]:
    """Return the values of the named element, of shape (n,); the first axis of each array is the step."""
    name, index = parse_element(text, where)
    check_index(index, signals[name].shape[1:], name, where)
    place: tuple[Any, ...] = (slice(None), *index)
    found: NDArray[Any] = signals[name][place]
    return found


@dataclass(frozen=True)
class Judgement:
    """Result of one assertion; `text` says it in words.

    `tick`, `time` [s] and `value` are those of the first violation. The value passed `limit` by `by` (NaN for a NaN).
    All are None for an assertion that holds.
    """

    check: str
    signal: str
    passed: bool
    text: str
    tick: int | None = None
    time: float | None = None
    value: float | None = None
    limit: float | None = None
    by: float | None = None


def first_violation(
    check: str,
    signal: str,
    values: NDArray[np.float64],
    limits: NDArray[np.float64],
    ticks: NDArray[np.int64],
    dt: float,
) -> Judgement:
    """Return the judgement of a failed assertion: `values` passed `limits` at `ticks`, one row a violation."""
    with np.errstate(over="ignore"):
        by = np.abs(values - limits)
    worst = int(np.argmax(np.where(np.isnan(by), np.inf, by)))

    def at(i: int) -> str:
        side = "is not" if np.isnan(values[i]) else "is above" if values[i] > limits[i] else "is below"
        far = "" if np.isnan(by[i]) else f" by {by[i]:.3g}"
        return f"{values[i]:.6g} at {ticks[i] * dt:.6g} s {side} {limits[i]:.6g}{far}"

    text = at(0)
    if len(ticks) > 1:
        text += f"; {len(ticks)} ticks in all" + (f", the worst: {at(worst)}" if worst else "")
    tick = int(ticks[0])
    return Judgement(check, signal, False, text, tick, tick * dt, float(values[0]), float(limits[0]), float(by[0]))


class Assertion(Protocol):
    """Claim about a signal: `text` as the user wrote it, `signal` by name or path, perhaps with an index."""

    @property
    def text(self) -> str:
        """The text."""

    @property
    def signal(self) -> str:
        """The signal."""

    def judge(self, values: NDArray[np.float64], dt: float) -> Judgement:
        """Judge the signal's `values`, one for each tick of `dt` [s] from 0."""


@dataclass(frozen=True)
class Stays:
    """Limits at each tick from `start` to `stop` [s]; by default at all ticks, with `last` at the last one only."""

    text: str
    signal: str
    low: float
    high: float
    start: float | None = None
    stop: float | None = None
    last: bool = False
    settles: bool = False  # the result says when the signal came into the band

    def judge(self, values: NDArray[np.float64], dt: float) -> Judgement:
        """Judge `values`. Raises DiagramError for times outside the scenario."""
        end = len(values) - 1
        first = 0 if self.start is None else first_tick(self.start, dt)
        final = end if self.stop is None else last_tick(self.stop, dt)
        first = end if self.last else first
        if first > final or final > end:
            late = self.stop is not None and first <= end < final
            what = "the scenario ends before," if late else "no tick lies there: the scenario ends"
            raise DiagramError(f"{what} at {end * dt:g} s", self.text, "change the times, or give a longer duration")
        within = (values >= self.low) & (values <= self.high)
        part = values[first : final + 1]
        wrong = np.flatnonzero(~within[first : final + 1])
        if len(wrong):
            low = self.low if math.isfinite(self.low) else self.high
            limits = np.where(part[wrong] > self.high, self.high, low)
            return first_violation(self.text, self.signal, part[wrong], limits, wrong + first, dt)
        if self.settles:
            outside = np.flatnonzero(~within)
            return self._holds(f"settled at {(outside[-1] + 1 if len(outside) else 0) * dt:.6g} s")
        if self.last:
            return self._holds(f"{part[-1]:.6g}")
        with np.errstate(invalid="ignore", over="ignore"):  # infinity may be within infinite limits
            nearest = int(np.argmin(np.fmin(part - self.low, self.high - part)))
        return self._holds(f"nearest to a limit: {part[nearest]:.6g} at {(first + nearest) * dt:.6g} s")

    def _holds(self, text: str) -> Judgement:
        return Judgement(self.text, self.signal, True, text)


@dataclass(frozen=True)
class Reaches:
    """Rise from below `value` (fall from above it) to `value` at a tick before `before` [s]."""

    text: str
    signal: str
    value: float
    before: float
    rising: bool = True

    def judge(self, values: NDArray[np.float64], dt: float) -> Judgement:
        """Judge `values`. Raises DiagramError if the scenario ends before the time."""
        final = first_tick(self.before, dt) - 1
        if not 0 <= final < len(values):
            end = (len(values) - 1) * dt
            raise DiagramError(f"the scenario ends at {end:g} s", self.text, "change the time or the duration")
        part = values[: final + 1]
        there = np.flatnonzero(part >= self.value if self.rising else part <= self.value)
        if len(there) and there[0] > 0 and not np.isnan(part[0]):
            return Judgement(self.text, self.signal, True, f"at {there[0] * dt:.6g} s")
        if len(there) and there[0] == 0:
            final, found = 0, float(part[0])
            text = f"it begins at {found:.6g}, so it does not {'rise' if self.rising else 'fall'} to {self.value:.6g}"
        else:
            found = float(np.fmax.reduce(part) if self.rising else np.fmin.reduce(part))
            text = f"it comes to {found:.6g}, {abs(self.value - found):.3g} short of {self.value:.6g}"
        by = abs(self.value - found)
        return Judgement(self.text, self.signal, False, text, final, final * dt, found, self.value, by)


_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_WHEN = "(?: between T1 and T2| from T3| until T4)?"
FORMS: Mapping[str, str] = {
    "never above V": f"never above V{_WHEN}",
    "never below V": f"never below V{_WHEN}",
    "always within [A, B]": rf"always within ?\[ ?A ?, ?B ?\]{_WHEN}",
    "always equals V": f"always equals V{_WHEN}",
    "settles within B of V by T": "settles within B of V by T1",
    "rises to V before T": "rises to V before T1",
    "falls to V before T": "falls to V before T1",
    "final value within B of V": "final value within B of V",
}
"""The forms of a claim, and their patterns; a word in capitals stands for a number."""


def _pattern(form: str) -> re.Pattern[str]:
    def number(found: re.Match[str]) -> str:
        name = found[0].lower()
        value = rf"{_NUMBER}|[A-Za-z]\w*" if name == "v" else _NUMBER
        return f"(?P<{name}>{value})" + (r"(?: ?s\b)?" if name.startswith("t") else "")

    text = re.sub(r"\b(?:[ABV]|T\d)\b", number, form)
    return re.compile(rf"(?P<signal>{_SIGNAL}) {text}", re.ASCII)


_PATTERNS = {name: _pattern(form) for name, form in FORMS.items()}


def assertion(text: str, member: Callable[[str, str], float] | None = None) -> Assertion:
    """Return the assertion in `text`. Raises DiagramError for another form, an empty band and times out of order.

    `member` returns the number of a named value, such as the member of an enumeration, from the signal and the name.
    """
    plain = " ".join(text.split()) if isinstance(text, str) else ""
    for form, pattern in _PATTERNS.items():
        found = pattern.fullmatch(plain)
        if found is not None:
            words = {name: word for name, word in found.groupdict().items() if word is not None}
            return _made(form, plain, words.pop("signal"), words, member)
    raise _refused(text)


def _refused(text: str) -> DiagramError:
    remedy = f"write SIGNAL and one of: {'; '.join(FORMS)}; the first four may end with between T1 and T2"
    return DiagramError("this is not an assertion", shown(text), remedy)


def _made(
    form: str, text: str, signal: str, words: Mapping[str, str], member: Callable[[str, str], float] | None
) -> Assertion:
    n: dict[str, float] = {}
    for name, word in words.items():
        if word in ("true", "false"):
            n[name] = float(word == "true")
        elif re.fullmatch(_NUMBER, word, re.ASCII):
            n[name] = float(word)
        elif member is not None:
            n[name] = member(signal, word)
        else:
            raise _refused(text)
    times = [n[name] for name in ("t1", "t2", "t3", "t4") if name in n]
    if not all(map(math.isfinite, n.values())):
        raise DiagramError("a number is too large", text, "write one that a float64 holds")
    if times != sorted(times) or min(times, default=0.0) < 0.0:
        raise DiagramError("these times are not in order, from 0 on", text, "write seconds, the earlier one first")
    if form.startswith(("rises", "falls")):
        return Reaches(text, signal, n["v"], n["t1"], form.startswith("rises"))
    value, band = n.get("v", 0.0), n.get("b", 0.0)
    low, high = {
        "never above V": (-math.inf, value),
        "never below V": (value, math.inf),
        "always equals V": (value, value),
        "always within [A, B]": (n.get("a", 0.0), band),
    }.get(form, (value - band, value + band))
    if low > high:
        raise DiagramError("no value is within these limits", text, "exchange them; a band is not negative")
    start, stop = n.get("t1", n.get("t3")), n.get("t2", n.get("t4"))
    return Stays(text, signal, low, high, start, stop, form.startswith("final"), form.startswith("settles"))
