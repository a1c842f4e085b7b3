"""`twodof identify LOG --experiment ...`: a model from a flight log, by hand or by output error."""

from __future__ import annotations

import json as json_text
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twodof.cli.output import Json, print_json, table_console
from twodof.errors import IdentificationError
from twodof.flightlog.files import read_log
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import KINDS, cut, only
from twodof.identify.greybox import fit
from twodof.identify.record import Record
from twodof.identify.simple_pitch import SimplePitch, identify_pitch
from twodof.identify.simple_velocity import SimpleVelocity, identify_velocity
from twodof.models.plant import PAPER_PITCH_RATE
from twodof.models.structure import Structure
from twodof.models.structures import free_response, pitch_rate, rail, velocity
from twodof.report.characterise import TRAVEL

app = typer.Typer(add_completion=False)


class Experiment(StrEnum):
    """The paper's experiments."""

    impulse = "impulse"
    doublet = "doublet"
    velocity = "velocity"


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
    file: Annotated[Path, typer.Argument(metavar="LOG", help="The flight log to identify from.")],
    experiment: Annotated[Experiment, typer.Option(help="Which experiment the log holds.")],
    method: Annotated[Method, typer.Option(help="Output error, or by hand as the paper does.")] = Method.greybox,
    model: Annotated[Model, typer.Option(help="Structure for the grey-box method; auto: the paper's.")] = Model.auto,
    window: Annotated[
        tuple[float, float] | None, typer.Option(metavar="T0 T1", help="Stretch of the log [s]; default: found.")
    ] = None,
    estimate: Annotated[list[str] | None, typer.Option(help="Unknown to estimate; repeat for several.")] = None,
    value: Annotated[
        list[str] | None, typer.Option(metavar="NAME=NUMBER", help="First guess, or fixed value; repeatable.")
    ] = None,
    validate: Annotated[list[Path] | None, typer.Option(metavar="LOG", help="Log to validate on; repeatable.")] = None,
    impulse: Annotated[
        Path | None, typer.Option(metavar="LOG", help="By hand, a doublet needs the impulse's log for the poles.")
    ] = None,
    json: Json = False,
) -> None:
    """Identify the paper's models from a log; the result has standard deviations, fits and residual tests."""
    kind = KINDS[experiment.value]
    record = cut(read_log(file), kind, window)
    others = [cut(read_log(path), kind) for path in validate or []]
    if method is Method.simple:
        result = _by_hand(experiment, record, others, impulse)
        text, document = result.table(), json_text.loads(result.to_json())
    else:
        found = _by_output_error(experiment, model, record, others, estimate, _numbers(value or []))
        text, document = found.table(), json_text.loads(found.to_json())
    if json:
        print_json({"experiment": experiment.value, "method": method.value, **document})
    else:
        table_console().print(text, markup=False)


def _by_hand(
    experiment: Experiment, record: Record, others: Sequence[Record], impulse: Path | None
) -> SimplePitch | SimpleVelocity:
    if experiment is Experiment.velocity:
        return identify_velocity([record, *others])
    if experiment is Experiment.impulse:
        raise IdentificationError(
            "by hand, the impulse gives only the poles",
            "identify",
            "call it with the doublet's log, --experiment doublet and --impulse LOG",
        )
    if impulse is None:
        raise typer.BadParameter("a doublet by hand needs --impulse LOG: the poles come from the free response")
    return identify_pitch(cut(read_log(impulse), KINDS["impulse"]), [record, *others])


def _by_output_error(
    experiment: Experiment,
    model: Model,
    record: Record,
    others: Sequence[Record],
    estimate: Sequence[str] | None,
    values: dict[str, float],
) -> Estimate:
    structure = _structure(experiment, model)
    wanted = tuple(estimate) if estimate else None
    if wanted is None and experiment is Experiment.doublet and model is Model.auto:
        # A doublet is over before the poles show: they are the caller's, or the paper's.
        wanted = ("mu", "tau", "M_trim", "q_0")
        values = {"w_n": PAPER_PITCH_RATE.w_n, "xi": PAPER_PITCH_RATE.xi, **values}
    if experiment is Experiment.velocity:
        # From the on-board pitch to the on-board velocity, as in the paper, or from the gyro to the range sensor.
        output = "v" if model is Model.velocity else "x"
        record, others = only(record, output), [only(other, output) for other in others]
        wanted = (*TRAVEL, "q_trim") if wanted is None and output == "x" else wanted
    return fit(structure, record, estimate=wanted, values=values, validation=others)


def _structure(experiment: Experiment, model: Model) -> Structure:
    made = {
        Model.pitch_rate: pitch_rate,
        Model.pitch_rate_lag: lambda: pitch_rate(lag=True),
        Model.free_response: free_response,
        Model.velocity: velocity,
        Model.rail: rail,
    }
    if model is Model.auto:
        return rail(thrust=True) if experiment is Experiment.velocity else pitch_rate()
    return made[model]()


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
