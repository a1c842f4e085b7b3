"""Campaign over processes: each takes a run, computes its figures, and takes the next."""

import hashlib
import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, nullcontext, suppress
from dataclasses import asdict
from multiprocessing.connection import Connection
from multiprocessing.resource_tracker import ensure_running
from pathlib import Path
from typing import Any

from twodof.campaign.plan import Row, RowFile, Run, row_line
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

_SPAWN = multiprocessing.get_context("spawn")
_STARTING = threading.Lock()


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
    the file. A stop or another number of processes does not change a byte of it.

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
        with closing(_Crew(measure, run_s, say).lines(runs[len(rows) :], processes)) as lines:
            for line in lines:
                if file is not None:
                    file.append(line)
                rows.append(json.loads(line))
                report(len(rows))
    return rows


class _Worker:
    """Process that measures one run after the other."""

    def __init__(self, measure: Measure) -> None:
        self.connection, theirs = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_work, args=(theirs, measure), name="campaign", daemon=True)
        with _for_children():
            self.process.start()
        theirs.close()

    def answer(self, seconds: float) -> bytes | str:
        """Return the next line of the process, or the reason of its end; it is ended after `seconds`."""
        try:
            if self.connection.poll(seconds):
                return self.connection.recv_bytes()
            reason = f"its process took over {seconds:g} s"
        except (EOFError, OSError):
            self.process.join(_END_S)
            code = self.process.exitcode
            how = f"signal {-code}" if code is not None and code < 0 else f"exit status {code}"
            reason = f"its process ended ({how})"
        self.end()
        return reason

    def end(self) -> None:
        """Kill the process and close its connection."""
        self.process.kill()
        self.process.join()
        self.connection.close()


class _Crew:
    """Pool of threads; each keeps a worker process, gives it runs and restarts it if it ends."""

    def __init__(self, measure: Measure, run_s: float, say: Callable[[str], None]) -> None:
        self._measure, self._run_s, self._say = measure, run_s, say
        self._workers: list[_Worker] = []
        self._own = threading.local()
        self._ended = False

    def lines(self, runs: Sequence[Run], processes: int) -> Generator[bytes]:
        """Yield the row of each run as a line, in the order of `runs`. All processes end with the iterator."""
        pool = ThreadPoolExecutor(max(1, min(processes, len(runs))))
        try:
            for row in [pool.submit(self._line, run) for run in runs]:
                yield row.result()
        finally:
            self._ended = True
            for worker in self._workers:
                worker.process.kill()  # its thread meets the end of the connection
            pool.shutdown(cancel_futures=True)
            for worker in self._workers:
                worker.end()

    def _line(self, run: Run) -> bytes:
        reason = ""
        for _ in range(_TIMES):
            worker = self._worker()
            with suppress(OSError):  # it died: its connection ends
                worker.connection.send(run)
            line = worker.answer(self._run_s)
            if isinstance(line, bytes):
                return line
            self._own.worker, reason = None, line
            if self._ended:
                break
            self._say(f"run {run.number} ({run.case} seed {run.seed}): {reason}".replace("( ", "("))
        return row_line(_row(run, failed=f"{reason}, {_TIMES} times"))

    def _worker(self) -> _Worker:
        """Return this thread's worker, started if there is none."""
        worker: _Worker | None = getattr(self._own, "worker", None)
        if worker is None:
            worker = self._own.worker = _Worker(self._measure)
            self._workers.append(worker)
            if self._ended:
                worker.process.kill()
            reason = worker.answer(START_S)
            if isinstance(reason, str):
                remedy = "read what it printed; `measure` must be a function or class of a module"
                raise ExperimentError(f"a process of the campaign does not start: {reason}", "campaign", remedy)
        return worker


@contextmanager
def _for_children() -> Iterator[None]:
    """Let processes that start within the block ignore Ctrl-C, which ends the parent, and compute in one thread."""
    with _STARTING:
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
