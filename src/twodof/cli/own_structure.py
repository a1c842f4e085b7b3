"""A structure and a record that the command line names: FILE.py:NAME or a diagram, and columns of any table."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import NamedTuple, Self

from twodof.blocks.diagram import Diagram
from twodof.errors import LogError, ParameterError, listed, nearest, shown
from twodof.flight.starters import load_diagram
from twodof.flightlog.files import read_columns, read_log
from twodof.flightlog.log import FlightLog
from twodof.identify.record import Record
from twodof.models.structure import Structure

_LOCAL = ("_0", "_trim", "_bias")


class NamedColumns(NamedTuple):
    """Inputs and outputs of a model that is named by kind and orders, as `--input` and `--output` name them."""

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @classmethod
    def of(cls, model: str, inputs: Sequence[str], outputs: Sequence[str]) -> Self:
        """Return the names before "=". Raises ParameterError without an input or an output."""
        ins, outs = (tuple(one.partition("=")[0] for one in given) for given in (inputs, outputs))
        if not ins or not outs:
            option = "--output" if ins else "--input"
            raise ParameterError(f"which column is the {option[2:]} of {shown(model)}?", option, f"add {option} COLUMN")
        return cls(model, ins, outs)


def read_structure(source: str, estimate: Sequence[str] = ()) -> Structure:
    """Return the structure that `source` names: FILE.py:NAME, whose code is run, or a diagram in JSON.

    NAME is a `Structure`, a `Diagram`, or a function without arguments that gives one; it may be left out where the
    file has one structure. Of a diagram all real parameters are estimated, or those in `estimate`; names that end in
    _0, _trim or _bias belong to one record. Raises ParameterError for a file that cannot be read or run, and for a name
    that is not there or is something else; DiagramError as `load_diagram`.
    """
    path, colon, name = source.rpartition(":")
    if not colon or not path.endswith(".py"):
        path, name = source, ""
    if path.endswith(".py"):
        return _of(_named(_run(Path(path)), name, path), source, estimate)
    return _of(load_diagram(Path(path)), source, estimate)


def own_record(
    path: Path,
    structure: Structure | NamedColumns,
    inputs: Sequence[str],
    outputs: Sequence[str],
    clock: Mapping[str, str],
    window: tuple[float, float] | None,
    hold: Sequence[str] = (),
) -> Record:
    """Return the record of a table or log: `inputs` and `outputs` are NAME=COLUMN, or a name that both share.

    `clock` has the arguments `time` and `period` of `read_columns`; it is empty for a log. The inputs that are not
    named are the structure's own; so are the outputs, as far as the table has them. Raises
    ParameterError for a name that the structure lacks, LogError for a column that the table lacks.
    """
    ins = _pairs(inputs, structure.inputs, "--input", structure)
    ins = {name: ins.get(name, name) for name in structure.inputs}
    outs = _pairs(outputs, structure.outputs, "--output", structure)
    held = _pairs(hold, structure.inputs, "--hold", structure)
    log = read_columns(path, **clock) if clock else read_log(path)
    outs = outs or {name: name for name in structure.outputs if name in log}
    if not outs:
        what = f"has no column named as an output of the structure ({', '.join(structure.outputs)})"
        remedy = f"say which one it is: --output {structure.outputs[0]}=COLUMN; there are: {listed(log.channels)}"
        raise LogError(what, log.source, remedy)
    for name, column in (*ins.items(), *outs.items()):
        _check_column(log, column, f"name it: {'--input' if name in ins else '--output'} {name}=COLUMN")
    start, stop = window or _span(log, [*ins.values(), *outs.values()])
    return Record.from_log(log, ins, outs, start, stop, hold=held)


def with_reference(record: Record, path: Path, clock: Mapping[str, str], column: str) -> Record:
    """Return the record with one more input, `column` of its log or table, held from step to step.

    Raises LogError for a column that is not there, or has no sample when the record begins.
    """
    if column in record.inputs:
        return record
    log = read_columns(path, **clock) if clock else read_log(path)
    _check_column(log, column, "name it: --reference COLUMN")
    held = log.resample(column, record.time + 0.5 * record.dt)
    if held.ndim != 1:
        raise LogError(f"{column!r:.80} has {held.shape[1]} columns", log.source, "name a column with one number a row")
    return replace(record, inputs={**record.inputs, column: held})


def _check_column(log: FlightLog, column: str, remedy: str) -> None:
    """Raise LogError for a column that is not there."""
    if column not in log:
        known, ignored = nearest(column, log.channels), log.provenance.get("ignored")
        if held := [one for one in ignored or () if one.startswith(f"{column} (")]:
            remedy = "write numbers only, and leave a cell empty where there is no sample"
            raise LogError(f"a column is not of numbers: {held[0]}", log.source, remedy)
        others = f"; not a channel: {listed(ignored)}" if ignored else ""
        raise LogError(f"has no column {shown(column)}", log.source, f"{remedy}; there are: {known}{others}")


def _span(log: FlightLog, columns: Sequence[str]) -> tuple[float, float]:
    """Return the time span that all columns cover. Raises LogError."""
    times = [log[column].time for column in columns]
    if not all(time.size for time in times):
        raise LogError("a column is empty", log.source, f"of {', '.join(columns)}; name others")
    return max(float(time[0]) for time in times), min(float(time[-1]) for time in times)


def _pairs(
    given: Sequence[str], known: Sequence[str], option: str, structure: Structure | NamedColumns
) -> dict[str, str]:
    found: dict[str, str] = {}
    for one in given:
        name, sign, column = one.partition("=")
        if not sign and option == "--hold":
            raise ParameterError(f"{shown(one)} names no hold", option, f"write {known[0]}=linear")
        column = column if sign else name
        if name not in known:
            noun = "output" if option == "--output" else "input"
            remedy = f"write NAME={'linear' if option == '--hold' else 'COLUMN'}; the structure has: {', '.join(known)}"
            raise ParameterError(f"the structure '{structure.name}' has no {noun} {shown(name)}", option, remedy)
        if name in found:
            raise ParameterError(f"{name!r:.80} is named twice", option, "name each once")
        found[name] = column
    return found


def _of(thing: object, source: str, estimate: Sequence[str]) -> Structure:
    if callable(thing) and not isinstance(thing, (Structure, Diagram)):
        try:
            thing = thing()
        except Exception as reason:
            raise ParameterError(f"{source} raised {reason!r:.200}", "--structure", "mend it") from reason
    if isinstance(thing, Structure):
        return thing
    if not isinstance(thing, Diagram):
        remedy = "name a twodof.models.Structure, a Diagram, or a function that gives one"
        raise ParameterError(f"a {type(thing).__name__} is not a structure", f"--structure {source}", remedy)
    real = tuple(name for name, param in thing.params.items() if param.kind == "real" and param.width is None)
    if not real:
        remedy = "give it parameters with `Diagram.param`: they are what is estimated"
        raise ParameterError(f"the diagram '{thing.name}' has no real parameter", f"--structure {source}", remedy)
    wanted = tuple(name for name in estimate if name in real) or real
    return Structure(thing, wanted, local=tuple(name for name in real if name.endswith(_LOCAL)))


def _run(path: Path) -> ModuleType:
    where = f"--structure {path}"
    try:
        text = path.read_bytes()
    except (OSError, ValueError) as reason:
        raise ParameterError(f"cannot be read: {reason}", where, "name a Python file, as model.py:motor") from reason
    module = ModuleType(path.stem)
    module.__file__ = str(path)
    # What stands beside the file can be imported, as if Python ran it.
    folder = str(path.resolve().parent)
    sys.path.insert(0, folder)
    try:
        exec(compile(text, str(path), "exec"), module.__dict__)  # the user's own file, by his own word
    except Exception as reason:
        raise ParameterError(f"raised {reason!r:.200}", where, "mend it; Python runs the whole file") from reason
    except SystemExit as reason:
        raise ParameterError(
            "ended the program", where, 'put what is run behind `if __name__ == "__main__":`'
        ) from reason
    finally:
        sys.path.remove(folder)
    return module


def _named(module: ModuleType, name: str, path: str) -> object:
    things = {key: value for key, value in vars(module).items() if not key.startswith("_")}
    if name:
        if name not in things:
            raise ParameterError(f"has no {shown(name)}", f"--structure {path}", f"it has: {nearest(name, things)}")
        return things[name]
    own: dict[str, object] = {key: value for key, value in things.items() if isinstance(value, Structure)}
    own = own or {key: value for key, value in things.items() if isinstance(value, Diagram)}
    if len(own) != 1:
        raise ParameterError(
            f"holds {len(own)} structures and diagrams: {listed(own)}", f"--structure {path}", f"name one: {path}:NAME"
        )
    return next(iter(own.values()))
