"""Lines of C, with the stores that a style may write in its own way."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass
class CWriter:
    """Lines of C with indentation, and what they call."""

    lines: list[str] = field(default_factory=list)
    helpers: set[str] = field(default_factory=set)
    functions: set[str] = field(default_factory=set)
    depth: int = 1
    elements: int = 0  # of local arrays
    masked: bool = False  # whether a choice is made for each of several instances
    lean: bool = False  # see emitter.emit

    def line(self, text: str) -> None:
        """One more line, indented."""
        self.lines.append("    " * self.depth + text if text else "")

    @contextmanager
    def function(self, head: str) -> Iterator[None]:
        """A function around what is written inside."""
        self.lines += [head, "{"]
        yield
        self.lines += ["}", ""]

    @contextmanager
    def block(self, head: str) -> Iterator[None]:
        """`head {` ... `}` around what is written inside."""
        self.line(f"{head} {{")
        self.depth += 1
        yield
        self.depth -= 1
        self.line("}")

    @contextmanager
    def side(self, head: str) -> Iterator[None]:
        """`if (...) {` ... `}`, or behind one `else {` ... `}`: `else if` where all inside is one `if`."""
        if head != "else":
            with self.block(head):
                yield
            return
        indent = "    " * self.depth
        self.lines[-1] = f"{indent}}} else {{"
        start = len(self.lines)
        self.depth += 1
        yield
        self.depth -= 1
        inner = [line for line in self.lines[start:] if not line.startswith(f"{indent}        ")]
        alone = inner[0].lstrip().startswith("if (") and inner[-1].strip() == "}"
        if alone and all(line.lstrip().startswith("} else") for line in inner[1:-1]):
            within = [line[4:] for line in self.lines[start:]]
            self.lines[start - 1 :] = [f"{indent}}} else {within[0].lstrip()}", *within[1:]]
        else:
            self.line("}")

    @contextmanager
    def choice(self, due: str, tests: Sequence[str] = ()) -> Iterator[None]:
        """An `if` around what is written inside: what is the same in all instances, and what is an instance's own."""
        with self.block(f"if ({' && '.join([*filter(None, (due,)), *tests])})"):
            yield

    def assign(self, target: str, text: str, kind: str) -> None:
        """A line that stores a value; within a choice it may be one that is needed outside."""
        self.line(f"{target} = {text};")

    def copy(self, target: str, source: str, width: int, kind: str, own: bool = False) -> None:
        """A line that copies an array; `own`: into one that nothing outside the choice reads."""
        self.line(f"(void)memcpy({target}, {source}, sizeof {source}[0] * {width}u);")

    def duplicate(self, target: str, source: str, width: int, kind: str) -> None:
        """A line that copies a member of a struct that is an array."""
        self.line(f"(void)memcpy({target}, {source}, sizeof {target});")

    def table(self, target: str, table: str, width: int, kind: str) -> None:
        """A line that copies a table of constants into an array."""
        self.line(f"(void)memcpy({target}, {table}, sizeof {table});")

    def index(self, name: str, text: str) -> None:
        """A line that keeps an index."""
        self.line(f"const int32_t {name} = {text};")

    def put(self, target: str, index: str, text: str, kind: str, own: bool = False) -> None:
        """A line that stores an element of an array; `own` as in `copy`."""
        self.line(f"{target}[{index}] = {text};")
