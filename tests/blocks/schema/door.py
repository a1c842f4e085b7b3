"""Load files in processes of their own with bounded memory and time, and report the result of each.

Run as a program with a folder, it prints one line of JSON for each file, in the order of their names. With a file, it
prints one for each line, which is a diagram's text as a JSON string. All are loaded in one process.
"""

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from twodof.blocks import Block, Diagram
from twodof.blocks.library import DataStore, StoreRead
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import from_json, read_diagram
from twodof.compile.builder import emit_program
from twodof.errors import TwodofError

MEMORY = 2**30
SECONDS = 2.0
FAULTS = (ArithmeticError, AttributeError, AssertionError, EOFError, LookupError, MemoryError, NameError, OSError)
FAULTS += (RuntimeError, TypeError, ValueError)  # whatever else can be raised: what is looked for
CPU_SECONDS = 20  # when a process is ended; a load that takes more than SECONDS of them is a failure of its own


def judge(files: Mapping[str, bytes], folder: Path) -> dict[str, dict[str, Any]]:
    """Load each file; return "error" (type, "" if it loaded), "text", "seconds" of CPU and peak "bytes" of each."""
    for number, data in enumerate(files.values()):
        (folder / f"{number:05d}").write_bytes(data)
    done = subprocess.run(
        [sys.executable, "-m", "tests.blocks.schema.door", str(folder)],
        cwd=Path(__file__).resolve().parents[3],
        capture_output=True,
        text=True,
        timeout=60 + CPU_SECONDS * len(files),
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return dict(zip(files, map(json.loads, done.stdout.splitlines()), strict=True))


def judge_many(texts: Sequence[str], file: Path, seconds: float) -> list[dict[str, Any]]:
    """Load `texts` one after the other in one process, within `seconds`; return a row of results for each."""
    file.write_text("".join(json.dumps(text) + "\n" for text in texts))
    done = subprocess.run(
        [sys.executable, "-m", "tests.blocks.schema.door", str(file)],
        cwd=Path(__file__).resolve().parents[3],
        capture_output=True,
        text=True,
        timeout=seconds,
        check=False,
    )
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0, f"{done.stderr[-2000:]}\nat {texts[len(rows)]:.2000}"
    return rows


def connected(diagram: Diagram) -> Diagram:
    """`diagram` with an input of its own for each input of a part that nothing feeds, data stores apart."""
    number = 0
    for name, part in list(diagram.parts.items()):
        if isinstance(part.item, (DataStore, StoreRead)):
            continue
        ports = part.item.inputs if isinstance(part.item, Block) else part.item.inputs.values()
        for port in ports:
            if (name, port.name) not in diagram.connections:
                number += 1
                diagram.connect(diagram.input(f"free_{number}", port.kind, port.width), f"{name}.{port.name}")
    return diagram


def attempt(diagram: Diagram, stage: list[str]) -> None:
    """Take two steps on the reference and write the C of a diagram."""
    stage.append("loaded")
    machine = Reference(diagram, 0.01).machine()
    machine.run(2)
    emit_program(diagram, 0.01)
    stage.append("compiled")


def _child(file: Path, pipe: int) -> None:
    """Set bounds on this process, make the attempt, and write the result into the pipe."""
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGESIZE")
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, size + MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    error, text, stage = "", "", ["refused"]
    start = time.process_time()
    try:
        attempt(read_diagram(file), stage)
    except TwodofError as found:
        error, text = type(found).__name__, str(found)
    except FAULTS as found:
        error, text = f"!{type(found).__name__}", str(found)[:500]
    seconds = time.process_time() - start
    peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    row = {
        "error": error,
        "text": text[:1000],
        "long": len(text),
        "stage": stage[-1],
        "seconds": seconds,
        "bytes": peak,
    }
    os.write(pipe, json.dumps(row).encode())


def many(file: Path) -> None:
    """Judge every line of the file in this process."""
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGESIZE")
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, size + MEMORY))
    for line in file.read_text().splitlines():
        error, text, stage = "", "", ["refused"]
        start = time.process_time()
        try:
            attempt(connected(from_json(json.loads(line))), stage)
        except TwodofError as found:
            error, text = type(found).__name__, str(found)
        except FAULTS as found:
            error, text = f"!{type(found).__name__}", str(found)[:500]
        seconds = time.process_time() - start
        row = {"error": error, "text": text[:300], "long": len(text), "stage": stage[-1], "seconds": seconds}
        sys.stdout.write(json.dumps(row) + "\n")


def main(folder: Path) -> None:
    """Judge every file of the folder."""
    for file in sorted(folder.iterdir()):
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reading)
            _child(file, writing)
            os._exit(0)
        os.close(writing)
        with os.fdopen(reading) as stream:
            said = stream.read()
        _, status = os.waitpid(child, 0)
        ended = {"error": f"!ended by signal {status & 127}", "text": "", "long": 0, "stage": "refused"}
        sys.stdout.write((said or json.dumps({**ended, "seconds": float(CPU_SECONDS), "bytes": 0})) + "\n")


if __name__ == "__main__":
    given = Path(sys.argv[1])
    main(given) if given.is_dir() else many(given)
