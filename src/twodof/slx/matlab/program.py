"""MATLAB's language carried out: expressions, functions and scripts, on numbers and on recorded signals.

`evaluate(text, workspace)` gives the value of an expression.

Where a condition is a signal both branches are carried out, and each name gets its value of the branch that holds.
`return`, `break` and `continue` under such a condition become a signal too: what follows them is carried out where it
does not hold. Loops have constant ranges and are written out.
"""

import copy
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from twodof.blocks.bus import Bus
from twodof.blocks.expressions.numbers import INTEGER_TYPES
from twodof.errors import DiagramError, LogError
from twodof.flightlog import fence
from twodof.slx.matlab.evaluation import Evaluation, data_of, range_of, script_text, signed
from twodof.slx.matlab.library import LIBRARY
from twodof.slx.matlab.parser import BLOCK_COMMENT, FunctionDefinition, MatlabParser, Tree, expression_of, tokens_of
from twodof.slx.matlab.signals import chosen, truth, wrapped
from twodof.slx.matlab.signals import in_c as operation_in_c
from twodof.slx.matlab.values import (
    FUNCTIONS,
    MOST_ELEMENTS,
    Array,
    Cells,
    MatlabTable,
    Members,
    NotComputed,
    Value,
    as_array,
    class_of,
    converted,
    indexed,
    is_empty,
    is_signal,
    joined,
    lowered,
    number,
    scalar,
    stored,
)

DEEPEST_CALLS, MOST_TURNS, _RETURNING_TURNS = 20, 1000, 40
_DATA = re.compile(r"\w[\w. -]{0,100}\.(?:csv|mat)")
EMPTY = np.zeros((0, 0))
IN_BASE = "base/."
"""What the names begin with under which names of the base workspace are kept between calls."""
_LEAVING = {"return": "#return", "break": "#break", "continue": "#continue"}
"""The names that say under which condition the statements after one of these are left out."""
_NAMED = {
    "plus": "+", "minus": "-", "times": ".*", "mtimes": "*", "rdivide": "./", "mrdivide": "/", "power": ".^",
    "mpower": "^", "and": "&", "or": "|", "eq": "==", "ne": "~=", "lt": "<", "le": "<=", "gt": ">", "ge": ">=",
}  # fmt: skip
"""Operators by the names of their functions."""
IN_C = "#in C"
"""A known name with the functions that are a chart's actions in C, and whether their whole numbers wrap around."""


class NotTranslatedLine(NotComputed):
    """A statement that is not translated, with its line."""


class Code:
    """The text of a MATLAB Function: its tokens, where its blocks end, and its functions, the main one first.

    A `script` has its statements for a main function. Raises NotComputed for a text that cannot be read.
    """

    def __init__(self, text: str, folders: Sequence[Path] = (), script: bool = False) -> None:
        self.folders = folders
        self.files: dict[str, Code | None] = {}
        """The functions of the folders by name; None for a name without a file."""
        self.read: dict[Path, Value] = {}
        """What files of data hold, each read once."""
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
        self.base: dict[str, Value] = {}
        """The base workspace at the start; what `assignin` gives it is kept between calls in names `base/.x`."""
        self.touched: set[str] = set()
        """Names of the base workspace that may be read or assigned."""
        self.declared: dict[str, Any] = {}
        """Kinds to which names convert what they are assigned: a chart's data, and `function.name`."""
        self.shared: set[str] | None = None
        """Names of a chart's main function that its other functions see and change."""
        self.seen: dict[str, Value] = {}
        """Their values at a call."""
        parser = MatlabParser(self.tokens, script)
        top = parser.block("function")
        made = parser.functions()
        if not made and not script:
            raise NotComputed("there is no function in it")
        self.unclosed = parser.unclosed
        """Whether a block of a script has no end."""
        self.main = FunctionDefinition("", [], [], top, 0, len(self.tokens) - 1) if script else made[0]
        self.functions = {one.name: one for one in made}

    def file(self, name: str) -> "Code | None":
        """Return the code of NAME.m in one of the folders; None where there is none."""
        if name not in self.files:
            candidates = (one / f"{name}.m" for one in self.folders) if name.isidentifier() else ()
            path = next((one for one in candidates if one.is_file()), None)
            self.files[name] = None
            if path is not None:
                try:
                    made = Code(fence.read(script_text, path)[0], self.folders)
                except LogError as reason:
                    raise NotComputed(str(reason)) from None
                except NotComputed as reason:
                    raise NotComputed(f"{name}.m: {reason}") from None
                made.files, made.initial, made.notes, made.known = self.files, self.initial, self.notes, self.known
                made.base, made.touched, made.read = self.base, self.touched, self.read
                made.prefix = f"{name}/"
                self.files[name] = made
        return self.files[name]

    def data(self, name: Value) -> Value:
        """Return what a .csv or .mat file in one of the folders holds. Raises NotComputed where there is none."""
        candidates = [one / name for one in self.folders if isinstance(name, str) and _DATA.fullmatch(name)]
        try:
            path = next(filter(Path.is_file, candidates))
            if path not in self.read:
                self.read[path] = data_of(path)
        except (StopIteration, LogError) as reason:
            raise NotComputed(str(reason) or f"{name} is not found") from None
        return self.read[path]


@cache
def of_library(name: str) -> Code | None:
    """Return the code of a function of the library; None where there is none."""
    return Code(LIBRARY[name]) if name in LIBRARY else None


class Program:
    """The run of one function of a program, in `names`, which it changes.

    The value of the persistent variable x of the function f is kept in the name `f.x`.
    """

    def __init__(self, code: Code, function: FunctionDefinition, evaluation: Evaluation, depth: int = 0) -> None:
        self.code, self.function_run, self.evaluation, self.calls = code, function, evaluation, depth
        self.persistent: list[str] = []
        in_c, wraps = code.known.get(IN_C, ((), False))
        self.wraps: bool | None = wraps if function.name in in_c else None
        """Of an action in C, whether whole numbers wrap around."""
        own = {*function.arguments, *function.results} if function is not code.main else set[str]()
        self.kinds = {name: kind for name, kind in code.declared.items() if "." not in name and name not in own}
        self.kinds |= {name: code.declared[one] for name in own if (one := f"{function.name}.{name}") in code.declared}
        if depth > DEEPEST_CALLS:
            raise NotComputed("functions call each other too deep")

    def run(self) -> None:
        """Carry out the function. Raises NotTranslatedLine for a statement that is not translated."""
        self._convert()
        self.block(self.function_run.body.parts)
        for name in self.persistent:
            self.evaluation.names[self._kept(name)] = self.evaluation.names[name]

    def _kept(self, name: str) -> str:
        """Return the name under which a persistent variable is kept between calls.

        With a `?` it says if the variable has a value, where that depends on signals.
        """
        return f"{self.code.prefix}{self.function_run.name}.{name}"

    def block(self, statements: Sequence[Tree]) -> None:
        """Carry out statements."""
        for k, one in enumerate(statements):
            left = self._left()
            if left is True:
                break
            if left is not False:
                self.either(left, lambda: None, partial(self._afresh, statements[k:]))
                break
            empty = self._empty()
            try:
                self.statement(one)
            except NotTranslatedLine:
                raise
            except (NotComputed, DiagramError) as reason:
                why = reason.what if isinstance(reason, DiagramError) else str(reason)
                raise NotTranslatedLine(f"line {one.line}: {why}") from None
            self._convert()
            for name in empty - self._empty():
                self.code.initial[self._kept(name)] = self.evaluation.names[name]

    def _convert(self) -> None:
        """Convert names that have a declared kind."""
        for name, kind in self.kinds.items():
            value = self.evaluation.names.get(name, EMPTY)
            if not is_empty(value):
                self.evaluation.names[name] = _of_kind(value, kind, self.wraps)

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

    def _afresh(self, statements: Sequence[Tree]) -> None:
        for name in _LEAVING.values():
            self.evaluation.names.pop(name, None)
        self.block(statements)

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
            if name.startswith(IN_BASE) and (a is None or b is None):
                raise NotComputed(f"{name.removeprefix(IN_BASE)} of the base workspace is there in one branch only")
            if "." in name and not name.endswith("?"):
                one_there, other_there = (as_array(side.get(f"{name}?", np.array([[name in side]]))) for side in made)
                if not all(not is_signal(one) and one.all() for one in (one_there, other_there)):
                    before[f"{name}?"] = chosen(condition, one_there, other_there, name)
            if name.endswith("?"):
                continue
            before[name] = a if b is None else b if a is None else chosen(condition, a, b, name)

    def statement(self, tree: Tree) -> None:
        """Carry out a statement with all that belongs to it."""
        self.evaluation.count()
        names = self.evaluation.names
        match tree.kind:
            case "assign":
                self._assign(tree.parts[0], lambda: self.value(tree.parts[1]))
            case "expression":
                names["ans"] = self.value(tree.parts[0])
            case "if":
                self._choose(tree.parts)
            case "switch":
                self._choose(tree.parts[1:], self.value(tree.parts[0]))
            case "for":
                self._for(tree.text, tree.parts[0], tree.parts[1])
                self.evaluation.names.pop("#break", None)
            case "while":
                self._while(tree.parts[0], tree.parts[1])
                self.evaluation.names.pop("#break", None)
            case "leave":
                names[_LEAVING[tree.text]] = np.array([[True]])
            case "persistent":
                self._persist([one.text for one in tree.parts])
            case "several":
                self._assign_several(tree.parts[0], tree.parts[1:])
            case "silent":
                if tree.text == "error":
                    self.code.notes.append(f"line {tree.line}: error() is left out")
                for one in tree.parts:
                    names.pop(one.text, None)
            case _:
                raise NotComputed(tree.text or f"'{tree.kind}' is not translated")
        if tree.excess:
            raise NotComputed(tree.excess)

    def _persist(self, names: Sequence[str]) -> None:
        self.persistent += names
        for name in names:
            self.evaluation.names[name] = self.evaluation.names.setdefault(self._kept(name), EMPTY)
        if self.code.shared is not None and self.function_run is self.code.main:
            self.code.shared.update(names)

    def _assign(self, target: Tree, compute: Callable[[], Value]) -> None:
        """Store a value, computed after the indices of its place, in a name, or in a field or elements of its value."""
        name, steps = target.parts[0].text, list[Any]()
        old: Value = self.evaluation.names.get(name)
        for step in target.parts[1:]:
            if step.kind == "{":
                steps.append([int(scalar(self.value(one))) for one in step.parts])
            elif step.kind == "(":
                steps.append(tuple(self.arguments(step.parts, old if isinstance(old, np.ndarray) else EMPTY)))
            else:
                steps.append(step.text)
            old = old.get(step.text) if step.kind == "." and isinstance(old, dict) else None
        value = compute()
        if f"{self._kept(name)}?" in self.evaluation.names and name in self.persistent:
            self.evaluation.names[f"{self._kept(name)}?"] = np.array([[True]])
        self.evaluation.names[name] = stored(self.evaluation.names.get(name), steps, value)

    def _assign_several(self, source: Tree, targets: Sequence[Tree]) -> None:
        base, *steps = source.parts if source.kind == "access" else (source,)
        name = base.text
        if base.kind != "name" or len(steps) > 1 or any(one.kind != "(" for one in steps):
            raise NotComputed("several values are given by a function only")
        arguments = self.arguments(steps[0].parts) if steps else []
        found = self.called(name, arguments, True, len(targets))
        if not isinstance(found, list) or len(found) < len(targets):
            raise NotComputed(f"{name} gives fewer than {len(targets)} values")
        for target, value in zip(targets, found, strict=False):
            if target.parts:
                self._assign(target, partial(lambda one: one, value))

    def _choose(self, clauses: Sequence[Tree], value: Value = None) -> None:
        """Carry out the first of these clauses whose condition holds; of `switch` the value."""
        if not clauses:
            return
        *asked, body = clauses[0].parts
        held: Any = True
        if clauses[0].kind == "case":
            held = self._matches(value, self.value(asked[0]))
        elif asked:
            held = truth(self.value(asked[0]))
        if isinstance(held, bool):
            self.block(body.parts) if held else self._choose(clauses[1:], value)
        else:
            self.either(held, lambda: self.block(body.parts), lambda: self._choose(clauses[1:], value))

    def _matches(self, value: Value, case: Value) -> Any:
        found: Any = False
        for one in case if isinstance(case, list) else [case]:
            if isinstance(value, str) or isinstance(one, str):
                same: Any = isinstance(value, str) and isinstance(one, str) and value == one
            else:
                same = truth(self._apply("==", value, one))
            if same is True:
                return True
            found = same if found is False else found if same is False else found | same
        return found

    def _for(self, name: str, values: Tree, body: Tree) -> None:
        """Carry out the turns of a `for`, each where it was not left before."""

        def turn(value: Array) -> None:
            self.evaluation.names[name] = value
            self._afresh(body.parts)

        for column in as_array(self.value(values)).T:
            left, act = self._left(), partial(turn, column.reshape(-1, 1))
            if left is False:
                act()
            elif left is not True:
                self.either(left, lambda: None, act)
            self.evaluation.names.pop("#continue", None)
            if self._left() is True:
                break

    def _while(self, condition: Tree, body: Tree, turns: int = 0) -> None:
        """Carry out the turns of a `while`, those behind one that depends on signals as a loop."""
        if turns > _RETURNING_TURNS:
            raise NotComputed(f"a return that depends on signals, out of a loop of more than {_RETURNING_TURNS} turns")
        for name in _LEAVING.values():
            self.evaluation.names.pop(name, None)
        left: Any = False
        while left is False:
            held = truth(self.value(condition))
            if held is False:
                return
            if held is not True:
                self._loop(condition, body)
                return
            self.block(body.parts)
            self.evaluation.names.pop("#continue", None)
            left = self._left()
        if left is not True:
            more = partial(self._while, condition, body, turns + 1)
            self.either(
                left, lambda: None, more if "#return" in self.evaluation.names else partial(self._loop, condition, body)
            )

    def _loop(self, condition: Tree, body: Tree) -> None:
        """Record the turns of a `while` whose condition is a signal, as a loop of a bounded number of turns."""
        for name in _LEAVING.values():
            self.evaluation.names.pop(name, None)

        def turn() -> Any:
            held = truth(self.value(condition))
            self.block(body.parts)
            if "#return" in self.evaluation.names:
                raise NotComputed("a return out of a loop whose turns depend on signals is not translated")
            self.evaluation.names.pop("#continue", None)
            left = self._left()
            self.evaluation.names.pop("#break", None)
            return held, left

        self.evaluation.repeat(turn, MOST_TURNS)
        self.code.notes.append(
            f"a loop whose turns depend on signals ends after {MOST_TURNS} turns, where MATLAB goes on; each step "
            "computes as many"
        )

    # --- expressions

    def value(self, tree: Tree) -> Value:
        """Return the value of an expression."""
        match tree.kind:
            case "access":
                return self._access(tree.parts[0], tree.parts[1:])
            case "literal":
                return tree.value
            case "name":
                return self._named(tree.text)
            case "chain":
                return self._chain(tree)
            case "signs":
                value = self.value(tree.parts[0])
                for sign in reversed(tree.text):
                    whole = self.wraps is not None and sign == "-" and class_of(as_array(value)) != "real"
                    zero = np.zeros((1, 1), np.int32)
                    value = self._apply("-", zero, value) if whole else as_array(value)
                    value = value if whole or sign == "+" else signed(sign, value)
                return value
            case "range":
                return range_of(*map(self.value, tree.parts))
            case "rows":
                return self._rows(tree)
            case "handle":
                return self._handle(tree)
        raise NotComputed(tree.text)

    def _chain(self, tree: Tree) -> Value:
        """Compute operations from left to right; what && or || decide before is not computed."""
        left = self.value(tree.parts[0])
        for step in tree.parts[1:]:
            if not step.parts:
                left = left if isinstance(left, list) else as_array(left).T
                continue
            short = step.kind in ("&&", "||") and not (step.text or is_signal(left))
            if short and bool(as_array(left).all()) == (step.kind == "||"):
                left = np.array([[step.kind == "||"]])
            else:
                left = self._apply(step.kind, left, self._right_of(step, left))
        return left

    def _access(self, base: Tree, steps: Sequence[Tree]) -> Value:
        """Return a value with its indices and fields, or what a function gives that has no value of this name."""
        self.evaluation.count()
        name, names = base.text, self.evaluation.names
        if base.kind == "name" and name not in names and not (name == "end" and self.evaluation.ends):
            while steps and steps[0].kind == ".":
                name, steps = f"{name}.{steps[0].text}", steps[1:]
            called = bool(steps) and steps[0].kind == "("
            value, steps = self._function(name, steps[0].parts if called else None), steps[called:]
        else:
            value = self.value(base)
        for step in steps:
            value = self._step(value, step)
        return value

    def _step(self, value: Value, step: Tree) -> Value:
        """Return an element or a field of a value."""
        if step.kind == "(":
            given = self.arguments(step.parts, value)
            if isinstance(value, Members) and self.wraps is not None:
                return _of_kind(given[0], "int32", self.wraps)
            return value(self, given) if callable(value) else indexed(value, given)
        if step.kind == "{":
            if isinstance(value, MatlabTable):
                return indexed(np.asarray(value), self.arguments(step.parts, value))
            if not isinstance(value, Cells) or len(step.parts) > 2:
                raise NotComputed("this is no cell array, or one of more than two dimensions")
            return value[value.place(*(int(scalar(self.value(one))) for one in step.parts))]
        if isinstance(value, dict) and step.text not in value:
            value = number(value)  # a field of what a parameter holds
        if not isinstance(value, dict) or step.text not in value:
            raise NotComputed(f"there is no field {step.text}")
        return value[step.text]

    def _named(self, name: str) -> Value:
        if name == "end" and self.evaluation.ends:
            array, index, count = self.evaluation.ends[-1]
            size = array.size if count == 1 else array.shape[index] if index < 2 else 1
            return np.array([[float(size)]])
        value = self.evaluation.names[name]
        if name in self.persistent and is_empty(value):
            raise NotComputed(f"{name} is read before it has a value")
        return value

    def _rows(self, tree: Tree) -> Value:
        """Compute a matrix, or a cell array."""
        rows = [[self.value(one) for one in row.parts] for row in tree.parts]
        if tree.text == "{":
            return Cells([row for row in rows if row])
        sizes = [one.size for row in rows for one in row if isinstance(one, np.ndarray)]
        if any(map(is_signal, (one for row in rows for one in row))):
            self.evaluation.count_signals(sum(sizes))
        if sum(sizes) > MOST_ELEMENTS:
            raise NotComputed(f"an array has more than {MOST_ELEMENTS} elements")
        return joined([row for row in rows if row])

    def arguments(self, parts: Sequence[Tree], indexed: Value = None) -> list[Value]:
        """Return arguments, or indices of a value, in which `end` has a meaning."""
        found: list[Value] = []
        for one in parts:
            if isinstance(indexed, np.ndarray | str):
                self.evaluation.ends.append((as_array(indexed), len(found), len(parts)))
            found.append(self.value(one))
            if isinstance(indexed, np.ndarray | str):
                self.evaluation.ends.pop()
        return found

    def _apply(self, operator: str, left: Value, right: Value) -> Value:
        """Compute an operation of two values; the library solves a system with signals."""
        if self.wraps is not None:
            operator, left, right = operation_in_c(operator, left, right, self.wraps)
        if operator == "^" and is_signal(left) and isinstance(right, np.ndarray) and as_array(left).size > right.size:
            if not is_signal(right) and right.size == 1 and right.item() < 0:  # that of the inverse
                left, right = self.called("inv", [left], True), -right
        matrix = {"\\": left, "/": right}.get(operator)
        if not isinstance(matrix, np.ndarray) or matrix.size == 1 or not (is_signal(left) or is_signal(right)):
            return self.evaluation.apply(operator, left, right)
        turned = (left, right) if operator == "\\" else (matrix.T, as_array(left).T)
        found = as_array(self.called("mldivide", [*turned], True))
        return found if operator == "\\" else found.T

    def _right_of(self, step: Tree, left: Value) -> Value:
        """Compute the right of an operator; what it changes holds only where && or || come to it."""
        if step.kind not in ("&&", "||") or not is_signal(left):
            return self.value(step.parts[0])
        found: list[Value] = []

        def compute() -> None:
            found.append(self.value(step.parts[0]))

        branches = (compute, lambda: None) if step.kind == "&&" else (lambda: None, compute)
        self.either(truth(left), *branches)
        return found[0]

    def _handle(self, tree: Tree) -> Callable[..., Value]:
        """Return the function of `@name`, or of `@(a, b) expression` with the names as they are now."""
        names = {one: value for one, value in self.evaluation.names.items() if one.isidentifier()}
        arguments = [one.text for one in tree.parts[1:]]

        def called(caller: "Program", given: list[Value], count: int = 1) -> Value:
            inner = copy.copy(self)
            inner.calls, inner.evaluation = caller.calls + 1, caller.evaluation
            if inner.calls > DEEPEST_CALLS:
                raise NotComputed("functions call each other too deep")
            if tree.text:
                return inner.called(tree.text, given, True, count)
            if len(given) > len(arguments) or count > 1:
                raise NotComputed(f"the function takes {len(arguments)} arguments and gives one value")

            def run(evaluation: Evaluation) -> Value:
                inner.evaluation = evaluation
                return inner.value(tree.parts[0])

            return caller.evaluation.apart({**names, **dict(zip(arguments, given, strict=False))}, run)[0]

        return called

    def _function(self, name: str, arguments: Sequence[Tree] | None) -> Value:
        """Call a function, or return a constant; `isempty` looks at a persistent variable without reading it."""
        asked = arguments[0].parts if name == "isempty" and arguments else ()
        if len(asked) == 1 and asked[0].kind == "name" and asked[0].text in self.persistent:
            there = self.evaluation.names.get(f"{self._kept(asked[0].text)}?")
            return np.array([[asked[0].text in self._empty()]]) if there is None else signed("~", as_array(there))
        return self.called(name, self.arguments(arguments or ()), arguments is not None)

    def _of_base(self, where: Value, text: Value, *assigned: Value) -> Value:
        """Return an expression of the base workspace, or assign one of its names."""
        if where != "base" or not isinstance(text, str):
            raise NotComputed("evalin and assignin are translated for names of the base workspace")
        self.code.touched.update(re.findall(r"[A-Za-z]\w*", text))
        if assigned:
            if self.evaluation.names.get(IN_BASE + text) is None:
                self.code.notes.append(f"{text} of the base workspace is a state, which begins as the workspace has it")
            self.evaluation.names[IN_BASE + text] = assigned[0]
            return None
        kept = {
            name.removeprefix(IN_BASE): one for name, one in self.evaluation.names.items() if name.startswith(IN_BASE)
        }
        tree, excess = expression_of(text)
        if excess:
            raise NotComputed(f"'{excess}' is not expected")
        inner = copy.copy(self)

        def run(evaluation: Evaluation) -> Value:
            inner.evaluation = evaluation
            return inner.value(tree)

        return self.evaluation.apart({**self.code.base, **kept}, run)[0]

    def called(self, name: str, arguments: list[Value], bracket: bool, count: int = 1) -> Value:
        """Call a function of the program, or one of MATLAB's."""
        if name in ("evalin", "assignin") and len(arguments) > 1:
            return self._of_base(*arguments[:2], *arguments[2:3])
        if name in ("load", "readtable", "readmatrix", "csvread") and arguments:
            if len(arguments) > 1:
                raise NotComputed(f"{name} with more than the name of a file is not computed")
            found = self.code.data(f"{arguments[0]}".removesuffix(".mat") + ".mat" if name == "load" else arguments[0])
            return found.view(MatlabTable) if name == "readtable" else found
        if name == "exist" and arguments:
            return np.array([[float(arguments[0] in self.evaluation.names)]])
        name, arguments = (arguments[0], arguments[1:]) if name == "feval" and arguments else (name, arguments)
        held = self.evaluation.names.get(name) if isinstance(name, str) else name
        if callable(held):
            return held(self, arguments, count)
        if self.wraps is not None and name in INTEGER_TYPES:  # a cast
            return _of_kind(arguments[0], name, self.wraps)
        if self.wraps is not None and name in ("bitand", "bitor", "bitshift"):
            name, *arguments = operation_in_c(name, arguments[0], arguments[1], self.wraps)
        if name == "single" or "single" in [one for one in arguments if isinstance(one, str)]:
            self.code.notes.append("single: computed in the precision of the build")
        code, function = self.code, self.code.functions.get(name)
        if function is None:
            numbers = name in FUNCTIONS and not any(map(is_signal, arguments))
            found_file = self.code.file(name) or (None if numbers else of_library(name))
            if found_file is not None:
                code, function = found_file, found_file.main
        if function is None:
            if name == "refused":
                texts = (one if isinstance(one, str) else f"{one.shape[0]} by {one.shape[1]}" for one in arguments)
                raise NotComputed(" ".join(texts))
            if name in _NAMED and len(arguments) == 2:
                return self._apply(_NAMED[name], *arguments)
            return self.evaluation.called(name, arguments, bracket, count)
        if len(arguments) > len(function.arguments):
            raise NotComputed(f"{name} takes {len(function.arguments)} arguments")
        shared = (code.shared or set()) - {*function.arguments, *function.results}
        code.seen = {one: value for one, value in self.evaluation.names.items() if one in (code.shared or ())}
        try:
            found = call(code, function, arguments, self.evaluation, self.calls + 1, count)
        except NotTranslatedLine as reason:
            said = str(reason).partition(": ")[2] if code is of_library(name) else f"{name}.m, {reason}"
            raise reason if code is self.code else NotComputed(said) from None
        self.evaluation.names.update({one: found[one] for one in shared & found.keys()})
        if count > 1:
            return [found.get(one) for one in function.results]
        return found.get(function.results[0]) if function.results else None


def evaluate(text: str, workspace: Mapping[str, Value], where: str = "expression") -> Value:
    """Return the value of an expression. Raises DiagramError, with the name that is missing or what is not computed."""
    try:
        tree, excess = expression_of(text)
        nothing = Code("", script=True)
        value = Program(nothing, nothing.main, Evaluation(dict(workspace))).value(tree)
        if callable(value):
            raise NotComputed("'@' is not computed")
        if excess:
            raise NotComputed(f"'{excess}' is not expected")
    except NotComputed as reason:
        raise DiagramError(f"{text.strip()[:80]}: {reason}", where, "give a constant or a --workspace file") from None
    return value


def call(
    code: Code,
    function: FunctionDefinition,
    arguments: Sequence[Value],
    evaluation: Evaluation,
    depth: int = 0,
    count: int | None = None,
) -> Mapping[str, Value]:
    """Carry out a function on arguments and return its names. The evaluation keeps persistent variables.

    `count` results are asked for; None: all.
    """
    given = {**code.known, **code.seen, **dict(zip(function.arguments, arguments, strict=False))}
    asked = len(function.results) if count is None else count
    given["nargin"], given["nargout"] = (np.array([[float(n)]]) for n in (len(arguments), asked))
    _, names = evaluation.apart(given, lambda inner: Program(code, function, inner, depth).run())
    for name in function.results:
        if name not in names and depth == 0:
            raise NotComputed(f"the output {name} gets no value")
    return names


def _of_kind(value: Value, kind: Any, wraps: bool | None) -> Value:
    """Return a value as one of this kind; of a bus each field. `wraps` is that of an action in C."""
    if isinstance(value, dict) and isinstance(kind, Bus):
        fields = {one.name: one.kind for one in kind.fields}
        return {name: _of_kind(one, fields.get(name), wraps) for name, one in value.items()}
    array = as_array(value)
    if wraps is not None and kind in INTEGER_TYPES and class_of(array) not in (kind, "bool"):
        if class_of(array) in INTEGER_TYPES:
            return lowered(wrapped(array, kind) if wraps else converted(array, kind))
        if is_signal(array) or not np.array_equal(array.astype(kind), array):
            raise NotComputed(f"{class_of(array)} in {kind} has other rules in C")
    return value if kind is None or class_of(array) == kind else converted(array, kind)
