"""`twodof identify LOG --experiment ...`: a model from a flight log, by hand or by output error."""

import json as json_text
import math
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twodof.cli.output import Json, print_json, say_line, table_console
from twodof.errors import LogError, ParameterError
from twodof.flightlog.files import read_log
from twodof.flightlog.log import FlightLog
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import KINDS, cut, kind_of, only
from twodof.identify.greybox import fit
from twodof.identify.record import Record
from twodof.identify.repeated import Repeated, repeat
from twodof.identify.simple_pitch import SimplePitch, identify_pitch
from twodof.identify.simple_velocity import SimpleVelocity, identify_velocity
from twodof.models.structure import Structure
from twodof.models.structures import free_response, pitch_rate, rail, velocity
from twodof.report.characterisation.characterise import TRAVEL

app = typer.Typer(add_completion=False, rich_markup_mode=None)


# What the ready-made experiments of those kinds are called when they are flown.
_FLOWN_AS = {"velocity-doublet": "velocity"}
_KNOWN = (*KINDS, *_FLOWN_AS)

# What a free response tells and a doublet hardly does: it is over before the poles show.
_SWING = ("w_n", "xi", "coulomb", "hardening")


class Method(StrEnum):
    """How to identify."""

    greybox = "grey-box"
    simple = "simple"


class Model(StrEnum):
    """Ready-made structures for the grey-box method; `velocity` is the paper's, between on-board estimates."""

    auto = "auto"
    pitch_rate = "pitch-rate"
    pitch_rate_lag = "pitch-rate-lag"
    free_response = "free-response"
    velocity = "velocity"
    rail = "rail"


@app.command()
def identify(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG", help="The flight log to identify from; several of one experiment: each, and their spread."
        ),
    ],
    experiment: Annotated[
        str | None,
        typer.Option(
            metavar="|".join(_KNOWN), help="Which experiment the log holds; left out: what the log says or looks like."
        ),
    ] = None,
    method: Annotated[Method, typer.Option(help="Output error, or by hand as the paper does.")] = Method.greybox,
    model: Annotated[Model, typer.Option(help="Structure for the grey-box method; auto: the paper's.")] = Model.auto,
    window: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="T0 T1", help="Stretch of the log, in seconds; default: found."),
    ] = None,
    estimate: Annotated[list[str] | None, typer.Option(help="Unknown to estimate; repeat for several.")] = None,
    value: Annotated[
        list[str] | None, typer.Option(metavar="NAME=NUMBER", help="First guess, or fixed value; repeatable.")
    ] = None,
    validate: Annotated[list[Path] | None, typer.Option(metavar="LOG", help="Log to validate on; repeatable.")] = None,
    impulse: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG", help="Of a doublet: the impulse's log, from which the poles come; by hand it is needed."
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Identify the paper's models from a log; the result has standard deviations, fits and residual tests.

    What a doublet's log does not show is held with --impulse LOG: the poles, found from the free response. One flight
    knows nothing of what differs from flight to flight: give several logs and believe their spread.

    Exit status 1: the data do not allow the estimate, or the search did not converge.
    """
    logs = [read_log(path) for path in files]
    kinds = [_experiment(experiment, log) for log in logs]
    asked = kinds[0]
    if experiment is None and "experiment" not in logs[0].provenance:
        say_line(f"note: the log looks like the experiment '{asked}'; --experiment names another")
    _check_options(method, asked, model, estimate, value, impulse)
    _check_several(method, kinds, files, validate)
    kind = KINDS[asked]
    if window is not None:
        for log in logs:
            _check_window(log, window)
    records = [cut(log, kind, window) for log in logs]
    if len({record.name for record in records}) < len(records):  # run-1/doublet.mat run-2/doublet.mat
        records = [replace(record, name=str(path)) for record, path in zip(records, files, strict=True)]
    others = [cut(read_log(path), kind) for path in validate or []]
    free = None if impulse is None else cut(read_log(impulse), KINDS["impulse"])
    found: SimplePitch | SimpleVelocity | Estimate | Repeated
    if method is Method.simple:
        found = _by_hand(asked, records[0], others, free)
        converged = True
    else:
        found = _by_output_error(asked, model, records, others, estimate, _numbers(value or []), free)
        converged = found.converged
    text, document = found.table(), json_text.loads(found.to_json())
    if json:
        print_json({"experiment": asked, "method": method.value, **document})
    else:
        table_console().print(text)
    if not converged:
        say_line("note: the search did not converge; try other first guesses with --value")
        raise typer.Exit(1)


def _experiment(name: str | None, log: FlightLog) -> str:
    """The experiment that is asked for, else the one that the log names, else the one that is found in it.

    Raises ParameterError for an experiment that is not ours, LogError for a log in which none is found.
    """
    said = log.provenance.get("experiment") if name is None else name
    if not isinstance(said, str):
        said = kind_of(log).name
    if said not in _KNOWN:
        raise ParameterError(
            f"nothing is identified from {said!r:.80}",
            log.source if name is None else "--experiment",
            f"{'say what it is' if name is None else 'there are'}: --experiment {'|'.join(_KNOWN)}",
        )
    return _FLOWN_AS.get(said, said)


def _check_options(
    method: Method,
    experiment: str,
    model: Model,
    estimate: Sequence[str] | None,
    value: Sequence[str] | None,
    impulse: Path | None,
) -> None:
    """Raises ParameterError for an option that the method or the experiment has no use for: it would do nothing."""
    if method is Method.simple:
        given = {"--model": model is not Model.auto, "--estimate": estimate, "--value": value}
        if idle := [name for name, there in given.items() if there]:
            raise ParameterError(
                "by hand everything is read off: it takes no structure, no guess and no value to hold",
                " ".join(idle),
                "leave it out, or take --method grey-box",
            )
    if impulse is not None and experiment != "doublet":
        raise ParameterError(
            "the impulse's log is of use to a doublet only",
            f"--impulse, --experiment {experiment}",
            "leave it out, or give it with --experiment doublet",
        )


def _check_several(
    method: Method, kinds: Sequence[str], files: Sequence[Path], validate: Sequence[Path] | None
) -> None:
    """Raises ParameterError for several logs that are not repetitions of one experiment, or cannot be treated so."""
    if len(kinds) == 1:
        return
    where = " ".join(map(str, files))[:200]
    if len(set(kinds)) > 1:
        raise ParameterError(
            f"these are logs of different experiments: {', '.join(sorted(set(kinds)))}",
            where,
            "give one kind at a time",
        )
    if len({path.resolve() for path in files}) < len(files):
        raise ParameterError("a log is named twice: its spread with itself is 0", where, "name each once")
    if method is Method.simple:
        raise ParameterError("by hand one log is read", where, "give one, and further doublets with --validate")
    if validate:
        raise ParameterError(
            "several logs are compared with each other", "--validate", "leave it out, or identify from one log"
        )


def _check_window(log: FlightLog, window: tuple[float, float]) -> None:
    """Raises LogError for a window that is none, or that holds nothing of the log."""
    if not all(map(math.isfinite, window)):
        raise LogError(f"window {window[0]:g} to {window[1]:g} s", log.source, "give finite times, in seconds")
    log.slice(*window)


def _by_hand(
    experiment: str, record: Record, others: Sequence[Record], free: Record | None
) -> SimplePitch | SimpleVelocity:
    if experiment == "velocity":
        return identify_velocity([record, *others])
    if experiment == "impulse":
        raise ParameterError(
            "by hand, the impulse gives only the poles",
            "--method simple",
            "call it with the doublet's log, --experiment doublet and --impulse LOG",
        )
    if free is None:
        raise typer.BadParameter("a doublet by hand needs --impulse LOG: the poles come from the free response")
    return identify_pitch(free, [record, *others])


def _by_output_error(
    experiment: str,
    model: Model,
    records: Sequence[Record],
    others: Sequence[Record],
    estimate: Sequence[str] | None,
    values: dict[str, float],
    free: Record | None,
) -> Estimate | Repeated:
    structure = _structure(experiment, model)
    _check_request(structure, experiment, model, estimate or (), values)
    wanted = tuple(estimate) if estimate else None
    if free is not None:
        swing = fit(structure, free, values=values)
        held = {name: swing[name] for name in _SWING if name in swing.labels and name not in (estimate or ())}
        values = {**held, **values}
        wanted = wanted or tuple(name for name in structure.estimate if name not in held)
    if experiment == "velocity":
        # From the on-board pitch to the on-board velocity, as in the paper, or from the gyro to the range sensor.
        output = "v" if model is Model.velocity else "x"
        records, others = [only(one, output) for one in records], [only(other, output) for other in others]
        wanted = (*TRAVEL, "q_trim") if wanted is None and output == "x" else wanted
    if len(records) > 1:
        return repeat(structure, records, estimate=wanted, values=values)
    return fit(structure, records[0], estimate=wanted, values=values, validation=others)


def _check_request(
    structure: Structure, experiment: str, model: Model, estimate: Sequence[str], values: dict[str, float]
) -> None:
    """Raises ParameterError for a model of another experiment, a wrong unknown, or a value out of its bounds."""
    kind = KINDS[experiment]
    if not set(structure.inputs) <= set(kind.inputs):
        raise ParameterError(
            f"this model is driven by {', '.join(structure.inputs)}, the experiment by {', '.join(kind.inputs)}",
            f"--model {model.value} --experiment {experiment}",
            "leave --model out",
        )
    unknowns = structure.unknowns
    for option, names in (("--estimate", estimate), ("--value", values)):
        for name in names:
            if name not in unknowns:
                raise ParameterError(f"no unknown {name!r}", option, f"there are: {', '.join(unknowns)}")
    for name, number in values.items():
        low, high = unknowns[name].lower, unknowns[name].upper
        if not (math.isfinite(number) and low <= number <= high):
            raise ParameterError(f"{number:g} is out of bounds", f"--value {name}", f"{low:g} to {high:g} is possible")


def _structure(experiment: str, model: Model) -> Structure:
    match model:
        case Model.auto:
            return rail(thrust=True) if experiment == "velocity" else pitch_rate()
        case Model.pitch_rate | Model.pitch_rate_lag:
            return pitch_rate(lag=model is Model.pitch_rate_lag)
        case Model.free_response:
            return free_response()
        case Model.velocity:
            return velocity()
        case Model.rail:
            return rail()


def _numbers(pairs: Sequence[str]) -> dict[str, float]:
    found = {}
    for pair in pairs:
        name, sign, number = pair.partition("=")
        try:
            found[name] = float(number)
        except ValueError:
            sign = ""
        if not sign:
            raise typer.BadParameter(f"{pair!r} is not NAME=NUMBER")
    return found
