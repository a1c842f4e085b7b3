"""Fuzzes one target in this process: `python -m tests.fuzz.runner TARGET [--runs N] [--seconds S] [--seed K]`.

Guided by coverage where atheris is installed, else by seeded mutations of the corpus. The corpus is `corpus/TARGET`:
what once went wrong, one file each, and the target's own seeds. A finding is written to `--findings` and ends the run
with status 1. The last line is JSON: target, guided, runs, seconds, findings.
"""

import argparse
import importlib
import importlib.util
import json
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.fuzz.target import Target

NAMES = ("framing", "logs", "diagram", "ftp")
GUIDING = ("twodof.flightlog", "twodof.link", "twodof.blocks", "twodof.fcu.mavlink")
CORPUS = Path(__file__).with_name("corpus")
MEMORY_MIB = 2048
ONE_INPUT_S = 10


def is_guided() -> bool:
    """Return True if atheris is installed: it has wheels for Linux on x86-64 and Python 3.11 to 3.13."""
    return importlib.util.find_spec("atheris") is not None


def load(name: str) -> Target:
    """The target of that name."""
    found = importlib.import_module(f"tests.fuzz.target_{name}").TARGET
    assert isinstance(found, Target)
    return found


def kept(name: str) -> list[Path]:
    """The kept inputs of a target."""
    return sorted((CORPUS / name).glob("*"))


def mutated(chance: random.Random, inputs: Sequence[bytes], longest: int) -> bytes:
    """One of the inputs with bytes changed, removed, repeated, put in or taken from another one."""
    data = bytearray(chance.choice(inputs))
    for _ in range(chance.randint(1, 5)):
        at = chance.randrange(len(data) + 1)
        size = chance.randint(1, 16)
        match chance.randrange(6):
            case 0:
                data[at : at + 1] = bytes([chance.randrange(256)])
            case 1:
                del data[at : at + size]
            case 2:
                data[at:at] = chance.randbytes(size)
            case 3:
                data[at : at + size] = data[at : at + size] * 2
            case 4:
                number = chance.choice((0, 1, 2**8 - 1, 2**16 - 1, 2**31 - 1, 2**32 - 1, 2**63, 2**64 - 1))
                data[at : at + 8] = number.to_bytes(8, chance.choice(("little", "big")))
            case _:
                other = chance.choice(inputs)
                start = chance.randrange(len(other) + 1)
                data[at : at + size] = other[start : start + size]
    return bytes(data[:longest])


def _by_mutation(target: Target, runs: int, seconds: float, seed: int, findings: Path) -> int:
    chance, end, done = random.Random(seed), time.monotonic() + seconds, 0
    inputs = [*target.seeds(), *(path.read_bytes() for path in kept(target.name))]
    for data in inputs:
        target.attempt(data)
    while done < runs and time.monotonic() < end:
        data = mutated(chance, inputs, target.longest)
        try:
            target.attempt(data)
        except BaseException:
            findings.mkdir(parents=True, exist_ok=True)
            (findings / f"{target.name}-{done}").write_bytes(data)
            raise
        done += 1
    return done


def _guided(name: str, runs: int, seconds: float, seed: int, findings: Path) -> None:
    """Does not come back: libFuzzer ends the process."""
    import atheris

    # Only what is fuzzed is instrumented: the rest of the package would only slow it down.
    importlib.import_module("tests.fuzz.target")
    with atheris.instrument_imports(include=list(GUIDING)):
        target = load(name)
    found = Path(tempfile.mkdtemp(prefix="twodof-corpus-"))
    for number, data in enumerate([*target.seeds(), *(path.read_bytes() for path in kept(name))]):
        (found / f"{number}").write_bytes(data)
    findings.mkdir(parents=True, exist_ok=True)
    runs = min(runs, 2**31 - 1)
    options = [f"-runs={runs}", f"-seed={seed}", f"-max_len={target.longest}", f"-rss_limit_mb={MEMORY_MIB}"]
    options += [f"-max_total_time={max(1, int(seconds))}", f"-timeout={ONE_INPUT_S}", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], *options, f"-artifact_prefix={findings}/{name}-", str(found)], target.attempt)
    atheris.Fuzz()


def fuzz(
    name: str, runs: int, seconds: float, seed: int, findings: Path, guided: bool | None = None
) -> dict[str, object]:
    """Fuzzes a target in a process of its own, which instrumentation and limits do not outlive; what came of it."""
    guided = is_guided() if guided is None else guided
    arguments = ["--runs", str(runs), "--seconds", str(seconds), "--seed", str(seed), "--findings", str(findings)]
    begin = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz.runner", name, *arguments, "--child", *(["--plain"] if not guided else [])],
        cwd=Path(__file__).resolve().parents[2],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        timeout=seconds + 600,
        check=False,
    )
    counts = [int(line.split()[-1]) for line in done.stdout.splitlines() if "number_of_executed_units" in line]
    crashed = sorted(str(path) for path in findings.glob(f"{name}-*")) if findings.exists() else []
    return {
        "target": name,
        "guided": guided,
        "runs": counts[-1] if counts else 0,
        "seconds": round(time.monotonic() - begin, 1),
        "findings": crashed,
        "said": "" if done.returncode == 0 else done.stdout[-3000:],
    }


def main(arguments: Sequence[str]) -> int:
    """The program."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=[*NAMES, "faulty", "all"])
    parser.add_argument("--runs", type=int, default=1 << 40)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--findings", type=Path, default=Path("out/findings"))
    parser.add_argument("--plain", action="store_true", help="without atheris")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.child and not given.plain:
        _guided(given.name, given.runs, given.seconds, given.seed, given.findings)
    elif given.child:
        resource.setrlimit(resource.RLIMIT_AS, (4 * MEMORY_MIB << 20, 4 * MEMORY_MIB << 20))
        target = load(given.name)
        done = _by_mutation(target, given.runs, given.seconds, given.seed, given.findings)
        sys.stdout.write(f"number_of_executed_units: {done}\n")
        return 0
    bad = 0
    for name in NAMES if given.name == "all" else [given.name]:
        guided = False if given.plain else None
        found = fuzz(name, given.runs, given.seconds, given.seed, given.findings.resolve(), guided)
        sys.stdout.write(json.dumps(found) + "\n")
        bad += bool(found["said"])
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
