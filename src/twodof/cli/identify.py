"""`twodof identify LOG --experiment ...`: a model from a flight log, by hand or by output error."""

import importlib
import json as json_text
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from twodof.cli.options import Force, Json, argument, flag, option
from twodof.cli.output import exit_unless, one_line, print_result, say_line
from twodof.cli.own_structure import NamedColumns, own_record, read_structure, with_reference
from twodof.errors import DiagramError, IdentificationError, LogError, ParameterError, listed
from twodof.flightlog.atomic import check_free, write_text
from twodof.flightlog.files import read_log
from twodof.flightlog.log import FlightLog
from twodof.identify.disturbance.disturbance_model import Disturbance
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import KINDS, cut, kind_of
from twodof.identify.greybox import fit, named_model
from twodof.identify.ready_made import (
    AUTO,
    FLOWN_AS,
    NOT_BY_HAND,
    STRUCTURES,
    by_hand,
    by_output_error,
    machine_of,
    structure_for,
)
from twodof.identify.record import HOLDS, Record
from twodof.identify.record import merge as combine
from twodof.identify.repeated import Repeated, repeat
from twodof.identify.simple_pitch import SimplePitch
from twodof.identify.simple_velocity import SimpleVelocity
from twodof.identify.simulation import compare as compare_models
from twodof.models.polynomial import FORMS, PolynomialModel, is_named
from twodof.models.structure import Structure
from twodof.report.plots.flight_view import SUFFIXES, check_place

_KNOWN = (*KINDS, *FLOWN_AS)


FitMethod = Literal["grey-box", "simple"]


def identify(
    files: Annotated[
        list[Path],
        argument("The flight log to identify from; several of one experiment: each, and their spread.", "LOG"),
    ],
    experiment: Annotated[
        str | None,
        option(
            "What the log holds (attitude: the pitch in closed loop), or the name that it was flown under; "
            "by default found in the log.",
            "|".join(KINDS),
        ),
    ] = None,
    method: Annotated[FitMethod, option("grey-box: output error; simple: by hand, as in the paper.")] = "grey-box",
    model: Annotated[
        str,
        option(
            f"Structure: {', '.join((AUTO, *STRUCTURES))} (auto: the paper's, for an impulse with friction if the rig "
            f"has it); or one of the columns in --input and --output: {', '.join(FORMS)} (numbers of several inputs: "
            "2/1)."
        ),
    ] = AUTO,
    window: Annotated[
        tuple[float, float] | None, option("Part of the log to use [s]; default: found in the log.", "T0 T1")
    ] = None,
    estimate: Annotated[list[str] | None, option("Unknown to estimate; repeat for several.")] = None,
    value: Annotated[list[str] | None, option("First guess, or fixed value; repeatable.", "NAME=NUMBER")] = None,
    prior: Annotated[
        list[str] | None,
        option(
            "Prior of an unknown: mean and standard deviation; inf for no knowledge. Repeatable.", "NAME=MEAN,SIGMA"
        ),
    ] = None,
    validate: Annotated[list[Path] | None, option("Log to validate on; repeatable.", "LOG")] = None,
    impulse: Annotated[
        Path | None,
        option("For a doublet: the impulse's log, with the poles at rest; needed with --method simple.", "LOG"),
    ] = None,
    structure: Annotated[
        str | None,
        option("Your own structure: a Structure or Diagram in Python, or a diagram.", "FILE.py:NAME|FILE.json"),
    ] = None,
    input: Annotated[
        list[str] | None, option("Column for this input of the structure; repeatable.", "NAME=COLUMN")
    ] = None,
    output: Annotated[
        list[str] | None, option("Column for this output of the structure; repeatable.", "NAME=COLUMN")
    ] = None,
    time: Annotated[str | None, option("Time column of a table (CSV, Parquet, .mat).", "COLUMN")] = None,
    period: Annotated[
        str | None,
        option(
            "For a table without time stamps: its sample time, or the name of the entry that holds it.", "SECONDS|NAME"
        ),
    ] = None,
    hold: Annotated[
        list[str] | None, option("Behaviour of this input between samples; repeatable.", f"NAME={'|'.join(HOLDS)}")
    ] = None,
    detrend: Annotated[bool, flag("Subtract the mean of each column.", "--detrend")] = False,
    detrend_line: Annotated[
        bool, flag("Subtract the straight line through each column, as of a sensor that drifts.", "--detrend-line")
    ] = False,
    resample: Annotated[
        float | None, option("Resample to this longer step, after a low-pass filter.", "SECONDS")
    ] = None,
    merge: Annotated[bool, flag("With several logs: fit one model to all, not one to each.", "--merge")] = False,
    compare: Annotated[
        list[str] | None, option("Another model of the columns, to compare on --validate or else on LOG.", "MODEL")
    ] = None,
    plot: Annotated[
        Path | None, option(f"Draw data, model, residuals, Bode and uncertainty ({', '.join(SUFFIXES)}).", "FILE")
    ] = None,
    reference: Annotated[
        str | None,
        option("For a plot in closed loop: the set-point that excited it (theta0), for the Bode plot.", "COLUMN"),
    ] = None,
    out: Annotated[Path | None, option("Write the model to this file as JSON, for `twodof design`.", "FILE")] = None,
    disturbance: Annotated[
        Disturbance,
        option(
            "White: output error; ar: coloured noise; input: gusts; walk: pushes at the states; innovation: predictor; "
            "auto: chosen from the data."
        ),
    ] = "auto",
    json: Json = False,
    force: Force = False,
) -> None:
    """Identify the paper's models from a log, or your own from any table, with standard deviations and residual tests.

    A doublet's log hardly shows the poles. They have a prior, or are held at those of --impulse LOG, the free response,
    on a rig that swings alike with its rotors running. One flight cannot show how much the
    parameters differ from flight to flight: give several logs and trust their spread.

    Your own: --structure model.py:motor --input u=voltage --output y=speed --time t (or --period 0.02).
    Without a structure: --model bj:2,1,1,2,1 --input u=voltage --output y=speed --time t --compare arx:2,2,1.

    Exit status 1: the data do not allow the estimate, or the search did not converge.
    """
    simple, several = method == "simple", len(files) > 1
    twice = len({path.resolve() for path in files}) < len(files)
    named = " ".join(map(str, files))[:200]
    _refuse(
        (plot and simple, "by hand there is nothing to draw", "--plot", "take --method grey-box, or leave it out"),
        (plot and several and not merge, "a plot shows the fit of one log", "--plot", "give one log, or leave it out"),
        (reference and not plot, "it is of use to a plot only", "--reference", "add --plot FILE, or leave it out"),
        (twice, "a log is named twice: its spread with itself is 0", named, "name each once"),
        (several and simple, "by hand one log is read", named, "give one, and further doublets with --validate"),
        (
            several and validate and not merge,
            "several logs are compared with each other",
            "--validate",
            "give one log, leave it out, or add --merge",
        ),
    )
    if out is not None:
        check_free(out, force)
    if plot is not None:
        check_place(plot, force)
    numbers = {name: one for name, (one,) in _numbers(value or [], "NAME=NUMBER").items()}
    before = {name: (mean, width) for name, (mean, width) in _numbers(prior or [], "NAME=MEAN,SIGMA").items()}
    clock = {name: column for name, column in (("time", time), ("period", period)) if column is not None}
    prepared = _given(
        detrend=detrend, detrend_line=detrend_line, resample=resample is not None, merge=merge, compare=compare
    )
    if structure is not None or input or output or clock or hold or prepared or is_named(model):
        both = structure is not None and model != AUTO
        idle = _given(experiment=experiment is not None, method=simple, impulse=impulse is not None, model=both)
        structures = "name your own, --structure model.py:NAME, or a ready-made one, --model pitch-rate or arx:2,2,1"
        unknown, these = structure is None and model == AUTO, "--input, --output, --time, --period, --hold"
        _refuse(
            (idle, "columns that you name are fitted to a structure, not read as an experiment", idle, "leave it out"),
            (unknown, "which structure is to be fitted to these columns?", prepared or these, structures),
            (compare and several and not merge, "several logs give several models", "--compare", "add --merge"),
            (merge and not several, "there is one log", "--merge", "give several, or leave it out"),
        )
        columns = _columns(structure, model, estimate or (), input or (), output or ())
        if isinstance(columns, Structure):
            _check_unknowns(columns, estimate or (), numbers, before)

        def read(path: Path) -> Record:
            record = own_record(path, columns, input or (), output or (), clock, window, hold or ())
            record = record.detrend(linear=detrend_line) if detrend or detrend_line else record
            return record if resample is None else record.resample(resample)

        records, others = _distinctly_named([read(path) for path in files], files), [*map(read, validate or ())]
        shape = columns if isinstance(columns, Structure) else named_model(model, records[0])
        wanted = estimate and [*estimate, *(name for name in before if name not in estimate)]
        options: dict[str, Any] = {"estimate": wanted, "values": numbers, "disturbance": disturbance, "prior": before}
        own: Estimate | Repeated = (
            repeat(shape, records, **options)
            if several and not merge
            else fit(shape, combine(*records), validation=others, **options)
        )
        about, tables = {"method": method, **_linear(own, records[0])}, [own.table()]
        if compare and isinstance(own, Estimate):
            models: dict[str, Any] = {model if is_named(model) else own.structure: own}
            for name in compare:
                other = named_model(name, records[0])
                try:
                    models[name] = fit(other, records)
                except IdentificationError as refusal:
                    say_line(f"note: {name} is left out: {one_line(refusal)}")
            table = compare_models(models, others or records)
            about["compared"] = table.to_json()
            tables.append(table.table())
            if not others:
                say_line("note: the models are compared on the data of their fit; give fresh data with --validate")
        drawn = records if reference is None else [with_reference(records[0], files[0], clock, reference)]
        _draw(own, shape, [*drawn, *others], plot, force, reference)
        _say(own, about, tables, out, json)
        return
    logs = [read_log(path) for path in files]
    kinds = [_experiment(experiment, log) for log in logs]
    asked = kinds[0]
    if experiment is None and "experiment" not in logs[0].provenance:
        say_line(f"note: the log looks like the experiment '{asked}'; --experiment names another")
    read_off = _given(
        model=model != AUTO, estimate=estimate, value=value, prior=prior, disturbance=disturbance != "auto"
    )
    hand, grey = asked if simple else "", "leave it out, or take --method grey-box"
    poles = impulse is not None and asked != "doublet"
    _refuse(
        (simple and read_off, "by hand it takes no structure, no guess and no value to hold", read_off, grey),
        (poles, "it is of use to a doublet only", "--impulse", "give it with --experiment doublet"),
        (len(set(kinds)) > 1, f"logs of different experiments: {listed(sorted(set(kinds)))}", named, "give one kind"),
        (hand == "impulse", "by hand, the impulse gives only the poles", "--method simple", "give a doublet's log too"),
        (hand == "attitude", NOT_BY_HAND, "--method simple", grey),
        (hand == "doublet" and not impulse, "by hand a doublet needs the poles", "--method simple", "add --impulse"),
    )
    kind = KINDS[asked]
    if window is not None:
        if not all(map(math.isfinite, window)):
            raise LogError(
                f"the window {window[0]:g} to {window[1]:g} s is not finite", named, "give two times in seconds"
            )
        for log in logs:
            log.slice(*window)
    records = _distinctly_named([cut(log, kind, window) for log in logs], files)
    checks = [read_log(path) for path in validate or []]
    others = [cut(log, kind) for log in checks]
    free = None if impulse is None else cut(read_log(impulse), KINDS["impulse"])
    found: SimplePitch | SimpleVelocity | Estimate | Repeated
    about = {"experiment": asked, "method": method, "rig": machine_of(logs[0], 0.0, 0.0).rig}
    if simple:
        found = by_hand(asked, records[0], others, free)
    else:
        shape = structure_for(asked if model == AUTO else "", model)
        _refuse(
            (
                not set(shape.inputs) <= set(kind.inputs),
                f"this model is driven by {', '.join(shape.inputs)}, the experiment by {', '.join(kind.inputs)}",
                f"--model {model} --experiment {asked}",
                "leave --model out",
            )
        )
        _check_unknowns(shape, estimate or (), numbers, before)
        flown = zip([*logs, *checks], [*records, *others], strict=True)
        machines = [machine_of(log, one.start, float(one.time[-1])) for log, one in flown]
        found, records = by_output_error(
            asked, shape, records, others, estimate, numbers, free, disturbance, machines, before
        )
        if reference is not None:
            records = [with_reference(records[0], files[0], {}, reference), *records[1:]]
        _draw(found, shape, records, plot, force, reference)
    matrices = {} if simple or not (out or json) else _linear(found, records[0])
    _say(found, {**about, **matrices}, [found.table()], out, json)


def _refuse(*mistakes: tuple[object, str, str, str]) -> None:
    """Raise ParameterError for the first of the mistakes (made, what, where, remedy) that was made."""
    for made, what, where, remedy in mistakes:
        if made:
            raise ParameterError(what, where, remedy)


def _given(**options: object) -> str:
    """Return the names of the options that were given."""
    return " ".join(f"--{name.replace('_', '-')}" for name, there in options.items() if there)


def _say(
    found: SimplePitch | SimpleVelocity | Estimate | Repeated,
    about: dict[str, Any],
    tables: Sequence[str],
    out: Path | None,
    json: bool,
) -> None:
    """Write and print a model; exit status 1 if its search did not converge."""
    document = {**about, **json_text.loads(found.to_json())}
    if out is not None:
        write_text(out, json_text.dumps(document, allow_nan=False))
    print_result(json, document, tables)
    converged = not isinstance(found, Estimate | Repeated) or found.converged
    if not converged:
        say_line("note: the search did not converge; try other first guesses with --value")
    exit_unless(converged)


def _columns(
    structure: str | None, model: str, estimate: Sequence[str], inputs: Sequence[str], outputs: Sequence[str]
) -> Structure | NamedColumns:
    """Return the structure to fit to columns, or for a model that is named by its orders the columns alone."""
    if structure is not None:
        return read_structure(structure, estimate)
    return NamedColumns.of(model, inputs, outputs) if is_named(model) else structure_for("", model)


def _linear(found: object, record: Record) -> dict[str, Any]:
    """Return the model's matrices for commands that close a loop around it; none where it has no linear form."""
    if not isinstance(found, Estimate):
        return {}
    try:
        return {"linear": found.linear(record.dt).to_json()}
    except DiagramError:
        return {}


def _distinctly_named(records: Sequence[Record], files: Sequence[Path]) -> list[Record]:
    """Return the records with distinct names: run-1/doublet.mat and run-2/doublet.mat would share one."""
    if len({record.name for record in records}) == len(records):
        return list(records)
    return [replace(record, name=str(path)) for record, path in zip(records, files, strict=True)]


def _draw(
    found: Estimate | Repeated,
    structure: Structure | PolynomialModel,
    records: Sequence[Record],
    path: Path | None,
    force: bool,
    reference: str | None,
) -> None:
    """Draw the fit of one log, importing matplotlib only now; nothing without a `path`."""
    if path is not None and isinstance(found, Estimate):
        drawing = importlib.import_module("twodof.report.plots.identification_plot")
        drawing.write_identification_plot(found, structure, records, path, force, reference=reference or "")


def _experiment(name: str | None, log: FlightLog) -> str:
    """Return the experiment that the option names, else the log's own name, else the one found in its signals.

    Raises ParameterError for an experiment that is not ours, LogError for a log in which none is found.
    """
    said = log.provenance.get("experiment") if name is None else name
    if not isinstance(said, str):
        said = kind_of(log).name
    if said not in _KNOWN:
        what = f"nothing is identified from {said!r:.80}"
        remedy = f"{'say what it is' if name is None else 'there are'}: --experiment {'|'.join(_KNOWN)}"
        raise ParameterError(what, log.source if name is None else "--experiment", remedy)
    return FLOWN_AS.get(said, said)


def _check_unknowns(
    structure: Structure, estimate: Sequence[str], values: dict[str, float], prior: dict[str, tuple[float, float]]
) -> None:
    """Raise ParameterError for a wrong unknown or a value out of bounds."""
    unknowns = structure.unknowns
    for where, names in (("--estimate", estimate), ("--value", values), ("--prior", prior)):
        for name in names:
            if name not in unknowns:
                raise ParameterError(f"no unknown {name!r}", where, f"there are: {', '.join(unknowns)}")
    for name, number in values.items():
        low, high = unknowns[name].lower, unknowns[name].upper
        if not (math.isfinite(number) and low <= number <= high):
            raise ParameterError(f"{number:g} is out of bounds", f"--value {name}", f"{low:g} to {high:g} is possible")


def _numbers(pairs: Sequence[str], form: str) -> dict[str, list[float]]:
    """Return the numbers of each "NAME=NUMBER,..." as many as `form` has. Raises BadParameter."""
    found = {}
    for pair in pairs:
        name, _, numbers = pair.partition("=")
        try:
            found[name] = [float(number) for number in numbers.split(",")]
        except ValueError:
            found[name] = []
        if len(found[name]) != form.count(",") + 1:
            raise typer.BadParameter(f"{pair!r} is not {form}")
    return found
