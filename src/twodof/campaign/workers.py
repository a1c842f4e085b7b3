"""Campaign over processes: each takes a run, computes its figures, and takes the next."""

import hashlib
import json
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from multiprocessing.resource_tracker import ensure_running
from pathlib import Path
from typing import Any

from twodof.campaign.plan import Run
from twodof.campaign.row_file import Row, RowFile, row_line
from twodof.errors import ExperimentError, TwodofError
from twodof.flightlog.provenance import versions

Figures = Mapping[str, Any]
Measure = Callable[[Run], Figures]

RUN_S = 600.0
"""Longest time of one run [s]; its process is ended then."""

_TIMES = 2
"""A run whose process dies is tried so often."""

START_S = 120.0
"""Longest time in which a process imports its modules [s]."""

_END_S = 10.0
"""Longest wait for the exit status of a process whose connection has ended [s]."""

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""One thread in each process: the processes have the cores, and sums have one order."""


def campaign(
    measure: Measure,
    runs: Sequence[Run],
    path: str | Path | None = None,
    *,
    name: str = "",
    processes: int | None = None,
    run_s: float = RUN_S,
    say: Callable[[str], None] = lambda _: None,
    report: Callable[[int], None] = lambda _: None,
) -> list[Row]:
    """Return a row of figures for each of the `runs`, in their order, computed by `processes` (None: one a core).

    `measure` flies a run and returns its figures: numbers, text, lists, dicts. It is a function of a module or an
    instance of a class there, as each process imports it. A run that raises a TwodofError or an arithmetic error has a
    row with the reason. If its process dies, or takes longer than `run_s` [s], `say` is told and the run is tried once
    more. `report` gets the number of rows that are there.

    With `path` the rows are kept in that file, and a campaign that was stopped goes on where it was. `name` belongs to
    the file. Neither the number of processes nor a stop changes a byte of it.

    Raises LogError for the file of another campaign, ExperimentError for a number of processes below 1 and where a
    process cannot import `measure`.
    """
    processes = (os.cpu_count() or 1) if processes is None else processes
    if processes < 1:
        raise ExperimentError(f"{processes} processes", "campaign", "give 1 or more")
    plan = hashlib.sha256(json.dumps([asdict(run) for run in runs]).encode()).hexdigest()
    head = {"campaign": name, "runs": len(runs), "plan": plan, "versions": versions()}
    with RowFile(path, head) if path is not None else nullcontext() as file:
        rows: list[Row] = [] if file is None else list(file.rows)
        left = list(runs[len(rows) :])
        with _Crew(measure, min(processes, len(left)), run_s, say) as crew:
            for line in crew.lines(left):
                if file is not None:
                    file.append(line)
                rows.append(json.loads(line))
                report(len(rows))
    return rows


@dataclass
class _Worker:
    process: SpawnProcess
    connection: Connection
    deadline: float
    run: Run | None = None
    started: bool = False


class _Crew:
    """Worker processes, which end with the block."""

    def __init__(self, measure: Measure, processes: int, run_s: float, say: Callable[[str], None]) -> None:
        self._measure, self._run_s, self._say = measure, run_s, say
        self._context = multiprocessing.get_context("spawn")
        self._workers: list[_Worker] = []
        self._wanted = processes

    def __enter__(self) -> "_Crew":
        return self

    def __exit__(self, *_: object) -> None:
        for worker in list(self._workers):
            self._end(worker)

    def lines(self, runs: Sequence[Run]) -> Iterator[bytes]:
        """Yield the row of each run as a line, in the order of `runs`."""
        waiting, ended, tries = list(reversed(runs)), dict[int, bytes](), dict[int, int]()
        for run in runs:
            while run.number not in ended:
                self._give(waiting)
                for worker, line in self._results():
                    given, worker.run = worker.run, None
                    assert given is not None
                    if isinstance(line, bytes):
                        ended[given.number] = line
                        continue
                    tries[given.number] = tries.get(given.number, 0) + 1
                    self._say(f"run {given.number} ({given.case} seed {given.seed}): {line}".replace("( ", "("))
                    if tries[given.number] < _TIMES:
                        waiting.append(given)
                    else:
                        ended[given.number] = row_line(_row(given, failed=f"{line}, {_TIMES} times"))
            yield ended.pop(run.number)

    def _give(self, waiting: list[Run]) -> None:
        """Start workers that are missing, and give a run to each that is idle."""
        while len(self._workers) < self._wanted:
            ours, theirs = self._context.Pipe()
            process = self._context.Process(target=_work, args=(theirs, self._measure), name="campaign", daemon=True)
            with _for_children():
                process.start()
            theirs.close()
            self._workers.append(_Worker(process, ours, time.monotonic() + START_S))
        for worker in self._workers:
            if worker.started and worker.run is None and waiting:
                worker.run, worker.deadline = waiting.pop(), time.monotonic() + self._run_s
                with suppress(OSError):  # it died: its connection ends, which `_results` sees
                    worker.connection.send(worker.run)

    def _results(self) -> Iterator[tuple[_Worker, bytes | str]]:
        """Wait for workers; yield each that is ready with its line, or with the reason of its end."""
        asked = {one.connection: one for one in self._workers if one.run is not None or not one.started}
        patience = min(worker.deadline for worker in asked.values()) - time.monotonic()
        ready = set(wait(list(asked), max(0.0, patience)))
        for connection, worker in asked.items():
            result: bytes | str = b""
            if connection in ready:
                try:
                    result = connection.recv_bytes()
                except (EOFError, OSError):
                    result = f"its process ended ({self._end(worker, _END_S)})"
            elif time.monotonic() > worker.deadline:
                self._end(worker)
                result = f"its process took over {self._run_s:g} s"
            if worker.run is not None and result:
                yield worker, result
            elif isinstance(result, str):
                raise ExperimentError(
                    f"a process of the campaign does not start: {result}",
                    "campaign",
                    "read what it printed; `measure` must be a function or class of a module",
                )
            elif connection in ready:
                worker.started = True

    def _end(self, worker: _Worker, patience_s: float = 0.0) -> str:
        """End a worker and forget it; return how it had ended by itself within `patience_s` [s]."""
        self._workers.remove(worker)
        worker.connection.close()
        worker.process.join(patience_s)
        code = worker.process.exitcode
        worker.process.kill()
        worker.process.join()
        if code is not None and code < 0:
            return f"signal {-code}"
        return f"exit status {code}"


@contextmanager
def _for_children() -> Iterator[None]:
    """Let processes that start within the block ignore Ctrl-C, which ends the parent, and compute in one thread."""
    ensure_running()  # starting the resource tracker unblocks the signal: start it before the block
    before = {name: os.environ.get(name) for name in _THREADS}
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _row(run: Run, **result: Any) -> Row:
    changed = {"case": run.case, "parameters": dict(run.parameters)}
    return {"run": run.number, "seed": run.seed, **{name: one for name, one in changed.items() if one}, **result}


def _work(connection: Connection, measure: Measure) -> None:
    """Run a worker process: measure each run that is received until the parent is gone."""
    connection.send_bytes(b"")  # all modules are there
    while True:
        try:
            run = connection.recv()
        except EOFError:
            return
        try:
            line = row_line(_row(run, figures=measure(run)))
        except (TwodofError, ArithmeticError) as reason:
            line = row_line(_row(run, failed=str(reason) or type(reason).__name__))
        try:
            connection.send_bytes(line)
        except OSError:
            return
