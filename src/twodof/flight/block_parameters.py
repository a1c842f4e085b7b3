"""Parameters of the flight code's blocks, made from their rows in `twodof.parameters`."""

from typing import Any

from twodof.blocks import Param
from twodof.parameters import TUNABLES


def tunable(path: str, value: float | None = None) -> Param:
    """The parameter whose row is at `path` ("cascade.rate.kp"), with its default or another `value`."""
    row = TUNABLES[path]
    default = row.default if value is None else value
    unit = "" if row.unit == "-" else row.unit
    name = path.rpartition(".")[2]
    if isinstance(row.default, bool):
        return Param(name, default, "bool", unit=unit, text=row.text)
    kind = "int32" if isinstance(row.default, int) else "real"
    return Param(name, default, kind, unit=unit, low=row.low, high=row.high, text=row.text)


def tunables(block: str, *names: str, **values: Any) -> tuple[Param, ...]:
    """The parameters of a block of the flight code; `names` chooses some of its rows, `values` are other defaults."""
    prefix = f"{block}."
    own = [path.removeprefix(prefix) for path in TUNABLES if path.startswith(prefix)]
    return tuple(tunable(prefix + name, values.get(name)) for name in names or own)
