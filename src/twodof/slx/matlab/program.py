"""A MATLAB Function as a program: branches, loops, local functions and persistent variables, on recorded signals.

Where a condition is a signal both branches are carried out, and each name gets its value of the branch that holds.
`return`, `break` and `continue` under such a condition become a signal too: what follows them is carried out where it
does not hold. Loops have constant ranges and are written out.
"""

import copy
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from twodof.blocks.bus import Bus
from twodof.blocks.expressions.expr import where
from twodof.blocks.expressions.numbers import INTEGER_TYPES
from twodof.errors import DiagramError, LogError
from twodof.flightlog import fence
from twodof.slx.matlab.evaluation import (
    BLOCK_COMMENT,
    EvaluatingParser,
    Evaluation,
    next_statement,
    script_text,
    tokens_of,
)
from twodof.slx.matlab.rotations import ROTATIONS
from twodof.slx.matlab.signals import truth
from twodof.slx.matlab.values import (
    Array,
    NotComputed,
    Value,
    as_array,
    class_of,
    converted,
    filled,
    is_signal,
    lifted,
    stored,
)

DEEPEST_CALLS, DEEPEST_BLOCKS, MOST_TURNS = 20, 50, 40
EMPTY = np.zeros((0, 0))
_OPENING = {"if", "for", "parfor", "while", "switch", "try", "function"}
_CLAUSES = {"elseif", "else", "case", "otherwise", "catch"}
_WORDS = _OPENING | _CLAUSES | {"end"}
_LEAVING = {"return": "#return", "break": "#break", "continue": "#continue"}
"""The names that say under which condition the statements after one of these are left out."""
IN_C = "#in C"
"""A known name that says that a chart's actions are in C."""
_SILENT = {"assert", "error", "pause", "drawnow", "eml.extrinsic", "eml.inline"} | {
    f"coder.{name}" for name in ("inline", "extrinsic", "allowpcode", "varsize", "unroll", "cstructname", "cinclude")
}


class NotTranslatedLine(NotComputed):
    """A statement that is not translated, with its line."""


@dataclass(frozen=True)
class FunctionDefinition:
    """A function of a program: arguments and results by name, and the tokens of its body."""

    name: str
    arguments: list[str]
    results: list[str]
    start: int
    stop: int


class Code:
    """The text of a MATLAB Function: its tokens, where its blocks end, and its functions, the main one first.

    A `script` has its statements for a main function. Raises NotComputed for a text that cannot be read.
    """

    def __init__(self, text: str, folders: Sequence[Path] = (), script: bool = False) -> None:
        self.folders = folders
        self.files: dict[str, Code | None] = {}
        """The functions of the folders by name; None for a name without a file."""
        self.prefix = ""
        """What the names of persistent variables begin with."""
        self.tokens = tokens_of(BLOCK_COMMENT.sub(lambda m: "\n" * m[0].count("\n"), text))
        if next((token.text for token in self.tokens if token.kind != "line"), "") == "classdef":
            raise NotComputed("there is no function in it, but a class")
        self.initial: dict[str, Value] = {}
        """First values of persistent variables, as the last run found them empty."""
        self.notes: list[str] = []
        self.known: dict[str, Value] = {}
        """Names that every function sees: enumerations."""
        self.declared: dict[str, Any] = {}
        """Kinds to which names convert what they are assigned: a chart's data, and `function.name`."""
        self.shared: set[str] | None = None
        """Names of a chart's main function that its other functions see and change."""
        self.seen: dict[str, Value] = {}
        """Their values at a call."""
        words = self._words()
        count = Counter(word for _, word in words)
        # Functions of a file either all end with `end`, or none does.
        closed = count["end"] == sum(count[word] for word in _OPENING)
        self.blocks: dict[int, list[int]] = {}
        heads = [at for at, word in words if word == "function"]
        opened = list[list[int]]()
        for at, word in words:
            if word in _OPENING and (closed or word != "function"):
                opened.append([at])
                if len(opened) > DEEPEST_BLOCKS:
                    raise NotComputed(f"line {self.tokens[at].line}: blocks stand in each other too deep")
            elif word in _CLAUSES and opened:
                opened[-1].append(at)
            elif word == "end":
                if not opened and script:
                    continue
                if not opened:
                    raise NotComputed(f"line {self.tokens[at].line}: this end ends nothing")
                start, *clauses = opened.pop()
                self.blocks[start] = [*clauses, at]
        self.unclosed = bool(opened)
        """Whether a block of a script has no end."""
        if opened and not script:
            raise NotComputed(f"line {self.tokens[opened[-1][0]].line}: a block has no end")
        if not heads and not script:
            raise NotComputed("there is no function in it")
        last = len(self.tokens) - 1
        ends = [self.blocks.get(head, [last])[-1] for head in heads] if closed else [*heads[1:], last][: len(heads)]
        made = [self._function(head, end) for head, end in zip(heads, ends, strict=True)]
        self.main = FunctionDefinition("", [], [], 0, [*heads, last][0]) if script else made[0]
        self.functions = {one.name: one for one in made}

    def file(self, name: str) -> "Code | None":
        """Return the code of NAME.m in one of the folders, or of a known toolbox; None where there is none."""
        if name not in self.files:
            candidates = (one / f"{name}.m" for one in self.folders) if name.isidentifier() else ()
            path = next((one for one in candidates if one.is_file()), None)
            text = ROTATIONS.get(name)
            self.files[name] = None
            if path is not None or text is not None:
                try:
                    made = Code(str(text) if path is None else fence.read(script_text, path)[0], self.folders)
                except LogError as reason:
                    raise NotComputed(str(reason)) from None
                except NotComputed as reason:
                    raise NotComputed(f"{name}.m: {reason}") from None
                made.files, made.initial, made.notes, made.known = self.files, self.initial, self.notes, self.known
                made.prefix = f"{name}/"
                self.files[name] = made
        return self.files[name]

    def _words(self) -> list[tuple[int, str]]:
        """Return the keywords that open, part or close a block: neither a field nor the `end` of an index."""
        depth, found = 0, list[tuple[int, str]]()
        for at, token in enumerate(self.tokens):
            if token.kind == "operator":
                depth += (token.text in ("(", "[", "{")) - (token.text in (")", "]", "}"))
            elif token.kind == "name" and depth == 0 and token.text in _WORDS and self.tokens[at - 1].text != ".":
                found.append((at, token.text))
        return found

    def _function(self, at: int, stop: int) -> FunctionDefinition:
        """Read `function [a, b] = name(c, d)`, of which only the name must be there."""
        names: list[list[str]] = [[]]
        at += 1
        head = at
        while self.tokens[at].kind != "end":
            token = self.tokens[at]
            if token.text in ("=", "("):
                names.append([])
            elif token.kind == "name":
                names[-1].append(token.text)
            elif token.text == "~":
                names[-1].append(f"#{at}")
            at += 1
            if token.text == ")" or token.kind == "line" or token.text == ";":
                break
        assigned = any(t.text == "=" and t.kind == "operator" for t in self.tokens[head:at])
        results = names.pop(0) if assigned else []
        (name, *_), *arguments = names if names and names[0] else [["?"]]
        return FunctionDefinition(name, arguments[0] if arguments else [], results, at, stop)


class Program(EvaluatingParser):
    """The run of one function of a program, in `names`, which it changes.

    The value of the persistent variable x of the function f is kept in the name `f.x`.
    """

    def __init__(self, code: Code, function: FunctionDefinition, evaluation: Evaluation, depth: int = 0) -> None:
        super().__init__(code.tokens, evaluation)
        self.code, self.function_run, self.calls = code, function, depth
        self.persistent: list[str] = []
        own = {*function.arguments, *function.results} if function is not code.main else set[str]()
        self.kinds = {name: kind for name, kind in code.declared.items() if "." not in name and name not in own}
        self.kinds |= {name: code.declared[one] for name in own if (one := f"{function.name}.{name}") in code.declared}
        if depth > DEEPEST_CALLS:
            raise NotComputed("functions call each other too deep")

    def run(self) -> None:
        """Carry out the function. Raises NotTranslatedLine for a statement that is not translated."""
        self.at = self.function_run.start
        self._convert()
        self.block(self.function_run.stop)
        for name in self.persistent:
            self.evaluation.names[self._kept(name)] = self.evaluation.names[name]

    def _kept(self, name: str) -> str:
        """Return the name under which a persistent variable is kept between calls."""
        return f"{self.code.prefix}{self.function_run.name}.{name}"

    def block(self, stop: int) -> None:
        """Carry out the statements up to a token."""
        while self.at < stop:
            if self.skip(";", ",", "line"):
                continue
            left = self._left()
            if left is True:
                break
            if left is not False:
                self.either(left, lambda: None, partial(self._afresh, self.at, stop))
                break
            line, empty = self.here.line, self._empty()
            try:
                self.statement()
                if self.at < stop and not self.skip(";", ",", "line"):
                    raise NotComputed(f"'{self.here.text}' is not expected")
            except NotTranslatedLine:
                raise
            except (NotComputed, DiagramError) as reason:
                why = reason.what if isinstance(reason, DiagramError) else str(reason)
                raise NotTranslatedLine(f"line {line}: {why}") from None
            self._convert()
            for name in empty - self._empty():
                self.code.initial[self._kept(name)] = self.evaluation.names[name]
        self.at = stop

    def _convert(self) -> None:
        """Convert names that have a declared kind."""
        for name, kind in self.kinds.items():
            value = self.evaluation.names.get(name, EMPTY)
            if not is_empty(value):
                self.evaluation.names[name] = _of_kind(value, kind, IN_C in self.code.known)

    def _empty(self) -> set[str]:
        """Return the persistent variables that have no value yet."""
        return {name for name in self.persistent if is_empty(self.evaluation.names[name])}

    def _left(self) -> Any:
        """Return whether the next statements are left out: a bool, or a signal."""
        found: Any = False
        for name in _LEAVING.values():
            one = truth(self.evaluation.names.get(name, EMPTY))
            if one is True:
                return True
            found = one if found is False else found if one is False else found | one
        return found

    def _afresh(self, start: int, stop: int) -> None:
        for name in _LEAVING.values():
            self.evaluation.names.pop(name, None)
        self.at = start
        self.block(stop)

    def either(self, condition: Any, one: Callable[[], None], other: Callable[[], None]) -> None:
        """Carry out both, each on names of its own, and let each name have the value that the condition chooses."""
        before, made = self.evaluation.names, []
        for branch in (one, other):
            self.evaluation.names = dict(before)
            branch()
            made.append(self.evaluation.names)
        self.evaluation.names = before
        first, second = made
        for name in dict.fromkeys((*first, *second)):
            missing = np.array([[False]]) if name.startswith("#") else None
            a, b = first.get(name, missing), second.get(name, missing)
            before[name] = a if b is None else b if a is None else chosen(condition, a, b, name)

    def statement(self) -> None:
        """Carry out a statement, or a block with all that belongs to it."""
        token = self.here
        word = token.text if token.kind == "name" else ""
        self.evaluation.count()
        if word in ("if", "switch", "for", "parfor", "while"):
            start = self.at
            if start not in self.code.blocks:
                raise NotComputed(f"this {word} has no end")
            *clauses, end = self.code.blocks[start]
            if word == "if":
                self._choose([start, *clauses], end)
            elif word == "switch":
                self.at += 1
                value = self.expression()
                self._choose(clauses, end, value)
            else:
                self._loop(end)
            self.at = end + 1
        elif word in _LEAVING:
            self.at += 1
            self.evaluation.names[_LEAVING[word]] = np.array([[True]])
        elif word == "persistent":
            self.at += 1
            while self.here.kind == "name":
                self.persistent.append(self.here.text)
                kept = self._kept(self.here.text)
                self.evaluation.names[self.here.text] = self.evaluation.names.setdefault(kept, EMPTY)
                if self.code.shared is not None and self.function_run is self.code.main:
                    self.code.shared.add(self.here.text)
                self.at += 1
                self.skip(",")
        elif word in ("global", "try", "function"):
            raise NotComputed(f"'{word}' is not translated")
        elif self._dotted() in _SILENT:
            if word == "error":
                self.code.notes.append(f"line {token.line}: error() is left out")
            self.at = next_statement(self.tokens, self.at) - 1
        elif token.text == "[" and (close := self._several()) is not None:
            self._assign_several(close)
        else:
            super().statement()

    def _dotted(self) -> str:
        one, dot, two = (*self.tokens[self.at : self.at + 3], *[self.tokens[-1]] * 3)[:3]
        return f"{one.text}.{two.text}" if dot.text == "." else one.text if one.kind == "name" else ""

    def _choose(self, clauses: Sequence[int], end: int, value: Value = None) -> None:
        """Carry out the first of these clauses whose condition holds; of `switch` the value."""
        if not clauses:
            return
        start, stop = clauses[0], (*clauses[1:], end)[0]
        self.at = start + 1
        word = self.tokens[start].text
        held: Any = True
        if word == "case":
            held = self._matches(value, self.expression())
        elif word not in ("else", "otherwise"):
            held = truth(self.expression())
        body = self.at

        def act() -> None:
            self.at = body
            self.block(stop)

        if isinstance(held, bool):
            act() if held else self._choose(clauses[1:], end, value)
        else:
            self.either(held, act, lambda: self._choose(clauses[1:], end, value))

    def _matches(self, value: Value, case: Value) -> Any:
        found: Any = False
        for one in case if isinstance(case, list) else [case]:
            if isinstance(value, str) or isinstance(one, str):
                same: Any = isinstance(value, str) and isinstance(one, str) and value == one
            else:
                same = truth(self.apply("==", value, one))
            if same is True:
                return True
            found = same if found is False else found if same is False else found | same
        return found

    def _loop(self, end: int) -> None:
        """Carry out a loop turn by turn."""
        word = self.here.text
        self.at += 1
        if word == "while":
            self._while(self.at, end)
        else:
            bracket, name = self.skip("("), self.here.text
            self.at += 1
            self.need("=")
            columns = as_array(self.expression()).T
            if bracket:
                self.need(")")
            start = self.at
            for column in columns:
                self._turn(name, column.reshape(-1, 1), start, end)
                self.evaluation.names.pop("#continue", None)
                if self._left() is True:
                    break
        self.evaluation.names.pop("#break", None)

    def _while(self, start: int, end: int, turns: int = 0) -> None:
        """Carry out the turns of a `while`; those after one that may be the last only where it is not."""
        for name in _LEAVING.values():
            self.evaluation.names.pop(name, None)
        left: Any = False
        while left is False:
            self.at = start
            held = truth(self.expression())
            if held is False:
                return
            if turns > MOST_TURNS:
                raise NotComputed(f"how often the loop turns depends on signals: more than {MOST_TURNS} times")
            turns += held is not True
            if held is not True:
                self.either(held, partial(self._turn_of_while, self.at, start, end, turns), lambda: None)
                return
            self.block(end)
            self.evaluation.names.pop("#continue", None)
            left = self._left()
        if left is not True:
            self.either(left, lambda: None, partial(self._while, start, end, turns + 1))

    def _turn_of_while(self, body: int, start: int, end: int, turns: int) -> None:
        """Carry out a turn whose condition is a signal, and those that follow it."""
        self.at = body
        self.block(end)
        self.evaluation.names.pop("#continue", None)
        left = self._left()
        if left is False:
            self._while(start, end, turns)
        elif left is not True:
            self.either(left, lambda: None, partial(self._while, start, end, turns))

    def _turn(self, name: str, value: Array, start: int, end: int) -> None:
        """Carry out one turn of a `for`, where it was not left before."""

        def act() -> None:
            self.evaluation.names[name] = value
            self._afresh(start, end)

        left = self._left()
        if left is False:
            act()
        elif left is not True:
            self.either(left, lambda: None, act)

    def _several(self) -> int | None:
        """Return the place of the `]` of `[a, b] = ...`; None for a matrix."""
        at = depth = 0
        for at in range(self.at, len(self.tokens) - 1):
            text = self.tokens[at].text if self.tokens[at].kind == "operator" else ""
            depth += (text in ("[", "(", "{")) - (text in ("]", ")", "}"))
            if depth == 0 or self.tokens[at].kind == "line":
                break
        return at if depth == 0 and self.tokens[at + 1].text == "=" else None

    def _assign_several(self, close: int) -> None:
        targets: list[tuple[str, list[Any]] | None] = []
        self.at += 1
        while self.at < close:
            if self.skip("~", "!"):
                targets.append(None)
            elif not self.skip(","):
                target = self.target()
                if target is None:
                    raise NotComputed(f"'{self.here.text}' is not expected")
                targets.append(target)
        self.at = close + 2
        name = self.here.text
        self.at += 1
        found = self.called(name, self.arguments() if self.here.text == "(" else [], True, len(targets))
        if name == "size" and len(targets) == 2:
            found = [found[:, [0]], found[:, [1]]]
        if not isinstance(found, list) or len(found) < len(targets):
            raise NotComputed(f"{name} gives fewer than {len(targets)} values")
        for target, value in zip(targets, found, strict=False):
            if target is not None:
                key, steps = target
                self.evaluation.names[key] = stored(self.evaluation.names.get(key), steps, value)

    def right_of(self, operator: str, left: Value, level: int) -> Value:
        """Compute the right of an operator; what it changes holds only where && or || come to it."""
        if operator not in ("&&", "||") or not is_signal(left):
            return super().right_of(operator, left, level)
        found: list[Value] = []

        def compute() -> None:
            found.append(self.binary(level))

        branches = (compute, lambda: None) if operator == "&&" else (lambda: None, compute)
        self.either(truth(left), *branches)
        return found[0]

    def primary(self) -> Value:
        """Return a value; a persistent variable has one after its first assignment."""
        if self.skip("@"):
            return self._handle()
        name = self.here.text if self.here.kind == "name" else ""
        value = super().primary()
        if name in self.persistent and is_empty(value):
            raise NotComputed(f"{name} is read before it has a value")
        return value

    def _handle(self) -> Callable[..., Value]:
        """Return the function of `@name`, or of `@(a, b) expression` with the names as they are now."""
        names = {one: value for one, value in self.evaluation.names.items() if one.isidentifier()}
        start, arguments = self.at, list[str]()
        if self.skip("("):
            while not self.skip(")"):
                arguments.append(self.here.text)
                self.at += 1
                self.skip(",")
            start = self.at
            self.pass_over()
        else:
            self.at += 1

        def called(caller: "Program", given: list[Value], count: int = 1) -> Value:
            inner = copy.copy(self)
            inner.at, inner.depth, inner.calls, inner.evaluation = start, 0, caller.calls + 1, caller.evaluation
            if inner.calls > DEEPEST_CALLS:
                raise NotComputed("functions call each other too deep")
            if self.tokens[start - 1].text == "@":
                return inner.called(self.tokens[start].text, given, True, count)
            if len(given) > len(arguments) or count > 1:
                raise NotComputed(f"the function takes {len(arguments)} arguments and gives one value")

            def run(evaluation: Evaluation) -> Value:
                inner.evaluation, inner.matrix = evaluation, False
                return inner.expression()

            return caller.evaluation.apart({**names, **dict(zip(arguments, given, strict=False))}, run)[0]

        return called

    def function(self) -> Value:
        """Call a function; `isempty` looks at a persistent variable without reading it."""
        texts = [one.text for one in self.tokens[self.at : self.at + 4]]
        if texts[:2] == ["isempty", "("] and texts[3:] == [")"] and texts[2] in self.persistent:
            self.at += 4
            return np.array([[texts[2] in self._empty()]])
        return super().function()

    def called(self, name: str, arguments: list[Value], bracket: bool, count: int = 1) -> Value:
        """Call a function of the program, or one of MATLAB's."""
        if name == "exist" and arguments:
            return np.array([[float(arguments[0] in self.evaluation.names)]])
        name, arguments = (arguments[0], arguments[1:]) if name == "feval" and arguments else (name, arguments)
        held = self.evaluation.names.get(name) if isinstance(name, str) else name
        if callable(held):
            return held(self, arguments, count)
        if name == "single" or "single" in [one for one in arguments if isinstance(one, str)]:
            self.code.notes.append("single: computed in the precision of the build")
        code, function = self.code, self.code.functions.get(name)
        if function is None and (found_file := self.code.file(name)) is not None:
            code, function = found_file, found_file.main
        if function is None:
            if name == "size" and count == 2:
                count = 1
            return super().called(name, arguments, bracket, count)
        if len(arguments) > len(function.arguments):
            raise NotComputed(f"{name} takes {len(function.arguments)} arguments")
        shared = (code.shared or set()) - {*function.arguments, *function.results}
        code.seen = {one: value for one, value in self.evaluation.names.items() if one in (code.shared or ())}
        try:
            found = call(code, function, arguments, self.evaluation, self.calls + 1)
        except NotTranslatedLine as reason:
            raise reason if code is self.code else NotComputed(f"{name}.m, {reason}") from None
        self.evaluation.names.update({one: found[one] for one in shared & found.keys()})
        if count > 1:
            return [found.get(one) for one in function.results]
        return found.get(function.results[0]) if function.results else None


def call(
    code: Code, function: FunctionDefinition, arguments: Sequence[Value], evaluation: Evaluation, depth: int = 0
) -> Mapping[str, Value]:
    """Carry out a function on arguments and return its names. The evaluation keeps persistent variables."""
    given = {**code.known, **code.seen, **dict(zip(function.arguments, arguments, strict=False))}
    given["nargin"] = np.array([[float(len(arguments))]])
    _, names = evaluation.apart(given, lambda inner: Program(code, function, inner, depth).run())
    for name in function.results:
        if name not in names and depth == 0:
            raise NotComputed(f"the output {name} gets no value")
    return names


def _of_kind(value: Value, kind: Any, in_c: bool) -> Value:
    """Return a value as one of this kind; of a bus each field."""
    if isinstance(value, dict) and isinstance(kind, Bus):
        fields = {one.name: one.kind for one in kind.fields}
        return {name: _of_kind(one, fields.get(name), in_c) for name, one in value.items()}
    array = as_array(value)
    if in_c and kind in INTEGER_TYPES and class_of(array) not in (kind, "bool"):
        if is_signal(array) or not np.array_equal(array.astype(kind), array):
            raise NotComputed(f"{class_of(array)} in {kind} has other rules in C")
    return value if kind is None or class_of(array) == kind else converted(array, kind)


def is_empty(value: Value) -> bool:
    """Return True for an array without elements."""
    return isinstance(value, np.ndarray) and value.size == 0


def chosen(condition: Any, a: Value, b: Value, name: str) -> Value:
    """Return `a` where the condition holds, else `b`. Raises NotComputed for values of two classes or sizes."""
    if a is b:
        return a
    if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
        return {key: chosen(condition, a[key], b[key], f"{name}.{key}") for key in a}
    if not isinstance(a, np.ndarray) or not isinstance(b, np.ndarray):
        if type(a) is type(b) and not isinstance(a, dict | list) and a == b:
            return a
        raise NotComputed(f"{name} has values in two branches that are not one class")
    if a.shape != b.shape:
        sizes = " and ".join(f"{one.shape[0]} by {one.shape[1]}" for one in (a, b))
        raise NotComputed(f"{name} is {sizes} in two branches")
    if not is_signal(a) and not is_signal(b) and a.dtype == b.dtype and a.tobytes() == b.tobytes():
        return a
    if class_of(a) != class_of(b):
        raise NotComputed(f"{name} is {class_of(a)} and {class_of(b)} in two branches")
    pairs = zip(lifted(a).flatten(order="F"), lifted(b).flatten(order="F"), strict=True)
    return filled(a.shape, (one if one is other else where(condition, one, other) for one, other in pairs))
