"""Scripts that give names their values: callbacks, masks, .m files; and the values of .mat files.

`run(code, workspace, folders)` carries out a script as a program. It calls the functions and scripts of .m files in
these folders, and reads their .mat and .csv files behind the fence; no other file is opened. A statement that is not
computed is skipped and said by its line, and what it would have assigned is unknown afterwards.
"""

import re
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from twodof.errors import DiagramError, LogError
from twodof.flightlog import fence
from twodof.slx.matlab.evaluation import MOST_STEPS, Evaluation, recorded, script_text
from twodof.slx.matlab.parser import OPENING, SILENT, Tree, assigned_by
from twodof.slx.matlab.program import EMPTY, Code, NotTranslatedLine, Program
from twodof.slx.matlab.values import FUNCTIONS, Array, NotComputed, Value, as_array, bounded, class_of, scalar

DEEPEST_SCRIPTS = 5
MOST_DESIGNS, MOST_DESIGNED = 100, 50
"""How many gains a script designs, and of how many states: a Riccati equation of 50 takes a tenth of a second."""
_HEAD = re.compile(r"(?:\s|%[^\n]*\n)*function\b[^\n]*\n")
_NEXT_FUNCTION = re.compile(r"^function\b", re.MULTILINE)
_FILE = re.compile(r"[\w-][\w. -]{0,100}\.(?:m|mat)")


@dataclass(frozen=True)
class Skipped:
    """A statement that was not carried out: its line, counted from 1, and why."""

    line: int
    why: str


class RunningScript(Program):
    """The run of a script, which may run others and load .mat files by their names."""

    def __init__(self, code: Code, evaluation: Evaluation, base: MutableMapping[str, Value], depth: int) -> None:
        super().__init__(code, code.main, evaluation)
        self.base, self.depth_of_scripts = base, depth
        self.skipped: list[Skipped] = []
        self.unnamed = False
        """Whether a bus that MATLAB would number was not made."""
        self.random, self.line = np.random.default_rng(0), 0

    def statement(self, tree: Tree) -> None:
        """Carry out a statement: `name`, `run name` and `load name` are those of a file."""
        self.line, tokens = tree.line, self.code.tokens[tree.start : tree.stop]
        words = [one.text for one in tokens if one.kind in ("name", "text", "number")]
        plain = {one.text for one in tokens if one.kind == "operator"} <= {*"()."}
        command = words[0] if words else ""
        if plain and command in ("run", "load") and len(words) > 1:
            self._file(words[1], ".mat" if command == "load" else ".m", self.evaluation.names)
        elif plain and words == [command] and command not in self.evaluation.names and self._found(f"{command}.m"):
            self._file(command, ".m", self.evaluation.names)
        else:
            super().statement(tree)

    def _found(self, name: str) -> Path | None:
        candidates = (one / name for one in self.code.folders) if _FILE.fullmatch(name) else ()
        return next((one for one in candidates if one.is_file()), None)

    def _file(self, name: str, suffix: str, names: MutableMapping[str, Value]) -> None:
        name = f"{name.removesuffix(suffix)}{suffix}"
        file = self._found(name)
        if file is None or self.depth_of_scripts >= DEEPEST_SCRIPTS:
            raise NotComputed(f"{name} is not found" if file is None else "scripts run each other too deep")
        try:
            found = read_workspace(file, names, self.code.folders, self.depth_of_scripts + 1)
            self.skipped += [Skipped(self.line, f"{file.name}, line {one.line}: {one.why}") for one in found]
        except DiagramError as reason:
            raise NotComputed(reason.what) from None

    def called(self, name: str, arguments: list[Value], bracket: bool, count: int = 1) -> Value:
        """Call a function; two of them give the base workspace its names."""
        if name in ("rand", "randn"):
            if not any(one.why.endswith("a fixed draw") for one in self.skipped):
                self.skipped.append(Skipped(self.line, f"{name} gives a fixed draw"))
            shape = FUNCTIONS["zeros"](*arguments).shape
            return self.random.random(shape) if name == "rand" else self.random.standard_normal(shape)
        if name in _DESIGNS:
            self.evaluation.count(steps=MOST_STEPS // MOST_DESIGNS)
            if any(as_array(one).size > MOST_DESIGNED**2 for one in arguments):
                raise NotComputed(f"{name} of more than {MOST_DESIGNED} states is not computed")
            try:
                found = _DESIGNS[name](*map(as_array, arguments))
            except (TypeError, ValueError, np.linalg.LinAlgError) as reason:
                raise NotComputed(f"{name}: {reason}") from None
            return bounded(found[0]) if count == 1 else [bounded(one) for one in found[:count]]
        if name == "assignin" and len(arguments) == 3 and arguments[0] == "base":
            self.base[arguments[1]] = arguments[2]
        elif name == "Simulink.Bus.cellToObject" and arguments:
            self.base.update(_buses(arguments[0]))
        elif name == "Simulink.Bus.createObject" and arguments and isinstance(arguments[0], dict):
            if self.unnamed:
                raise NotComputed("the name of this bus is not known: that of an earlier one was not computed")
            made = next(one for k in range(1, len(self.base) + 2) if (one := f"slBus{k}") not in self.base)
            elements = [[field, np.array([as_array(v).shape]), _named(v)] for field, v in arguments[0].items()]
            self.base.update(_buses([[made, elements]]))
            return {"busName": made}
        elif name == "c2d" and arguments and isinstance(arguments[0], dict):
            return _sampled(*arguments)
        else:
            return super().called(name, arguments, bracket, count)
        return EMPTY


def _regulator(discrete: bool, a: Array, b: Array, q: Array, r: Array, n: Array | None = None) -> list[Array]:
    """Return the gain of a linear quadratic regulator, its cost matrix and its poles; n weighs states with inputs."""
    from scipy.linalg import solve_continuous_are, solve_discrete_are  # imported late, as in the fence

    n = np.zeros(b.shape) if n is None else n
    cost = (solve_discrete_are if discrete else solve_continuous_are)(a, b, q, r, s=n)
    weight, ahead = (r + b.T @ cost @ b, a) if discrete else (r, np.eye(len(a)))
    gain = np.linalg.solve(weight, b.T @ cost @ ahead + n.T)
    return [gain, cost, np.linalg.eigvals(a - b @ gain)[:, None]]


def _sampled(system: Mapping[str, Value], period: Value, method: str = "zoh") -> Value:
    """Return a system in state space whose inputs are held for a period."""
    from scipy.linalg import expm  # imported late, as in the fence

    a, b = as_array(system["A"]), as_array(system["B"])
    if method != "zoh" or a.size > MOST_DESIGNED**2 or len(a) != len(b):
        raise NotComputed(f"c2d by {method} of {len(a)} states is not computed")
    held = expm(np.pad(np.hstack([a, b]), ((0, b.shape[1]), (0, 0))) * scalar(period))
    return {**system, "A": held[: len(a), : len(a)], "B": held[: len(a), len(a) :], "Ts": as_array(period)}


def _named(value: Value) -> str:
    kind = class_of(as_array(value))
    return {"real": "double", "bool": "boolean"}.get(kind, kind)


def _placed(a: Array, b: Array, poles: Array) -> list[Array]:
    """Return the gain that gives a system with one input these poles, by Ackermann's formula."""
    if b.shape != (len(a), 1) or poles.size != len(a):
        raise ValueError("of one input and as many poles as states only")
    reached = np.hstack([np.linalg.matrix_power(a, k) @ b for k in range(len(a))])
    wanted = sum(v * np.linalg.matrix_power(a, len(a) - k) for k, v in enumerate(np.poly(poles.flatten())))
    return [np.linalg.solve(reached.T, np.eye(len(a))[:, -1:]).T @ wanted]


_DESIGNS: dict[str, Callable[..., list[Array]]] = {
    "lqr": partial(_regulator, False),
    "dlqr": partial(_regulator, True),
    "acker": _placed,
    "place": _placed,
}
"""Functions of Control System Toolbox that give gains."""


def _buses(cells: Value) -> dict[str, Value]:
    """Return the buses of a cell array as Simulink saves them: name, ..., and rows of name, dimensions, data type."""
    keys = ("Name", "Dimensions", "DataType")
    rows = [one for one in cells if isinstance(one, list) and one] if isinstance(cells, list) else []
    return {
        name: {"Elements": [dict(zip(keys, one, strict=False)) for one in elements if isinstance(one, list)]}
        for name, *_, elements in rows
        if isinstance(name, str) and isinstance(elements, list)
    }


def run(
    code: str, workspace: MutableMapping[str, Value], folders: Sequence[Path] = (), depth: int = 0
) -> list[Skipped]:
    """Carry out a script in a workspace, which it changes; return the statements that were not computed.

    A file of a function gives what it assigns in the base workspace, as scripts that define buses do.
    """
    own, last = workspace, ""
    if (head := _HEAD.match(code)) is not None:
        before = "\n" * code[: head.end()].count("\n")
        own, (body, *others) = {"nargin": np.zeros((1, 1))}, _NEXT_FUNCTION.split(code[head.end() :])
        code, local = before + body, "".join(f"\nfunction{one}" for one in others)
        lines = code.split("\n")
        said = [number for number, line in enumerate(lines) if line.partition("%")[0].strip()]
        if len(said) > 1 and lines[said[-1]].partition("%")[0].strip() == "end":
            last, lines[said[-1]] = code + local, ""
        code = "\n".join(lines) + local
    evaluation = Evaluation(own)
    try:
        program = Code(code, folders, script=True)
        if program.unclosed and last:  # the last end was not the function's
            program = Code(last, folders, script=True)
    except NotComputed as reason:
        return [Skipped(1, str(reason))]
    script = RunningScript(program, evaluation, workspace, depth)
    for one in program.main.body.parts:
        if "#return" in own:
            break
        try:
            script.statement(one)
        except NotComputed as reason:
            evaluation.ends = []
            script.unnamed |= any(token.text == "createObject" for token in program.tokens[one.start : one.stop])
            tokens, block = program.tokens[one.start : one.stop], one.kind in OPENING
            names, texts = assigned_by(tokens), [token.text for token in tokens[:3]]
            if not block and names == {texts[0]} and texts[1:2] == ["."]:
                field = texts[-1]
                if isinstance(held := own.get(texts[0]), dict):  # the other fields are known
                    own[texts[0]] = {name: value for name, value in held.items() if name != field}
                names = set()
            for name in names:
                own.pop(name, None)
            if texts[0] not in SILENT:
                within = re.match(r"line (\d+): (.*)", str(reason), re.DOTALL)
                inner = within if isinstance(reason, NotTranslatedLine) and block else None
                script.skipped.append(Skipped(int(inner[1]), inner[2]) if inner else Skipped(one.line, str(reason)))
    for name in [one for one in own if "." in one or "#" in one]:  # what functions keep between their calls
        del own[name]
    return script.skipped


def read_workspace(
    path: Path, names: MutableMapping[str, Value], folders: Sequence[Path] = (), depth: int = 0
) -> list[Skipped]:
    """Add what a script (.m) or a .mat file gives a value to `names`; return what was not computed.

    Scripts that it calls are looked for beside it first. Raises DiagramError for a file that cannot be read.
    """
    try:
        if path.suffix == ".m":
            code, _ = fence.read(script_text, path)
            return run(code, names, [path.parent, *folders], depth)
        found, skipped = recorded(path)
    except LogError as reason:
        raise DiagramError(reason.what, reason.where, "give a script (.m) or a .mat of format 7 or older") from reason
    names.update(found)
    return [Skipped(0, f"{name}: {why}") for name, why in skipped]
