"""Runs the benchmarks, prints a table, writes `bench/results`: `python -m bench [NAME ...] [--strict] [--quick]`."""

import argparse
import datetime
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from bench.computing import (
    closed_loop,
    copies,
    cortex_m7,
    greybox,
    linear_fit,
    loop_margins,
    matrices,
    simulink_controller,
    start_up,
    targets,
)
from bench.measure import Figure, machine
from bench.stack import companion, flight_stack, kill_latency, lab_clients, link
from twodof.flightlog.atomic import atomic_write

BENCHMARKS: Mapping[str, Callable[[bool], list[Figure]]] = {
    "closed_loop": closed_loop.run,
    "companion": companion.run,
    "copies": copies.run,
    "cortex_m7": cortex_m7.run,
    "flight_stack": flight_stack.run,
    "greybox": greybox.run,
    "kill_latency": kill_latency.run,
    "lab_clients": lab_clients.run,
    "linear_fit": linear_fit.run,
    "link": link.run,
    "loop_margins": loop_margins.run,
    "matrices": matrices.run,
    "simulink_controller": simulink_controller.run,
    "start_up": start_up.run,
    "targets": targets.run,
}
RESULTS = Path(__file__).with_name("results")
WIDTH = 160  # of the tables where no terminal sets it


def shown(value: float) -> str:
    """A figure as a person reads it."""
    if 1e5 <= value < math.inf:
        return f"{value / 1e6:.3g} M"
    if float(value).is_integer() or value >= 1000.0:
        return f"{value:.0f}"
    return f"{value:.3g}"


def target(figure: Figure) -> str:
    """The target, and whether it is met."""
    if figure.target is None:
        return ""
    return f"{'<=' if figure.at_most else '>='} {shown(figure.target)}: {'met' if figure.met else 'MISSED'}"


def table(name: str, figures: Sequence[Figure]) -> Table:
    """The figures of one benchmark."""
    made = Table(title=name, title_justify="left", show_lines=False)
    for heading in ("figure", "value", "unit", "target", "remark"):
        made.add_column(heading, justify="right" if heading == "value" else "left", overflow="fold")
    for f in figures:
        style = "bold red" if f.met is False else "bold" if f.met else None
        made.add_row(f.name, shown(f.value), f.unit, target(f), f.remark, style=style)
    return made


def markdown(folder: Path) -> str:
    """The results in a folder as one page, each with its machine and version: not all are measured on one day."""
    lines = [
        "# Benchmarks",
        "",
        "Steps are of 1 ms; times are CPU time of one core, medians; the start-up is time on the wall, the best. In",
        "flight_stack a period is 4 ms, and its times are on the wall, where everything ran at once on these cores.",
    ]
    for file in sorted(folder.glob("*.json")):
        run = json.loads(file.read_text(encoding="utf-8"))
        versions = ", ".join(f"{name} {version}" for name, version in run["packages"].items())
        compilers = ", ".join(f"{name}: {version}" for name, version in run["compilers"].items())
        lines += ["", f"## {file.stem}", ""]
        lines += [f"{run['date']}, {run['processor']}, {run['cores']} cores (load {run['load']}), {run['system']}."]
        lines += [f"{versions}; Python {run['python']}; {compilers}."]
        lines += ["", "| figure | value | unit | target | remark |", "|---|---:|---|---|---|"]
        figures = (Figure(**{key: one[key] for key in one if key != "met"}) for one in run["figures"])
        lines += [f"| {f.name} | {shown(f.value)} | {f.unit} | {target(f)} | {f.remark} |" for f in figures]
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit status: 1 if `--strict` is asked for and a target is missed, else 0."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(BENCHMARKS)} (default: all)")
    parser.add_argument("--strict", action="store_true", help="exit status 1 if a target is missed")
    parser.add_argument("--quick", action="store_true", help="tiny sizes: only shows that everything runs")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results (default: %(default)s)")
    given = parser.parse_args(arguments)
    unknown = [name for name in given.names if name not in BENCHMARKS]
    if unknown:
        parser.error(f"no benchmark named {unknown[0]!r}; choose from {', '.join(BENCHMARKS)}")
    about = {"date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")} | machine()
    console = Console(width=None if sys.stdout.isatty() else WIDTH)
    console.print(f"{about['processor']}, {about['cores']} cores, load {about['load']}")
    console.print("\n".join(f"{name}: {version}" for name, version in about["compilers"].items()), style="dim")
    results: dict[str, list[Figure]] = {}
    for name in given.names or BENCHMARKS:
        results[name] = BENCHMARKS[name](given.quick)
        console.print(table(name, results[name]))
    given.out.mkdir(parents=True, exist_ok=True)
    for name, figures in results.items():
        with atomic_write(given.out / f"{name}.json", "w") as file:
            file.write(json.dumps(about | {"quick": given.quick, "figures": [f.to_json() for f in figures]}, indent=2))
            file.write("\n")
    with atomic_write(given.out / "results.md", "w") as file:
        file.write(markdown(given.out))
    missed = [f.name for figures in results.values() for f in figures if f.met is False]
    console.print(f"{len(missed)} targets missed: {'; '.join(missed)}" if missed else "All targets met.")
    return int(given.strict and bool(missed))


if __name__ == "__main__":
    sys.exit(main())
