"""`twodof diagram margins`: what may change before a controller's loops become unstable, each as it flies."""

import importlib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from rich.console import Console

from twodof.cli.options import Force, Json, StockGains, argument, option
from twodof.cli.output import exit_unless, print_json, progress, table, table_console
from twodof.design import LoopMargins
from twodof.flight.gains import load_gains
from twodof.flight.starters import DIAGRAM_HELP, load_diagram
from twodof.report.plots.flight_view import PICTURES, check_place
from twodof.sim.linear import LOOPS, cascade_margins
from twodof.sim.resimulation import load_rig_or_model


def margins(
    diagrams: Annotated[
        list[str] | None, argument(f"Left out: the stock cascade. {DIAGRAM_HELP}", "DIAGRAM...")
    ] = None,
    rig: Annotated[str, option("lab, paper, a rig's JSON file, or a model's from `identify --json`.", "RIG")] = "lab",
    gains: StockGains = "default",
    loop: Annotated[list[str] | None, option(f"Only this loop; repeatable. {', '.join(LOOPS)}.", "NAME")] = None,
    plot: Annotated[
        Path | None,
        option(
            "Draw Bode, Nyquist, Nichols, sensitivities and step responses; of one loop its root locus too "
            f"({', '.join(PICTURES)}).",
            "FILE",
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Say the margins of each loop of the cascade, with the controllers and the rig as they fly.

    The loop is sampled, with all its delays. Each loop is broken at its place, those inside it are closed. A controller
    of the template attitude_control, position_control or motor_control takes the place of the stock one.

    Exit status 1: a loop is unstable.
    """
    if plot is not None:
        check_place(plot, force, PICTURES)
    flown = [load_diagram(one) for one in diagrams or []]
    values, stock = load_rig_or_model(rig), load_gains(gains)
    wanted = tuple(dict.fromkeys(loop)) if loop else tuple(LOOPS)
    found: dict[str, LoopMargins] = {}
    with progress() as say:
        for k, name in enumerate(wanted):
            say(f"margins of the {name} loop", k / len(wanted))
            found |= cascade_margins(stock, flown, values, [name])
    names = ", ".join(d.name for d in flown) or f"the stock cascade ({gains})"
    if plot is not None:
        # Only this reads matplotlib.
        draw = importlib.import_module("twodof.report.plots.loop_plot").write_loop_plot
        draw({name: m.loop for name, m in found.items()}, plot, f"{names} on {rig}", force)
    if json:
        print_json({"rig": rig, "loops": {name: m.to_json() for name, m in found.items()}})
    else:
        console = table_console()
        console.print(f"{names} on {rig}")
        print_margins(console, found)
        if plot is not None:
            console.print(f"written: {plot}")
    exit_unless(all(m.stable for m in found.values()))


def print_margins(console: Console, found: Mapping[str, LoopMargins]) -> None:
    """Print a row for each loop, then the motion of each unstable loop."""
    margins = ("gain margin\ndB", "phase margin\ndeg", "delay margin\nms", "disk margin\ndB and deg", "Ms", "Mt")
    made = table("loop", "crossover\nrad/s", *margins, "bandwidth\nrad/s", right=range(1, 9))
    for name, m in found.items():
        made.add_row(name, *(_cells(m) if m.stable else ("unstable", *[""] * 7)))
    console.print(made)
    for name, m in found.items():
        if not m.stable and m.motion is not None:
            console.print(f"{name}: unstable: {m.motion.text}{_cure(m)}")


def _cells(m: LoopMargins) -> tuple[str, ...]:
    return (
        _number(m.crossover, 3),
        _gains(m),
        _number(m.phase_margin_deg, 3),
        _number(1e3 * m.delay_margin, 3),
        f"{_decibels(m.disk.gain[1])}, {math.degrees(m.disk.phase):.0f}",
        f"{m.ms:.2f}",
        f"{m.mt:.2f}",
        _number(m.bandwidth, 3),
    )


def _gains(m: LoopMargins) -> str:
    """Return the gain margin; a conditionally stable loop has a lower one, too."""
    up = _decibels(m.increase.factor) if m.increase else "-"
    return up if m.decrease is None else f"{_decibels(m.decrease.factor)}, {up}"


def _cure(m: LoopMargins) -> str:
    """Return the gain at which an unstable loop would be on the border, as a remark."""
    if m.decrease is not None and m.motion is not None and m.motion.omega > 0.0:
        return f" (with {m.decrease.factor:.2g} times the gain it would be on the border)"
    return ""


def _decibels(factor: float) -> str:
    return "-" if math.isinf(factor) else f"{20.0 * math.log10(factor):.1f}"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else "-"
