"""The README of an exported module."""

from collections.abc import Iterable, Sequence

from twodof.compile.px4.airframe import airframe_file, airframe_id
from twodof.compile.px4.checkout.versions import COMPILED, TESTED
from twodof.compile.px4.message import FAULTS, HEAD, MessageFields
from twodof.compile.px4.names import ModuleNames, harmless
from twodof.compile.px4.parameters import ExportedParameter, KeptParameter, number
from twodof.compile.px4.template_files import fill
from twodof.compile.px4.topics import INPUTS, OUTPUTS, ModuleRole


def readme(
    names: ModuleNames,
    role: ModuleRole,
    found: MessageFields,
    rows: Sequence[ExportedParameter],
    kept: Sequence[KeptParameter],
    text: str,
) -> str:
    """What to do with the tree, what the module reads and writes, its parameters, and what it does when in doubt."""
    inputs = [
        (f"`{f.path}`", f.unit or "-", _cell(", ".join(INPUTS[f.path].topics)), _cell(INPUTS[f.path].text))
        for f in found.inputs
    ]
    signals = (*found.inputs, *found.outputs)
    fields = [(f"`{name}`", _cell(text)) for _, name, text in HEAD]
    fields += [(f"`{f.name}`", _cell(f.described)) for f in signals]
    faults = [(str(bit), name, _cell(text)) for bit, name, text in FAULTS]
    return fill(
        "readme.md",
        names,
        about=f"{_cell(text)}\n\n" if text else "",
        airframe=airframe_file(names),
        airframe_id=airframe_id(names),
        stops=", ".join(f"`{s}`" for s in role.stops),
        safe=role.commanding.safe,
        inputs=_table(("input", "unit", "topic", "what"), inputs),
        outputs=_table(("output", "where"), [(f"`{name}`", _cell(OUTPUTS[name])) for name in role.outputs]),
        writes=", ".join(f"`{t}`" for t in role.writes),
        commanded=role.commanding.when,
        fields=_table(("field", "what"), fields),
        parameters=_parameters(rows),
        kept=_kept(kept),
        faults=_table(("bit", "fault", "what"), faults),
        input_words=sum(f.words for f in found.inputs),
        output_words=sum(f.words for f in found.outputs),
        tested=TESTED,
        compiled=", ".join(COMPILED),
    )


def _cell(text: str) -> str:
    return harmless(text, 300).replace("|", "/").replace("<", "(").replace("_", "\\_")


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [" | ".join(head), " | ".join("---" for _ in head), *(" | ".join(row) for row in rows)]
    return "".join(f"| {line} |\n" for line in lines)


def _parameters(rows: Sequence[ExportedParameter]) -> str:
    table = [
        (
            str(i),
            f"`{r.name}`",
            f"`{r.place}`" if r.place else "-",
            number(r.default, r.kind),
            r.bounds,
            _cell(r.unit) or "-",
            _cell(r.text) + (" (read at the start)" if r.fixed else ""),
        )
        for i, r in enumerate(rows)
    ]
    return _table(("place", "PX4", "diagram", "default", "bounds", "unit", "what"), table)


def _kept(kept: Sequence[KeptParameter]) -> str:
    if not kept:
        return ""
    rows = "".join(f"- `{k.path}`: {k.reason}\n" for k in kept)
    return f"\nThese are not parameters of PX4 and keep the diagram's defaults:\n\n{rows}"
