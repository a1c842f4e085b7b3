"""Several models beside each other on data that none of them was fitted to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError, shown
from twodof.identify.estimate import Estimate, finite
from twodof.identify.polynomial_fit import predict_polynomial
from twodof.identify.record import Record, check_record
from twodof.identify.simulation import predict_ahead, simulate
from twodof.identify.validate import fit_percent, rmse, vaf
from twodof.models.polynomial import PolynomialModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ComparedModel:
    """Figures of a model on an output of a record: FIT and VAF [%] and RMSE of the simulation, FIT one sample ahead."""

    model: str
    record: str
    output: str
    fit_percent: float
    vaf: float
    rmse: float
    ahead: float


@dataclass(frozen=True)
class ModelTable:
    """Figures of each model on each output and record; the models that simulate best come first."""

    rows: tuple[ComparedModel, ...]

    def table(self) -> str:
        """Return the figures as text for a terminal."""
        places = {(row.record, row.output) for row in self.rows}
        width = max(len(row.model) for row in self.rows) + 2
        lines = []
        for record, output in sorted(places):
            lines.append(f"{output} in '{record}'")
            lines.append(f"{'':{width}}{'FIT, %':>9}{'VAF, %':>9}{'RMSE':>12}{'FIT one sample ahead, %':>26}")
            lines += [
                f"{row.model:{width}}{row.fit_percent:9.2f}{row.vaf:9.2f}{row.rmse:12.4g}{row.ahead:26.2f}"
                for row in self.rows
                if (row.record, row.output) == (record, output)
            ]
        return "\n".join(lines)

    def to_json(self) -> list[dict[str, object]]:
        """Return the rows as plain values."""
        return [{**vars(row), "fit_percent": finite(row.fit_percent), "vaf": finite(row.vaf)} for row in self.rows]


def compare(models: Mapping[str, Estimate] | Sequence[Estimate], records: Record | Sequence[Record]) -> ModelTable:
    """Simulate and predict `records` with each of the fitted `models`, by name or by the names of their structures.

    The initial states are those with which the simulation follows a record best; all else is as it was fitted.
    Raises IdentificationError for no models, for anything but results of `fit`, and for a record without the channels.
    """
    named = dict(models) if isinstance(models, Mapping) else {_name(one): one for one in models}
    several = [records] if isinstance(records, Record) else list(records)
    if not named or len(named) < len(models):
        raise IdentificationError("no models, or two of one name", "compare", "give a dict of name and result of `fit`")
    rows = []
    for record in several:
        check_record(record)
        for name, found in named.items():
            for output, (simulated, ahead, first) in _outputs(found, record).items():
                y, fitted = record.outputs[output].value[first:], simulated[first:]
                ahead_fit = fit_percent(y, ahead[first:])
                figures = (fit_percent(y, fitted), vaf(y, fitted), rmse(y, fitted), ahead_fit)
                rows.append(ComparedModel(name, record.name, output, *figures))
    return ModelTable(tuple(sorted(rows, key=lambda row: -row.fit_percent)))


def _name(found: Estimate) -> str:
    return found.structure if isinstance(found, Estimate) else shown(found)


def _outputs(found: Estimate, record: Record) -> dict[str, tuple[Array, Array, int]]:
    """Return simulation, one-step prediction and first sample by output."""
    model = found.model if isinstance(found, Estimate) else None
    if model is None:
        raise IdentificationError(f"{shown(found)} is not a fitted model", "compare", "give results of `fit`")
    if isinstance(model, PolynomialModel):
        return {model.output: predict_polynomial(model, found.values, record)}
    free = record.steps if any(name.endswith("_0") for name in model.local) else None
    simulated = simulate(model, record, found, initial=free)
    ahead = predict_ahead(model, record, found, steps=1, initial=free)
    return {name: (simulated[name], ahead[name], 0) for name in simulated}
