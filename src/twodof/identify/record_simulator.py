"""Running a structure on a record: compiled once for a step size, then a few microseconds for each set of values."""

import functools
import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from twodof.blocks.reference.interpreter import Reference
from twodof.compile import CompiledProgram, build
from twodof.compile.machine import CompiledMachine, Rerun
from twodof.compile.program.check import check
from twodof.errors import IdentificationError
from twodof.identify.record import Record
from twodof.models.structure import Structure

Array = NDArray[np.float64]

_AGREE = 0.1
"""Share of a step by which the stamps of samples that are taken once a step may jitter."""

_ON = 1e-6


class RecordSimulator:
    """One structure on one record: `run(values)` gives each measured output at the times of its samples."""

    def __init__(self, structure: Structure, record: Record) -> None:
        missing = [name for name in structure.inputs if name not in record.inputs]
        if missing:
            what = f"the structure's input '{missing[0]}' is not in the record"
            remedy = f"the record's inputs are: {', '.join(record.inputs)}"
            raise IdentificationError(what, f"structure '{structure.name}', record '{record.name}'", remedy)
        self.outputs = tuple(name for name in structure.outputs if name in record.outputs)
        if not self.outputs:
            what = f"none of the structure's outputs ({', '.join(structure.outputs)}) was measured"
            remedy = f"the record's outputs are: {', '.join(record.outputs)}"
            raise IdentificationError(what, f"structure '{structure.name}', record '{record.name}'", remedy)
        moving = any(record.hold_of(name) != "zoh" for name in structure.inputs)
        self._pieces = max(structure.substeps, LEAST_TICKS if moving else 1)
        self._machine = program_of(structure, record.dt, self._pieces).machine()
        self._values: dict[str, float] = {}
        self._steps = record.steps * self._pieces
        direct = _direct(structure) if moving else frozenset()
        self._inputs = {
            name: ticks(record.inputs[name], record.hold_of(name), self._pieces, name in direct)
            for name in structure.inputs
        }
        self._rerun: Rerun | None = None
        if isinstance(self._machine, CompiledMachine):
            self._rerun = Rerun(self._machine, self._steps, self._inputs, self.outputs)
        positions = {name: record.outputs[name].position for name in self.outputs}
        self._late = 0.0
        early = _common_fraction(np.concatenate(list(positions.values()))) if structure.delay else 0.0
        if early:
            # Linear interpolation would bend the response at each edge of the input: in closed loop, at every sample.
            self._late, self._unknown = early * record.dt, structure.unknowns[structure.delay]
            positions = {name: _on_steps(position + early) for name, position in positions.items()}
        self._at = {name: _sampler(position, record.steps) for name, position in positions.items()}

    def run(self, values: Mapping[str, float]) -> dict[str, Array]:
        """Return the outputs at their samples' times for `values`; other parameters keep their last value."""
        # Most runs of a Jacobian change one value.
        changed = {name: value for name, value in values.items() if self._values.get(name) != value}
        self._values |= changed
        if self._late:
            own = self._values.get(self._unknown.name, self._unknown.value)
            changed[self._unknown.name] = min(own + self._late, self._unknown.upper)
        if self._rerun is not None:
            simulated = self._rerun.run(changed)
        else:
            self._machine.reset()
            self._machine.set_many(changed)
            self._machine.reset()
            simulated = self._machine.run(self._steps, self._inputs)
        return {name: self._at[name](simulated[name][:: self._pieces]) for name in self.outputs}


def _common_fraction(position: Array) -> float:
    """By how much of a step all samples at `position` come before the next step, or 0 if they do not agree on it."""
    early = np.ceil(position) - position
    turn = np.exp(2j * np.pi * early)
    mean = float(np.angle(turn.mean())) / (2.0 * np.pi)
    off = np.angle(turn * np.exp(-2j * np.pi * mean)) / (2.0 * np.pi)
    return mean % 1.0 if np.abs(off).max() < _AGREE and abs(mean) > _ON else 0.0


def _on_steps(position: Array) -> Array:
    """Round `position` to a step where it is on one except for rounding errors."""
    near = np.round(position)
    return np.where(np.abs(position - near) < _ON, near, position)


def _sampler(position: Array, steps: int) -> Callable[[Array], Array]:
    """Return a function that picks values of a simulated output at `position`, linearly between steps."""
    index = np.minimum(np.floor(position).astype(np.int64), max(steps - 2, 0))
    share = position - index
    first = int(index[0])
    if np.array_equal(position, np.arange(first, first + position.size)):
        own = slice(first, first + position.size)
        return lambda y: y[own].copy()

    def between(y: Array) -> Array:
        left = y[index]
        return np.asarray(left + share * (y[index + 1] - left))

    return between


def program_of(structure: Structure, dt: float, pieces: int | None = None) -> CompiledProgram | Reference:
    """Compile the structure for data with the step `dt` [s]; a second fit uses the same program.

    Each step has `pieces` ticks, by default the structure's substeps.
    """
    # Logs of one rig differ in the last digits of their step: a relative 1e-9 is no reason to compile again.
    digits = 9 - math.floor(math.log10(dt))
    return _program(structure, round(dt, digits), pieces or structure.substeps)


@functools.lru_cache(maxsize=64)
def _program(structure: Structure, dt: float, pieces: int) -> CompiledProgram | Reference:
    return build(structure.diagram, dt=dt / pieces, precision="float64")


@functools.lru_cache(maxsize=64)
def _direct(structure: Structure) -> frozenset[str]:
    """Return the inputs on which an output depends in the same tick."""
    return frozenset().union(*(check(structure.diagram, 1.0).feedthrough or {}).values())


LEAST_TICKS = 4
"""Fewest ticks a step for an input that is not held."""

_MOMENTS = 4
_NODES = 8
# Samples by which a record is continued at both ends before its Fourier transform, which takes it as periodic.
_CONTINUED = 512


def ticks(values: Array, hold: str, pieces: int, direct: bool = False) -> Array:
    """Return the ticks of a program with `pieces` ticks a step, for an input's `values` (steps,).

    The shape is (steps * pieces,). `hold` is one of HOLDS. With `direct` (an output depends on the input in the same
    tick) the first tick of each step has the sample itself, at the price of one moment.
    """
    if hold == "zoh":
        return np.repeat(values, pieces)
    nodes, _ = legendre.leggauss(_NODES)
    late = 0.5 + 0.5 * nodes
    inside = _linear(values, late) if hold == "linear" else _band_limited(values, late)
    return np.ascontiguousarray((inside @ _held(pieces, direct).T).reshape(-1))


@functools.lru_cache(maxsize=16)
def _held(pieces: int, direct: bool) -> Array:
    """Return the matrix from values at the nodes of a step to the ticks' values, shape (pieces, nodes).

    They are the means over each tick, changed as little as the moments ask for. Moments are taken with Legendre's
    polynomials on -1..1, the step.
    """
    nodes, weights = legendre.leggauss(_NODES)
    to_series = np.linalg.inv(legendre.legvander(nodes, _NODES - 1))
    edges = np.linspace(-1.0, 1.0, pieces + 1)
    # The integral of each polynomial over each tick.
    integrals = np.stack(
        [np.diff(legendre.legval(edges, legendre.legint(np.eye(_NODES)[i]))) for i in range(_NODES)], axis=1
    )
    means = integrals @ to_series * (pieces / 2.0)
    count = min(_MOMENTS, pieces - direct)
    wanted = legendre.legvander(nodes, count - 1).T * weights
    given = integrals[:, :count].T
    if direct:
        wanted = np.vstack([wanted, legendre.legvander(np.array([-1.0]), _NODES - 1) @ to_series])
        given = np.vstack([given, np.eye(pieces)[:1]])
    return np.asarray(means + np.linalg.pinv(given) @ (wanted - given @ means))


def _linear(values: Array, late: Array) -> Array:
    """Interpolate linearly, `late` shares of a step after each sample, shape (steps, late); hold after the last."""
    rise = np.append(np.diff(values), 0.0)
    return np.asarray(values[:, None] + rise[:, None] * late)


def _band_limited(values: Array, late: Array) -> Array:
    """Interpolate by sines, `late` shares of a step after each sample, shape (steps, late).

    The record less the line through its ends is continued by its point reflection at both ends, and fades out there.
    """
    n = values.size
    slope = (values[-1] - values[0]) / max(n - 1, 1)
    line = values[0] + slope * np.arange(n)
    rest = values - line
    lap = min(_CONTINUED, n - 1)
    fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, lap + 1) / (lap + 1.0))
    size = 1 << (n + 2 * lap).bit_length()
    whole = np.zeros(size)
    whole[:n] = rest
    whole[n : n + lap] = -rest[n - 1 - lap : n - 1][::-1] * fade
    whole[size - lap :] = (-rest[1 : lap + 1] * fade)[::-1]
    frequency = np.fft.rfftfreq(size)
    # Of a sine at half the sampling rate the samples do not tell the phase; it is left out.
    spectrum = np.fft.rfft(whole) * (frequency < 0.5)
    found = np.empty((n, late.size))
    for j, share in enumerate(late):
        moved = np.fft.irfft(spectrum * np.exp(2j * np.pi * frequency * share), size)
        found[:, j] = moved[:n] + line + slope * share
    return found
