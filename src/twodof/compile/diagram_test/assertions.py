"""Assertions over time about one signal, as text and as what the text means.

    SIGNAL never above V [WHEN]             SIGNAL settles within B of V by T
    SIGNAL never below V [WHEN]             SIGNAL rises to V before T
    SIGNAL always within [A, B] [WHEN]      SIGNAL falls to V before T
    SIGNAL always equals V [WHEN]           SIGNAL final value within B of V

WHEN is `between T1 and T2`, `from T` or `until T` (ends included), and otherwise the whole scenario. Times are seconds.
A limit itself is allowed; NaN never is.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twodof.compile.diagram_test.judgement import Judgement, first_violation
from twodof.compile.diagram_test.signal_element import PATTERN
from twodof.compile.diagram_test.tick_times import first_tick, last_tick
from twodof.errors import DiagramError, shown


class Assertion(Protocol):
    """What is claimed of a signal: `text` as the user wrote it, `signal` by name or path, perhaps with `[index]`."""

    @property
    def text(self) -> str:
        """As the user wrote it, and `assertion` reads it."""

    @property
    def signal(self) -> str:
        """The signal that it is about."""

    def judge(self, values: NDArray[np.float64], dt: float) -> Judgement:
        """Whether it holds for the signal's `values`, one for each tick of `dt` [s] from 0."""


@dataclass(frozen=True)
class Stays:
    """low <= signal <= high at each tick from `start` to `stop` [s]; by default all, with `last` the last one only."""

    text: str
    signal: str
    low: float
    high: float
    start: float | None = None
    stop: float | None = None
    last: bool = False
    settles: bool = False  # whether it is worth saying when it came into the band

    def judge(self, values: NDArray[np.float64], dt: float) -> Judgement:
        """Whether it holds. Raises DiagramError if no tick of the scenario is meant, or a time is after its end."""
        end = len(values) - 1
        first = 0 if self.start is None else first_tick(self.start, dt)
        final = end if self.stop is None else last_tick(self.stop, dt)
        first = end if self.last else first
        if first > final or final > end:
            what = f"no tick lies there: the scenario ends at {end * dt:g} s"
            if self.stop is not None and first <= end < final:
                what = f"the scenario ends before, at {end * dt:g} s"
            raise DiagramError(what, self.text, "change the times, or let the scenario last longer")
        part = values[first : final + 1]
        fine = (part >= self.low) & (part <= self.high)
        if not fine.all():
            wrong = np.flatnonzero(~fine)
            passed = part[wrong]
            limits = np.where(passed > self.high, self.high, self.low if math.isfinite(self.low) else self.high)
            return first_violation(self.text, self.signal, passed, limits, wrong + first, dt)
        if self.settles:
            outside = np.flatnonzero(~((values >= self.low) & (values <= self.high)))
            since = int(outside[-1]) + 1 if len(outside) else 0
            return Judgement(self.text, self.signal, True, f"settled at {since * dt:.6g} s")
        with np.errstate(invalid="ignore", over="ignore"):  # infinity may be within infinite limits
            nearest = int(np.argmin(np.fmin(part - self.low, self.high - part)))
        text = f"nearest to a limit: {part[nearest]:.6g} at {(first + nearest) * dt:.6g} s"
        return Judgement(self.text, self.signal, True, f"{part[-1]:.6g}" if self.last else text)


@dataclass(frozen=True)
class Reaches:
    """The signal begins below `value` (above it, if not `rising`) and reaches it at a tick before `before` [s]."""

    text: str
    signal: str
    value: float
    before: float
    rising: bool = True

    def judge(self, values: NDArray[np.float64], dt: float) -> Judgement:
        """Whether it holds. Raises DiagramError if the scenario ends before the time."""
        final = first_tick(self.before, dt) - 1
        if not 0 <= final < len(values):
            end = (len(values) - 1) * dt
            raise DiagramError(f"the scenario ends at {end:g} s", self.text, "change the time, or let it last longer")
        part = values[: final + 1]
        there = np.flatnonzero(part >= self.value if self.rising else part <= self.value)
        if len(there) and there[0] > 0 and not np.isnan(part[0]):
            return Judgement(self.text, self.signal, True, f"at {there[0] * dt:.6g} s")
        if len(there) and there[0] == 0:
            value, text = (
                float(part[0]),
                f"it begins at {part[0]:.6g}, so it does not {_WAY[self.rising]} to {self.value:.6g}",
            )
            return Judgement(self.text, self.signal, False, text, 0, 0.0, value, self.value, abs(value - self.value))
        best = float(np.fmax.reduce(part) if self.rising else np.fmin.reduce(part))
        by = abs(self.value - best)
        text = f"it comes to {best:.6g}, {by:.3g} short of {self.value:.6g}"
        return Judgement(self.text, self.signal, False, text, final, final * dt, best, self.value, by)


_WAY = {True: "rise", False: "fall"}

Numbers = Mapping[str, float]
"""The numbers that stand in an assertion's text, by name."""

Maker = Callable[[str, str, Numbers], Assertion]
"""Makes the assertion of a text about a signal with these numbers."""


def _within(low: Callable[[Numbers], float], high: Callable[[Numbers], float]) -> Maker:
    return lambda text, signal, n: Stays(
        text, signal, low(n), high(n), n.get("t1", n.get("since")), n.get("t2", n.get("until"))
    )


def _settles(text: str, signal: str, n: Numbers) -> Assertion:
    return Stays(text, signal, n["v"] - n["b"], n["v"] + n["b"], n["t"], settles=True)


def _final(text: str, signal: str, n: Numbers) -> Assertion:
    return Stays(text, signal, n["v"] - n["b"], n["v"] + n["b"], last=True)


def _reaches(rising: bool) -> Maker:
    return lambda text, signal, n: Reaches(text, signal, n["v"], n["t"], rising)


_MAKERS: Mapping[str, Maker] = {
    "never above V": _within(lambda n: -math.inf, lambda n: n["v"]),
    "never below V": _within(lambda n: n["v"], lambda n: math.inf),
    "always within [A, B]": _within(lambda n: n["a"], lambda n: n["b"]),
    "always equals V": _within(lambda n: n["v"], lambda n: n["v"]),
    "settles within B of V by T": _settles,
    "rises to V before T": _reaches(True),
    "falls to V before T": _reaches(False),
    "final value within B of V": _final,
}
FORMS = tuple(_MAKERS)
"""How what is claimed of a signal can read."""

_SIGNAL = rf"(?P<signal>{PATTERN})"
_MEMBER = r"[A-Za-z]\w{0,62}"
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|true|false"
_TIMES = ("t", "t1", "t2", "since", "until")
_WHEN = " between T1 and T2| from SINCE| until UNTIL"


def _pattern(form: str) -> re.Pattern[str]:
    """What reads a form: each word in capitals is a number, those of time perhaps with the unit s."""
    text = re.escape(form) if form.startswith(("settles", "rises", "falls", "final")) else _with_when(form)

    def number(found: re.Match[str]) -> str:
        name = found[0].lower()
        either = f"{_NUMBER}|{_MEMBER}" if name == "v" else _NUMBER
        return rf"(?P<{name}>{either})" + (r"(?:\ ?s\b)?" if name in _TIMES else "")

    text = re.sub(r"\b[A-Z]+\d?\b", number, text)
    return re.compile(_SIGNAL + r"\ " + text, re.ASCII)


def _with_when(form: str) -> str:
    return re.escape(form) + f"(?:{'|'.join(map(re.escape, _WHEN.split('|')))})?"


_READ = tuple((_pattern(form), make) for form, make in _MAKERS.items())
MAX_TEXT = 500


def assertion(text: str, member: Callable[[str, str], float] | None = None) -> Assertion:
    """The assertion that `text` is. Raises DiagramError for a text of another form, an empty band or an empty time.

    `member` gives the number of a value that is named, as members of an enumeration are: of the signal and the name.
    """
    remedy = f"write SIGNAL and one of: {'; '.join(FORMS)}; the first four may end with between T1 and T2"
    if not isinstance(text, str) or len(text) > MAX_TEXT:
        raise DiagramError("this is not an assertion", shown(text), remedy)
    plain = _evenly_spaced(text)
    for form, make in _READ:
        found = form.fullmatch(plain)
        named = found["v"] if found and "v" in found.groupdict() else ""
        if found and (member is not None or not _is_name(named)):
            given = {name: word for name, word in found.groupdict().items() if name != "signal" and word}
            numbers = {
                name: member(found["signal"], word) if member and _is_name(word) else _number(word)
                for name, word in given.items()
            }
            made = make(" ".join(text.split()), found["signal"], numbers)
            _check(made, numbers)
            return made
    raise DiagramError("this is not an assertion", shown(text), remedy)


def _evenly_spaced(text: str) -> str:
    """`text` with one blank between words, and none beside brackets but before the band of `within`."""
    tight = re.sub(r"\s*([,\[\]])\s*", r"\1", " ".join(text.split()))
    return re.sub(r"\](?=[a-z])", "] ", tight.replace(",", ", ").replace("within[", "within ["))


def _is_name(word: str) -> bool:
    return bool(re.fullmatch(_MEMBER, word, re.ASCII)) and word not in ("true", "false")


def _number(word: str) -> float:
    return {"true": 1.0, "false": 0.0}[word] if word.isalpha() else float(word)


def _check(made: Assertion, numbers: Numbers) -> None:
    if not all(map(math.isfinite, numbers.values())):
        raise DiagramError("a number is too large", made.text, "write one that a float64 holds")
    if isinstance(made, Stays) and made.low > made.high:
        raise DiagramError("no value is within these limits", made.text, "exchange them; a band is not negative")
    times = [numbers[name] for name in _TIMES if name in numbers]
    if times != sorted(times) or any(t < 0 for t in times):
        raise DiagramError("these times are not in order, from 0 on", made.text, "write seconds, the earlier one first")
