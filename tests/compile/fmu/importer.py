"""An FMU as an importer sees it: fmpy reads its description, loads its binary and calls its functions."""

import itertools
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pytest
from numpy.typing import NDArray

fmpy = pytest.importorskip("fmpy", reason="fmpy is missing: `make .venv/ready-dev`, or pip install fmpy")
from fmpy.fmi2 import FMU2Slave  # noqa: E402 - there only if fmpy is
from fmpy.fmi3 import FMU3Slave  # noqa: E402

COUNTER = itertools.count()
FMI_TYPES = {"Real": "float64", "Integer": "int32", "Boolean": "bool"}


class Imported:
    """One instance of the FMU in `file`, past its initialization with `parameters`; values by name, as flat arrays."""

    def __init__(self, file: Path, parameters: Mapping[str, Any] | None = None, begin: bool = True) -> None:
        self.description = found = fmpy.read_model_description(str(file))
        folder = file.with_suffix("")
        if not folder.is_dir():
            fmpy.extract(str(file), str(folder))
        self.newer = found.fmiVersion == "3.0"
        self.variables = {v.name: v for v in found.modelVariables}
        self.messages: list[str] = []
        self.time = 0.0
        self.fmu: Any = (FMU3Slave if self.newer else FMU2Slave)(
            guid=found.guid if not self.newer else found.instantiationToken,
            unzipDirectory=str(folder),
            modelIdentifier=found.coSimulation.modelIdentifier,
            instanceName=f"instance-{next(COUNTER)}",
        )
        if self.newer:
            self.fmu.instantiate(logMessage=lambda _, status, category, text: self.messages.append(text.decode()))
        else:
            self.fmu.instantiate(loggingOn=True)
        for name, value in (parameters or {}).items():
            self.set(name, value)
        if begin:
            self.begin()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.fmu.freeInstance()

    def begin(self, start: float = 0.0) -> None:
        if self.newer:
            self.fmu.enterInitializationMode(startTime=start)
        else:
            self.fmu.setupExperiment(startTime=start)
            self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.time = start

    def names(self, causality: str) -> list[str]:
        return [name for name, v in self.variables.items() if v.causality == causality]

    def size(self, name: str) -> int:
        return int(np.prod([int(d.start) for d in self.variables[name].dimensions], dtype=int))

    def dtype(self, name: str) -> np.dtype[Any]:
        kind = self.variables[name].type
        return np.dtype(FMI_TYPES.get(kind, kind.lower()))

    def set(self, name: str, value: Any) -> None:
        v = self.variables[name]
        getattr(self.fmu, f"set{v.type}")([v.valueReference], np.ravel(value).tolist())

    def get(self, name: str) -> NDArray[Any]:
        v = self.variables[name]
        values = getattr(self.fmu, f"get{v.type}")([v.valueReference], *((self.size(name),) if self.newer else ()))
        return np.array(values, self.dtype(name))

    def step(self, size: float) -> None:
        self.fmu.doStep(self.time, size)
        self.time += size

    def run(self, steps: int, dt: float, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Make `steps` steps of `dt`; `columns` are inputs of the shape (steps, elements), and so are the outputs."""
        outputs = self.names("output")
        found: dict[str, list[Any]] = {name: [] for name in outputs}
        for k in range(steps):
            for name, column in columns.items():
                self.set(name, column[k])
            self.step(dt)
            for name in outputs:
                found[name].append(self.get(name))
        return {name: np.array(rows, self.dtype(name)) for name, rows in found.items()}
