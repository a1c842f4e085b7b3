"""Expressions as C99 that computes what is read under a condition only there."""

from collections.abc import Iterable, Sequence

from twodof.blocks.expressions.expr import Expr
from twodof.compile.c.branches import Branch, Step, decision, steps
from twodof.compile.c.expressions import Batch, Renderer
from twodof.compile.c.operators import ATOM


class BranchingRenderer(Renderer):
    """Writes the expressions of one block, some of them within `if` and `else`."""

    def _write(self, batch: Batch, order: Sequence[Expr]) -> None:
        found = steps(order, self._args, batch.always, bool(self.bound))
        self._count(batch, found)
        self._steps(batch, found)

    def _count(self, batch: Batch, found: Iterable[Step]) -> None:
        """All that one branch decides reads its condition once."""
        for step in found:
            if isinstance(step, Branch):
                batch.uses[id(step.condition)] -= len(step.chosen) - 1
                self._count(batch, step.then)
                self._count(batch, step.otherwise)

    def _steps(self, batch: Batch, found: Iterable[Step]) -> None:
        for step in found:
            if isinstance(step, Branch):
                self._branch(batch, step)
            else:
                self._step(batch, step)

    def _branch(self, batch: Batch, branch: Branch) -> None:
        """An `if` that gives variables their values."""
        found = [(item, decision(item, self._args(item))) for item in branch.chosen]
        decided = [(item, d) for item, d in found if d is not None]
        given = [batch.given.pop(id(item), "") for item, _ in decided]
        names = [name or self.names.numbered(f"{self.stem}_t") for name in given]
        # Where one side gives only what is at hand, the variables have it before the `if`, which has no `else` then.
        first = None
        if not any(given):
            if not branch.otherwise and not any(_loaded(d.otherwise) for _, d in decided):
                first = False
            elif not branch.then and not any(_loaded(d.then) for _, d in decided):
                first = True
        for (item, d), name, known in zip(decided, names, given, strict=True):
            if first is not None:
                initial = self._value(batch, d.then if first else d.otherwise, item.kind)
                self.writer.line(f"{self.types[item.kind]} {name} = {initial};")
            elif not known:
                self.writer.line(f"{self.types[item.kind]} {name};")
        text, binding = batch.texts[id(branch.condition)]
        if first:
            text = f"!{text}" if binding == ATOM else f"!({text})"
        if first is not True:
            self._side(
                batch, f"if ({text})", branch.then, [(n, d.then) for n, (_, d) in zip(names, decided, strict=True)]
            )
        if first is not False:
            head = f"if ({text})" if first else "else"
            rows = [(n, d.otherwise) for n, (_, d) in zip(names, decided, strict=True)]
            self._side(batch, head, branch.otherwise, rows)
        for (item, _), name in zip(decided, names, strict=True):
            batch.texts[id(item)] = self._name(item, self._local(name))

    def _value(self, batch: Batch, side: Expr | bool, kind: str) -> str:
        if isinstance(side, bool):
            return "true" if side else "false"
        return self._stored(batch.texts[id(side)][0], kind)

    def _side(self, batch: Batch, head: str, found: Sequence[Step], rows: Sequence[tuple[str, Expr | bool]]) -> None:
        """One side of a branch, which gives each variable its value."""
        chosen = {id(item) for step in found if isinstance(step, Branch) for item in step.chosen}
        for name, side in rows:
            if isinstance(side, Expr) and id(side) in chosen and batch.uses[id(side)] == 1:
                batch.given[id(side)] = name
        with self._within(), self.writer.side(head):
            self._steps(batch, found)
            for name, side in rows:
                value = self._value(batch, side, side.kind if isinstance(side, Expr) else "bool")
                if value != name:
                    self.writer.line(f"{name} = {value};")


def _loaded(side: Expr | bool) -> bool:
    return isinstance(side, Expr) and side.op in ("input", "state", "param")
