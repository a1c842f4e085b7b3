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
from typing import Any

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
    """Result of one assertion, which `text` describes.

    `tick`, `time` [s] and `value` are those of the first violation. The value is beyond `limit` by `by` (NaN for a
    NaN). All five are None for an assertion that holds.
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
    """Return the judgement of a failed assertion: its `values` are beyond `limits` at `ticks`, (n,) each."""
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


@dataclass(frozen=True)
class Assertion:
    """Claim about a signal: its values are within `low` and `high` from `start` to `stop` [s], by default always.

    `verb` is the first word of the claim. A signal that "rises" or "falls" begins outside of the limits and is within
    them at a tick before `stop`. The "final" value is the last one alone.
    """

    text: str
    signal: str
    verb: str
    low: float
    high: float
    start: float | None = None
    stop: float | None = None

    def judge(self, values: NDArray[np.float64], dt: float) -> Judgement:
        """Judge the signal's `values`, one for each tick of `dt` [s] from 0.

        Raises DiagramError if the claim's times contain no tick or are after the last one.
        """
        final = len(values) - 1
        reaches = self.verb in ("rises", "falls")
        first = final if self.verb == "final" else 0 if self.start is None else first_tick(self.start, dt)
        last = final
        if self.stop is not None:
            last = first_tick(self.stop, dt) - 1 if reaches else last_tick(self.stop, dt)
        if not first <= last <= final:
            what = "no tick is within these times" if last <= final else "it needs later times"
            remedy = "change the times, or give a longer duration"
            raise DiagramError(f"{what}: the scenario ends at {final * dt:g} s", self.text, remedy)
        within = (values >= self.low) & (values <= self.high)
        if reaches:
            return self._reached(values[: last + 1], within, dt)
        part = values[first : last + 1]
        wrong = np.flatnonzero(~within[first : last + 1])
        if len(wrong):
            low = self.low if math.isfinite(self.low) else self.high
            limits = np.where(part[wrong] > self.high, self.high, low)
            return first_violation(self.text, self.signal, part[wrong], limits, wrong + first, dt)
        if self.verb == "settles":
            since = np.flatnonzero(np.append(True, ~within))[-1]
            return self._holds(f"settled at {since * dt:.6g} s")
        if self.verb == "final":
            return self._holds(f"{part[-1]:.6g}")
        with np.errstate(invalid="ignore", over="ignore"):  # infinity may be within infinite limits
            nearest = int(np.argmin(np.fmin(part - self.low, self.high - part)))
        return self._holds(f"nearest to a limit: {part[nearest]:.6g} at {(first + nearest) * dt:.6g} s")

    def _reached(self, part: NDArray[np.float64], within: NDArray[np.bool_], dt: float) -> Judgement:
        rises = self.verb == "rises"
        aim = self.low if rises else self.high
        last = len(part) - 1
        there = np.flatnonzero(within[: last + 1])
        if len(there) and there[0] == 0:
            last, found = 0, float(part[0])
            text = f"it begins at {found:.6g}, so it does not {'rise' if rises else 'fall'} to {aim:.6g}"
        elif len(there) and not np.isnan(part[0]):
            return self._holds(f"at {there[0] * dt:.6g} s")
        else:
            found = float(np.fmax.reduce(part) if rises else np.fmin.reduce(part))
            text = f"it comes to {found:.6g}, {abs(aim - found):.3g} short of {aim:.6g}"
        return Judgement(self.text, self.signal, False, text, last, last * dt, found, aim, abs(aim - found))

    def _holds(self, text: str) -> Judgement:
        return Judgement(self.text, self.signal, True, text)


_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_TIMES = "(?: between <start> and <stop>| from <from>| until <until>)?"
FORMS: Mapping[str, str] = {
    "never above V": f"never above <high>{_TIMES}",
    "never below V": f"never below <low>{_TIMES}",
    "always within [A, B]": rf"always within \[<low>, <high>\]{_TIMES}",
    "always equals V": f"always equals <value>{_TIMES}",
    "settles within B of V by T": "settles within <band> of <value> by <start>",
    "rises to V before T": "rises to <low> before <stop>",
    "falls to V before T": "falls to <high> before <stop>",
    "final value within B of V": "final value within <band> of <value>",
}
"""The forms of a claim, and their patterns; in angle brackets a time or a band, or a number or the name of a value."""


def _pattern(form: str) -> re.Pattern[str]:
    def number(found: re.Match[str]) -> str:
        if found[1] in ("start", "stop", "from", "until"):
            return f"(?P<{found[1]}>{_NUMBER})(?: ?s\\b)?"
        return f"(?P<{found[1]}>{_NUMBER})" if found[1] == "band" else rf"(?P<{found[1]}>{_NUMBER}|[A-Za-z]\w*)"

    return re.compile(rf"(?P<signal>{_SIGNAL}) {re.sub(r'<(.*?)>', number, form)}", re.ASCII)


_PATTERNS = [_pattern(form) for form in FORMS.values()]


def assertion(text: str, member: Callable[[str, str], float] | None = None) -> Assertion:
    """Return the assertion in `text`. Raises DiagramError for another form, an empty band and times out of order.

    `member` returns the number of a named value, such as the member of an enumeration, from the signal and the name.
    """
    plain = " ".join(text.split()) if isinstance(text, str) else ""
    found = next(filter(None, (pattern.fullmatch(_evenly_spaced(plain)) for pattern in _PATTERNS)), None)
    if found is None:
        remedy = f"write SIGNAL and one of: {'; '.join(FORMS)}; the first four may end with between T1 and T2"
        raise DiagramError("this is not an assertion", shown(text), remedy)
    words = {name: word for name, word in found.groupdict().items() if word is not None}
    signal = words.pop("signal")
    n = {name: _number(word, plain, signal, member) for name, word in words.items()}
    value, band = n.get("value"), n.get("band", 0.0)
    low = n.get("low", -math.inf) if value is None else value - band
    high = n.get("high", math.inf) if value is None else value + band
    start, stop = n.get("start", n.get("from")), n.get("stop", n.get("until"))
    if not 0.0 <= (start or 0.0) <= (math.inf if stop is None else stop):
        raise DiagramError("these times are not in order, from 0 on", plain, "write seconds, the earlier one first")
    if low > high:
        raise DiagramError("no value is within these limits", plain, "exchange them; a band is not negative")
    return Assertion(plain, signal, found[0].removeprefix(signal).split()[0], low, high, start, stop)


def _evenly_spaced(text: str) -> str:
    """Return `text` with one blank after each comma, and none inside brackets or before an index."""
    tight = re.sub(r" ?([,\[\]]) ?", r"\1", text).replace(",", ", ")
    return re.sub(r"\](?=[a-z])", "] ", tight.replace("within[", "within ["))


def _number(word: str, text: str, signal: str, member: Callable[[str, str], float] | None) -> float:
    if word in ("true", "false"):
        return float(word == "true")
    if word[0].isalpha():
        if member is None:
            raise DiagramError("this is not an assertion", text, f"write a number for {word}")
        return member(signal, word)
    if not math.isfinite(float(word)):
        raise DiagramError("a number is too large", text, "write one that a float64 holds")
    return float(word)
