"""`twodof flash`: check a controller, compile it, say what it costs and what changes, and let it fly from now on."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from twodof.blocks.difference import Difference
from twodof.blocks.schema.json_form import to_json
from twodof.cli.connection import lease_refusals
from twodof.cli.margins import margin_lines
from twodof.cli.options import Json, argument, flag, group, option
from twodof.cli.output import exit_unless, print_result, progress, table
from twodof.compile.px4 import export as export_module
from twodof.compile.px4.export import airframe_id
from twodof.compile.px4.tree import check as check_module
from twodof.fleet.flash import FCU, FORCE, PX4, SIM, ControllerCosts, TrialFlight
from twodof.fleet.flash import flash as flash_controller
from twodof.flight.controller_store import STOCK
from twodof.flight.starters import DIAGRAM_HELP, load_diagram, starter
from twodof.gcs.async_drone import DEFAULT_URL
from twodof.signals import PERIOD

_LINES = 60  # of changes; a diagram that has little in common with the one before makes hundreds


def flash(
    diagram: Annotated[str, argument(DIAGRAM_HELP, "DIAGRAM")],
    to: Annotated[
        str,
        option(
            f"sim: the simulator; px4-dir: a module for PX4; a drone's URL, or fcu for {DEFAULT_URL}.",
            f"{SIM}|{PX4}|{FCU}|URL",
        ),
    ],
    out: Annotated[Path | None, option("With px4-dir: the module's folder.", "DIR")] = None,
    px4: Annotated[Path | None, option("With px4-dir: the PX4 checkout to check the module against.", "DIR")] = None,
    precision: Annotated[str, option("float32 as flight controllers compute, or float64.")] = "float32",
    key: Annotated[Path | None, option("With a drone: the key that signs all messages.", "FILE")] = None,
    dry_run: Annotated[bool, flag("Print everything, change nothing.", "--dry-run")] = False,
    force_unstable: Annotated[bool, flag("Flash even if it is unstable on the virtual rig.", FORCE)] = False,
    json: Json = False,
) -> None:
    """Check and compile a controller, compare it with the active one, and make it the active one.

    The diagram has the ports of a template: attitude_control, position_control or motor_control. In the simulator it
    flies only with `twodof simulate --controller flashed`. A controller that was flashed for another template stays.
    `twodof flash stock-attitude --to sim` brings the stock one back. The simulator's controllers are kept in the user's
    data folder (TWODOF_DATA, else XDG_DATA_HOME/twodof or ~/.local/share/twodof), in flashed/sim.

    First it flies a small step on the virtual rig, and the margins of its loops are printed (`twodof diagram margins`).
    A controller that is unstable there is not flashed without --force-unstable.

    A drone must be disarmed. It builds the controller for its own sandbox. Until that is done, the earlier controller
    flies on; from then on the new one flies, and the drone keeps it over restarts.
    """
    if out is None and to == PX4:
        raise typer.BadParameter("--to px4-dir needs --out DIR, the module's folder")
    if out is not None and to != PX4:
        raise typer.BadParameter("--out goes with --to px4-dir")
    if px4 is not None and to != PX4:
        raise typer.BadParameter("--px4 goes with --to px4-dir")
    if key is not None and to in (SIM, PX4):
        raise typer.BadParameter("--key goes with a drone")
    new = load_diagram(diagram)
    url = DEFAULT_URL if to == FCU else to
    with lease_refusals(url), progress() as say:
        found = flash_controller(new, to, out, px4, precision, key, dry_run, force_unstable, say)
    document = {
        "diagram": new.name,
        "template": found.template,
        "to": to,
        "precision": precision,
        **{key: getattr(found, key).to_json() for key in ("costs", "changes", "trial")},
        "against": found.origin,
        **{key: getattr(found, key) for key in ("remarks", "warnings", "place")},
        "flashed": not dry_run,
    }
    if dry_run:
        ends = ["nothing was flashed (--dry-run)"]
    elif to == PX4:
        ends = [f"written: {found.place}, whose README.md says how to build it into PX4"]
    elif to == SIM:
        ends = [f"flashed: {found.place}", "fly it: twodof simulate EXPERIMENT --controller flashed"]
    else:
        own = to_json(new) != to_json(starter(STOCK[found.template]))
        tune = f"tune it: twodof parameters --url {url} {found.template}.NAME=VALUE"
        ends = [f"flashed: {found.place}", *[tune] * own]
    lines = [
        f"{new.name} fits {found.template}; {precision}, {1.0 / PERIOD:g} Hz",
        *_cost_lines(found.costs),
        *_trial_lines(found.trial),
        *_change_lines(found.changes, found.origin),
        *(f"remark: {remark}" for remark in found.remarks),
        *(f"warning: {warning}" for warning in found.warnings),
    ]
    print_result(json, document, [*lines, *ends])


def _cost_lines(cost: ControllerCosts) -> Iterator[str]:
    sizes = f"parameters {cost.parameters} bytes, states {cost.states} bytes"
    yield f"{sizes}, inputs {cost.inputs}, outputs {cost.outputs}"
    if cost.m7 is None:
        yield f"code: not measured for the Cortex-M7: {cost.m7_missing}"
        return
    m7 = cost.m7
    stack = m7["stack_bytes_bound"]
    yield (
        f"on a Cortex-M7: {m7['flash_bytes']} bytes of code and constants, {m7['ram_bytes']} bytes of RAM, "
        f"{m7['stack_bytes_seen'] if stack is None else stack} bytes of stack"
    )
    yield f"  {m7['instructions_max']} instructions a step at most in {m7['steps']} steps, by {m7['compiler']}"


def _trial_lines(trial: TrialFlight) -> list[Any]:
    lines = [f"margins: not known: {trial.unknown}"] if trial.unknown else margin_lines(trial.margins)
    seen = f"UNSTABLE: {trial.fault}" if trial.fault else "3 s with a small step, and no swing grows"
    return [*lines, f"on the virtual rig: {seen}"]


def _change_lines(changes: Difference, origin: str) -> Iterator[str]:
    if not changes:
        yield f"nothing changes against {origin}"
        return
    rows = changes.changes
    counts = ", ".join(f"{sum(row.kind == kind for row in rows)} {kind}" for kind in ("changed", "added", "removed"))
    yield f"changes against {origin} ({counts}):"
    yield from (f"  {row}" for row in rows[:_LINES])
    if len(rows) > _LINES:
        yield f"  and {len(rows) - _LINES} more, which --json lists"


px4 = group("Export a diagram as a module for PX4, and check it against a PX4 checkout.")


@px4.command()
def export(
    diagram: Annotated[str, argument(DIAGRAM_HELP)],
    out_dir: Annotated[Path, argument("The folder to write: a new one, an empty one or an earlier export.")],
    log: Annotated[
        list[str] | None, option("Log this signal too: its path, part.port; repeatable.", None, "--log")
    ] = None,
    prefix: Annotated[
        str, option("Prefix of the parameters' names: 1 to 5 capitals or digits; default: from the diagram's name.")
    ] = "",
    force: Annotated[bool, flag("Replace an earlier export even if its files were changed.", "--force")] = False,
    json: Json = False,
) -> None:
    """Write a diagram as an external module for PX4 v1.14 to v1.17: C, work item, parameters, message, airframe.

    The same diagram gives the same bytes. README.md in the folder says how it is built and started.
    """
    module = export_module(load_diagram(diagram), out_dir, log or (), prefix, force)
    role = {key: list(getattr(module.role, key)) for key in ("reads", "writes", "stops")}
    document = {
        "folder": str(out_dir),
        "module": module.names.module,
        "airframe": airframe_id(module.names),
        "parameters": {row.name: row.path or None for row in module.parameters},
        "not_exported": {kept.path: kept.reason for kept in module.kept},
        **role,
        "files": sorted(module.files),
    }
    rows = table("parameter in PX4", "in the diagram")
    for row in module.parameters:
        element = "" if row.index is None else f"[{row.index}]"
        rows.add_row(row.name, f"{row.path}{element}" if row.path else "(the module's own)")
    lines: list[Any] = [
        f"{out_dir}: module {module.names.module}, {len(module.files)} files",
        rows,
        *(f"not in PX4: {kept.path}: {kept.reason}" for kept in module.kept),
        f"reads {', '.join(role['reads'])}",
        f"writes {', '.join(role['writes'])}; stops {', '.join(role['stops'])}",
        f"next: twodof px4 check PX4_DIR {out_dir}; then README.md there",
    ]
    print_result(json, document, lines)


@px4.command()
def check(
    px4_dir: Annotated[Path, argument("A checkout of PX4.")],
    out_dir: Annotated[Path, argument("A folder that `twodof px4 export` wrote.")],
    json: Json = False,
) -> None:
    """Compare an exported module with a checkout of PX4: its version, and faults that its build does not show.

    Nothing is written. Exit status 0: it fits, perhaps with warnings; 1: it does not.
    """
    found = check_module(px4_dir, out_dir)
    rows = [{"level": r.level, "what": r.what, "where": r.where, "remedy": r.remedy} for r in found.rows]
    lines = [f"{row.level}: {row.where}: {row.what} ({row.remedy})" for row in found.rows]
    lines.append(f"{found.module} {'fits' if found.fits else 'does not fit'} {px4_dir}, version {found.version}")
    document = {"fits": found.fits, "module": found.module, "version": found.version, "findings": rows}
    print_result(json, document, lines)
    exit_unless(found.fits)
