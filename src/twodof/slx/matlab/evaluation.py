"""A subset of MATLAB that computes constants: matrices, structures, indexing, arithmetic, logic, common functions.

`evaluate(text, workspace)` gives the value of an expression. Nothing opens a file, calls a program or shows anything,
and each evaluation ends within bounds: `MOST_STEPS` operations, arrays of at most `MOST_ELEMENTS`.

Values are numpy arrays of two dimensions (float64, float32, whole numbers, bool), `str` for text, `dict` for a
structure and `list` for a cell array.
"""

import math
import re
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twodof.errors import DiagramError
from twodof.flightlog import fence
from twodof.slx.matlab.signals import OPERATORS as SIGNAL_OPERATORS
from twodof.slx.matlab.signals import SIGNAL_FUNCTIONS, of_signals
from twodof.slx.matlab.values import (
    FUNCTIONS,
    MOST_ELEMENTS,
    OPERATORS,
    Array,
    NotComputed,
    Value,
    as_array,
    bounded,
    indexed,
    is_signal,
    joined,
    lowered,
    number,
    numeric,
    scalar,
    stored,
)

MOST_STEPS = 50_000
PRODUCTS_A_STEP = 50_000
"""Rows by columns by the fewer of both that a matrix may have to count as one operation: inv(m) takes about as many."""
MOST_ON_SIGNALS = 200_000
"""Most operations on elements of signals: each becomes one of the program."""
DEEPEST = 30  # each takes fifteen calls of Python, of a thousand

_TOKEN = re.compile(
    r"""(?P<space>(?:[ \t]|\.\.\.[^\n]*\n)+)|(?P<comment>[%\#][^\n]*)
      |(?P<whole>0[xX][0-9a-fA-F]{1,16})|(?P<number>(?:\d+(?:\.(?![*/\\^'])\d*)?|\.\d+)(?:[eEdD][+-]?\d+)?)
      |(?P<name>[A-Za-z]\w*)|(?P<operator>\.\^|\.\*|\./|\.\\|\.'|==|~=|!=|<=|>=|&&|\|\||[-+*/\\^'<>=&|~!:;,()\[\]{}.@])
      |(?P<text>"(?:[^"\n]|"")*")|(?P<line>\r?\n)""",
    re.VERBOSE,
)
_QUOTED = re.compile(r"'((?:[^'\n]|'')*)'")
BLOCK_COMMENT = re.compile(r"^[ \t]*%\{[ \t]*$.*?^[ \t]*%\}[ \t]*$", re.MULTILINE | re.DOTALL)
_BINARY = (("||",), ("&&",), ("|",), ("&",), ("<", "<=", ">", ">=", "==", "~=", "!="), (":",), ("+", "-"))
_PRODUCTS = ("*", "/", "\\", ".*", "./", ".\\")
_KEYWORDS = {"if", "elseif", "else", "for", "parfor", "while", "switch", "case", "try", "catch", "function", "end"}
SILENT = {"clear", "clc", "close", "format", "warning", "clearvars", "disp", "fprintf", "tic", "toc", "figure", "hold"}
"""Statements that change no value: skipped without a word."""


@dataclass(frozen=True)
class Token:
    """A word, number, text, operator or line end of a script."""

    kind: str
    text: str
    line: int
    spaced: bool
    """Whether white space stands before it."""


def evaluate(text: str, workspace: Mapping[str, Value], where: str = "expression") -> Value:
    """Return the value of an expression. Raises DiagramError, with the name that is missing or what is not computed."""
    try:
        parser = EvaluatingParser(tokens_of(text), Evaluation(dict(workspace)))
        value = parser.expression()
        parser.skip(";", "line")
        if parser.here.kind != "end":
            raise NotComputed(f"'{parser.here.text}' is not expected")
    except NotComputed as reason:
        raise DiagramError(f"{text.strip()[:80]}: {reason}", where, "give a constant or a --workspace file") from None
    return value


def script_text(data: bytes, where: str) -> fence.Answer:
    """Return the text of a script, behind the fence."""
    try:
        return data.decode("utf-8-sig"), []
    except UnicodeDecodeError:
        return data.decode("latin-1"), []


def tokens_of(text: str) -> list[Token]:
    """Return the tokens of a script. Raises NotComputed for a character that none begins with."""
    found: list[Token] = []
    at, line, spaced = 0, 1, False
    while at < len(text):
        before = found[-1] if found else None
        operand = before is not None and (
            before.kind in ("name", "number", "text") or before.text in (")", "]", "}", "'", ".'")
        )
        quoted = _QUOTED.match(text, at)
        if quoted is not None and not (operand and not spaced):
            found.append(Token("text", quoted[1].replace("''", "'"), line, spaced))
            at, spaced = quoted.end(), False
            continue
        match = _TOKEN.match(text, at)
        if match is None:
            raise NotComputed(f"line {line}: the character {text[at]!r} is not read")
        kind, said = match.lastgroup or "", match[0]
        at = match.end()
        if kind in ("space", "comment"):
            spaced = spaced or kind == "space"
            line += said.count("\n")
            continue
        if kind == "text":
            said = said[1:-1].replace('""', '"')
        found.append(Token(kind, said, line, spaced))
        line += kind == "line"
        spaced = False
    return [*found, Token("end", "the end", line, False)]


def next_statement(tokens: list[Token], at: int) -> int:
    """Return the place after the statement at `at`: an `if` or a loop with all that belongs to it."""
    depth = blocks = 0
    while tokens[at].kind != "end":
        token = tokens[at]
        depth += (token.text in "([{" and token.kind == "operator") - (token.text in ")]}" and token.kind == "operator")
        if token.kind == "name" and depth == 0:
            blocks += token.text in ("if", "for", "while", "switch", "try", "function", "parfor")
            blocks -= token.text == "end"
        if blocks <= 0 and (
            token.kind == "line" or (depth <= 0 and token.text in (";", ",") and token.kind == "operator")
        ):
            return at + 1
        at += 1
    return at


def assigned_by(tokens: list[Token]) -> set[str]:
    """Return the names that statements give a value: those left of each `=`, in `[a, b] = ...` several."""
    names: set[str] = set()
    start = depth = 0
    for at, token in enumerate(tokens):
        operator = token.text if token.kind == "operator" else ""
        depth += (operator in ("(", "[", "{")) - (operator in (")", "]", "}"))
        if depth == 0 and (token.kind == "line" or operator in (";", ",") or token.text in _KEYWORDS):
            start = at + 1
        elif depth == 0 and operator == "=":
            target = tokens[start:at]
            several = bool(target) and target[0].text == "["
            before = [None, *target][: len(target)]
            found = [
                t.text for t, b in zip(target, before, strict=True) if t.kind == "name" and (not b or b.text != ".")
            ]
            names.update(found if several else found[:1])
    return names


def names_in(text: str) -> list[str]:
    """Return the names in an expression, of `p.gains.Kp` the first; none where it cannot be read."""
    try:
        tokens = tokens_of(text)
    except NotComputed:
        return []
    pairs = zip(tokens, [None, *tokens], strict=False)
    return [t.text for t, before in pairs if t.kind == "name" and (before is None or before.text != ".")]


def assigned_names(code: str) -> set[str]:
    """Return the names that a script gives a value; none where it cannot be read."""
    try:
        return assigned_by(tokens_of(code))
    except NotComputed:
        return set()


@dataclass
class Evaluation:
    """The names that a run changes, and the operations that it has taken."""

    names: MutableMapping[str, Value]
    steps: int = 0
    on_signals: int = 0
    ends: list[tuple[Array, int, int]] = field(default_factory=list)
    """What `end` stands for: the array that is indexed, which index, and of how many."""

    def apart(self, names: Mapping[str, Value], run: Callable[["Evaluation"], Value]) -> tuple[Value, dict[str, Value]]:
        """Carry out `run` on names of its own; return its value, and the names after it.

        The values that functions keep between their calls, and the counts, are shared.
        """
        kept = {name: value for name, value in self.names.items() if "." in name}
        inner = Evaluation({**kept, **names}, self.steps, self.on_signals)
        value = run(inner)
        self.steps, self.on_signals = inner.steps, inner.on_signals
        self.names.update({name: value for name, value in inner.names.items() if "." in name})
        return value, dict(inner.names)

    def count(self, *values: Value, steps: int = 1) -> None:
        """Count an operation on these values, one on a large matrix as many. Raises NotComputed for one too many."""
        arrays = [one for one in values if isinstance(one, np.ndarray)]
        self.steps += steps + sum(one.size * min(one.shape) for one in arrays) // PRODUCTS_A_STEP
        if self.steps > MOST_STEPS:
            raise NotComputed(f"takes more than {MOST_STEPS} operations")

    def count_signals(self, operations: float) -> None:
        """Count operations on elements of signals before they are made. Raises NotComputed for too many."""
        self.on_signals += int(min(operations, MOST_ON_SIGNALS + 1))
        if self.on_signals > MOST_ON_SIGNALS:
            raise NotComputed(f"takes more than {MOST_ON_SIGNALS} operations on elements of signals")


def _operations(name: str, values: Sequence[Value]) -> float:
    """Return how many operations on elements an operator or a function of these values takes, about."""
    arrays = [one for one in values if isinstance(one, np.ndarray)]
    sizes = [float(one.size) for one in arrays]
    if len(sizes) < 2 or (min(sizes) == 1.0 and name != "^"):
        return sum(sizes)
    a, b = arrays[:2]
    if name == "^":
        power = 1.0 if is_signal(b) else abs(float(b.flat[0]))
        return float(a.shape[0]) ** 3 * power if a.size > 1 else power
    return sizes[0] * b.shape[1] if name == "*" else sum(sizes)


class EvaluatingParser:
    """A parser that computes as it reads: precedence as MATLAB has it."""

    def __init__(self, tokens: list[Token], evaluation: Evaluation) -> None:
        self.tokens, self.evaluation = tokens, evaluation
        self.at = self.depth = 0
        self.matrix = False

    @property
    def here(self) -> Token:
        """The next token."""
        return self.tokens[self.at]

    def skip(self, *texts: str) -> bool:
        """Pass one of these operators, or a line's end; return whether one stood here."""
        token = self.here
        if (token.kind == "operator" and token.text in texts) or (token.kind == "line" and "line" in texts):
            self.at += 1
            return True
        return False

    def need(self, text: str) -> None:
        """Pass an operator. Raises NotComputed where another token stands."""
        if not self.skip(text):
            raise NotComputed(f"'{text}' is missing before '{self.here.text}'")

    def statement(self) -> None:
        """Carry out an assignment, or an expression without effect."""
        self.evaluation.count()
        token = self.here
        if token.kind == "name" and token.text in SILENT:
            start, self.at = self.at, next_statement(self.tokens, self.at) - 1
            for named in self.tokens[start + 1 : self.at + 1] if token.text.startswith("clear") else ():
                self.evaluation.names.pop(named.text, None)
            return
        if token.kind == "name" and token.text in ("if", "for", "while", "switch", "function", "try", "global"):
            raise NotComputed(f"'{token.text}' is not computed")
        start = self.at
        path = self.target()
        if path is None or self.here.text != "=" or self.here.kind != "operator":
            self.at = start
            value = self.expression()
            self.evaluation.names["ans"] = value
            return
        self.at += 1
        value = self.expression()
        name, steps = path
        self.evaluation.names[name] = stored(self.evaluation.names.get(name), steps, value)

    def target(self) -> tuple[str, list[Any]] | None:
        """Return name and steps of what is assigned, `s.a(2)`; None for anything else."""
        if self.here.kind != "name":
            return None
        name, steps = self.here.text, list[Any]()
        self.at += 1
        value: Value = self.evaluation.names.get(name)
        while True:
            if self.here.text == "." and self.tokens[self.at + 1].kind == "name":
                steps.append(self.tokens[self.at + 1].text)
                value = value.get(steps[-1]) if isinstance(value, dict) else None
                self.at += 2
            elif self.here.text == "(" and not self.here.spaced:
                try:
                    steps.append(tuple(self.arguments(value if isinstance(value, np.ndarray) else np.zeros((0, 0)))))
                except NotComputed:
                    return None
                value = None
            else:
                return name, steps

    def expression(self) -> Value:
        """Compute an expression."""
        self.depth += 1
        if self.depth > DEEPEST:
            raise NotComputed("is nested too deep")
        value = self.binary(0)
        self.depth -= 1
        return value

    def separated(self) -> bool:
        """Return True if the sign here begins the next element of a matrix, as in `[1 -2]`."""
        following = self.tokens[self.at + 1]
        return self.matrix and self.here.spaced and not following.spaced and self.here.text in ("+", "-")

    def binary(self, level: int) -> Value:
        """Compute operations of this level of precedence, and of those above it."""
        if level == len(_BINARY):
            return self.product()
        if _BINARY[level] == (":",):
            return self.range(level)
        left = self.binary(level + 1)
        while self.here.kind == "operator" and self.here.text in _BINARY[level] and not self.separated():
            operator = self.here.text
            self.at += 1
            short = operator in ("&&", "||") and not (self.matrix or is_signal(left))
            if short and bool(as_array(left).all()) == (operator == "||"):
                self.pass_over("&&", "||")  # not computed where the first condition decides
                left = np.array([[operator == "||"]])
            else:
                left = self.apply(operator, left, self.right_of(operator, left, level + 1))
        return left

    def right_of(self, operator: str, left: Value, level: int) -> Value:
        """Compute the value to the right of an operator."""
        return self.binary(level)

    def pass_over(self, *operators: str) -> None:
        """Pass over an expression up to one of these operators, or to its end."""
        depth = 0
        while self.here.kind != "end":
            text = self.here.text if self.here.kind == "operator" else ""
            ends = self.here.kind == "line" or text in (",", ";", ")", "]", "}", *operators)
            if depth == 0 and ends:
                return
            depth += int(text in ("(", "[", "{")) - int(text in (")", "]", "}"))
            self.at += 1

    def range(self, level: int) -> Value:
        """Compute `first:last` or `first:step:last`."""
        first = self.binary(level + 1)
        if self.here.text != ":" or self.here.kind != "operator" or self.tokens[self.at + 1].text in (")", ","):
            return first
        self.at += 1
        last, step = self.binary(level + 1), np.ones((1, 1))
        if self.skip(":"):
            step, last = last, self.binary(level + 1)
        if any(map(is_signal, (first, step, last))):
            raise NotComputed("a range whose bounds are signals has no fixed size")
        if not all(as_array(number(one)).size for one in (first, step, last)):
            return np.zeros((1, 0))
        begin, increment, end = (float(as_array(number(one)).flat[0]) for one in (first, step, last))
        count = 0 if increment == 0 else math.floor((end - begin) / increment * (1 + 1e-15) + 1e-10) + 1
        if count > MOST_ELEMENTS or not math.isfinite(begin + end):
            raise NotComputed("a range has too many elements")
        return begin + increment * np.arange(max(count, 0), dtype=float)[None, :]

    def product(self) -> Value:
        """Compute products and quotients."""
        left = self.unary()
        while self.here.kind == "operator" and self.here.text in _PRODUCTS:
            operator = self.here.text
            self.at += 1
            left = self.apply(operator, left, self.unary())
        return left

    def unary(self) -> Value:
        """Compute signs and `not`."""
        signs: list[str] = []
        while self.here.kind == "operator" and self.here.text in ("+", "-", "~", "!"):
            signs.append(self.here.text)
            self.at += 1
        value = self.power()
        for sign in reversed(signs):
            value = as_array(value) if sign == "+" else self.signed(sign, as_array(value))
        return value

    @staticmethod
    def signed(sign: str, array: Array) -> Array:
        """Return -array, or where it is not true."""
        if is_signal(array):
            return SIGNAL_OPERATORS["negative" if sign == "-" else "~"](array)
        if sign == "-":
            return OPERATORS["-"](np.zeros((1, 1)), array) if array.dtype.kind in "iu" else -numeric(array)
        return ~array.astype(bool)

    def power(self) -> Value:
        """Compute powers and transposes."""
        value = self.postfix()
        while self.here.kind == "operator" and self.here.text in ("^", ".^", "'", ".'"):
            operator = self.here.text
            if operator in ("'", ".'"):
                if self.here.spaced and self.matrix:
                    break
                self.at += 1
                value = value if isinstance(value, list) else as_array(value).T
                continue
            self.at += 1
            signs = 0
            while self.here.text in ("+", "-") and self.here.kind == "operator":
                signs += self.here.text == "-"
                self.at += 1
            exponent = self.postfix()
            value = self.apply(operator, value, self.signed("-", as_array(exponent)) if signs % 2 else exponent)
        return value

    def postfix(self) -> Value:
        """Compute a value with its indices and fields."""
        token = self.here
        self.evaluation.count()
        if (
            token.kind == "name"
            and token.text not in self.evaluation.names
            and not (token.text == "end" and self.evaluation.ends)
        ):
            return self.function()
        value = self.primary()
        while True:
            here = self.here
            if here.text == "(" and here.kind == "operator" and not (self.matrix and here.spaced):
                given = self.arguments(value)
                value = value(self, given) if callable(value) else indexed(value, given)
            elif here.text == "{" and here.kind == "operator" and not (self.matrix and here.spaced):
                self.at += 1
                index = int(scalar(self.expression()))
                self.need("}")
                if not isinstance(value, list) or not 1 <= index <= len(value):
                    raise NotComputed(f"no cell {index}")
                value = value[index - 1]
            elif here.text == "." and here.kind == "operator" and self.tokens[self.at + 1].kind == "name":
                name = self.tokens[self.at + 1].text
                self.at += 2
                if isinstance(value, dict) and name not in value:
                    value = number(value)  # a field of what a parameter holds
                if not isinstance(value, dict) or name not in value:
                    raise NotComputed(f"there is no field {name}")
                value = value[name]
            else:
                return value

    def primary(self) -> Value:
        """Compute a literal, a name, a bracket or a matrix."""
        token = self.here
        self.at += 1
        if token.kind == "number":
            return np.array([[float(token.text.lower().replace("d", "e"))]])
        if token.kind == "whole":  # of the smallest type that has as many digits
            bits = next(bits for bits in (8, 16, 32, 64) if 4 * (len(token.text) - 2) <= bits)
            return np.array([[int(token.text, 16)]], dtype=f"uint{bits}")
        if token.kind == "text":
            return token.text
        if token.kind == "name":
            if token.text == "end" and self.evaluation.ends:
                array, index, count = self.evaluation.ends[-1]
                size = array.size if count == 1 else array.shape[index] if index < 2 else 1
                return np.array([[float(size)]])
            return self.evaluation.names[token.text]
        if token.text == "(":
            matrix, self.matrix = self.matrix, False
            value = self.expression()
            self.need(")")
            self.matrix = matrix
            return value
        if token.text in ("[", "{"):
            return self.rows(token.text)
        raise NotComputed(f"'{token.text}' is not computed" if token.kind != "end" else "ends too early")

    def rows(self, bracket: str) -> Value:
        """Compute a matrix, or a cell array."""
        close = "]" if bracket == "[" else "}"
        matrix, self.matrix = self.matrix, True
        rows: list[list[Value]] = [[]]
        while not self.skip(close):
            if self.here.kind == "end":
                raise NotComputed(f"'{close}' is missing")
            if self.skip(";", "line"):
                rows.append([])
            elif not self.skip(","):
                rows[-1].append(self.expression())
        self.matrix = matrix
        if bracket == "{":
            return [value for row in rows for value in row]
        sizes = [one.size for row in rows for one in row if isinstance(one, np.ndarray)]
        if any(map(is_signal, (one for row in rows for one in row))):
            self.evaluation.count_signals(sum(sizes))
        if sum(sizes) > MOST_ELEMENTS:
            raise NotComputed(f"an array has more than {MOST_ELEMENTS} elements")
        return joined([row for row in rows if row])

    def arguments(self, indexed: Value = None) -> list[Value]:
        """Return the arguments in brackets; ":" alone for a colon."""
        self.need("(")
        matrix, self.matrix = self.matrix, False
        count = self._count_arguments()
        found: list[Value] = []
        while not self.skip(")"):
            if isinstance(indexed, np.ndarray | str):
                self.evaluation.ends.append((as_array(indexed), len(found), count))
            if self.here.text == ":" and self.tokens[self.at + 1].text in (",", ")"):
                self.at += 1
                found.append(":")
            else:
                found.append(self.expression())
            if isinstance(indexed, np.ndarray | str):
                self.evaluation.ends.pop()
            if self.here.text != ")":
                self.need(",")
        self.matrix = matrix
        return found

    def _count_arguments(self) -> int:
        depth, count, at = 0, 1, self.at
        while depth >= 0 and self.tokens[at].kind != "end":
            text = self.tokens[at].text if self.tokens[at].kind == "operator" else ""
            depth += (text in ("(", "[", "{")) - (text in (")", "]", "}"))
            count += depth == 0 and text == ","
            at += 1
        return count

    def function(self) -> Value:
        """Call a function, or return a constant."""
        name = self.here.text
        self.at += 1
        while self.here.text == "." and not self.here.spaced and self.tokens[self.at + 1].kind == "name":
            name += f".{self.tokens[self.at + 1].text}"
            self.at += 2
        bracket = self.here.text == "(" and self.here.kind == "operator" and not (self.matrix and self.here.spaced)
        return self.called(name, self.arguments() if bracket else [], bracket)

    def called(self, name: str, arguments: list[Value], bracket: bool, count: int = 1) -> Value:
        """Return what a function gives: for a `count` above 1 a list."""
        self.evaluation.count(*arguments, steps=0)
        signals = count > 1 or any(map(is_signal, arguments)) or name not in FUNCTIONS
        if signals:
            self.evaluation.count_signals(_operations("*" if name == "mtimes" else name, arguments))
        if name not in (*FUNCTIONS, *SIGNAL_FUNCTIONS):
            raise NotComputed(f"{name} is not computed" if bracket else f"{name} has no value")
        try:
            with np.errstate(all="ignore"):
                value = lowered(of_signals(name, arguments, count)) if signals else FUNCTIONS[name](*arguments)
        except (TypeError, ValueError, IndexError, np.linalg.LinAlgError, OverflowError, MemoryError) as reason:
            raise NotComputed(f"{name}: {reason}") from None
        return bounded(value)

    def apply(self, operator: str, left: Value, right: Value) -> Value:
        """Compute an operation of two values."""
        left, right = number(left), number(right)
        self.evaluation.count(left, right)
        if isinstance(left, dict | list) or isinstance(right, dict | list):
            raise NotComputed(f"'{operator}' of a structure or a cell")
        a, b = as_array(left), as_array(right)
        if is_signal(a) or is_signal(b):
            self.evaluation.count_signals(_operations(operator, (a, b)))
        try:
            with np.errstate(all="ignore"):
                return bounded((SIGNAL_OPERATORS if is_signal(a) or is_signal(b) else OPERATORS)[operator](a, b))
        except (ValueError, TypeError, np.linalg.LinAlgError) as reason:
            raise NotComputed(f"'{operator}': {reason}") from None
