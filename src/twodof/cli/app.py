"""The group of commands, each loaded when it is called, and what every command does with errors and Ctrl-C."""

import importlib
import sys
import warnings
from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import Any

import typer
from typer.core import TyperGroup

from twodof.cli import interrupts
from twodof.cli.output import broken_output, print_error, print_json, reader_has_left, remedy_in_shell, say_line
from twodof.errors import CompileError, DownloadError, IdentificationError, TwodofError

FINE, WENT_WRONG, CALLERS_MISTAKE = 0, 1, 2

# Command -> (module that defines it under this name, one line of help): `twodof --help` imports none of them.
COMMANDS = MappingProxyType(
    {
        "demo": ("demo", "Fly, identify and compare with the paper; write the report."),
        "simulate": ("simulate", "Fly an experiment, or a log's set-points, on a virtual rig."),
        "up": ("up", "Start virtual drones with their browser page. Start here."),
        "lab": ("up", "Serve only the browser page, for drones that run already."),
        "fly": ("fly", "Fly an experiment over MAVLink, on a virtual drone or a real one."),
        "watch": ("watch", "Watch drones in the terminal: state, mode, angle, position, battery, messages."),
        "diagram": ("diagram", "Create, check, test, draw and linearize a diagram; show its C."),
        "slx": ("slx", "Inspect, draw and compare Simulink files, import a controller."),
        "flash": ("flash", "Check and compile a controller, show the changes, and make it fly."),
        "identify": ("identify", "Identify a model from a flight log."),
        "campaign": ("campaign", "Fly many times, and count how often the fit's intervals hold the true values."),
        "design": (
            "design",
            "Design a controller for an identified model, predict its flight, and compare it with a flight.",
        ),
        "margins": ("margins", "Compute the margins of a loop of your own: plant and controller."),
        "bode": ("margins", "Draw the Bode plot of a loop with its margins."),
        "rlocus": ("margins", "Draw the root locus of a loop."),
        "step": ("margins", "Draw the step response of a closed loop, with its figures."),
        "fcu": ("fcu", "Run a virtual drone: rig and flight controller, reached over MAVLink."),
        "replay": ("simulate", "Feed a log's inputs to the compiled flight code and compare its outputs."),
        "log": ("log", "Inspect, draw, convert, recover and download flight logs."),
        "calibrate": ("simulate", "Calibrate the virtual rig on the real drone's logs."),
        "companion": ("companion", "Route MAVLink between the flight controller and clients; run an app on board."),
        "drones": ("connection", "List the drones in reach, with their addresses."),
        "parameters": ("connection", "Show and set a drone's parameters, in flight too."),
        "kill": ("connection", "Stop the motors now, whoever commands the drone."),
        "key": ("connection", "Make a key that signs MAVLink messages."),
        "px4": ("flash", "Export a diagram as a module for PX4, and check it against a PX4 checkout."),
    }
)


class LazyGroup(TyperGroup):
    """A group whose commands are imported on demand: a command's module brings in whole rooms of the package."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import and return a command; return None for an unknown name, which the caller reports."""
        if cmd_name not in COMMANDS:
            return None
        module, text = COMMANDS[cmd_name]
        command = typer.main.get_command(_app(getattr(importlib.import_module(f"twodof.cli.{module}"), cmd_name)))
        command.name, command.help = cmd_name, command.help or text
        interrupts.raise_keyboard_interrupt()
        return command

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write usage and the table, without importing a command."""
        width = max(map(len, COMMANDS)) + 2
        lines = [f"  {name:{width}}{text}" for name, (_, text) in COMMANDS.items()]
        sys.stdout.write(
            f"Usage: {ctx.command_path} COMMAND [ARGUMENTS]...\n\n{self.help}\n\nCommands:\n"
            + "\n".join(lines)
            + "\n\nEach command has --help. Exit status: 0 success, 1 a flight, fit or tool failed, 2 wrong usage, "
            "130 interrupted.\n"
        )

    def invoke(self, ctx: Any) -> Any:
        """Run a command; Ctrl-C ends it with a line and its exit status."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            interrupts.print_interrupted()
            raise SystemExit(interrupts.INTERRUPTED) from None


def _app(made: typer.Typer | Callable[..., None]) -> typer.Typer:
    """Return a group of commands as it is, a single command as an application of its own."""
    if isinstance(made, typer.Typer):
        return made
    single = typer.Typer(add_completion=False, rich_markup_mode=None)
    single.command()(made)
    return single


def status_of(error: TwodofError) -> int:
    """Return the exit status: 1 if well-formed work did not succeed, 2 if the request was wrong."""
    return WENT_WRONG if isinstance(error, IdentificationError | CompileError | DownloadError) else CALLERS_MISTAKE


app = typer.Typer(
    cls=LazyGroup, add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False, no_args_is_help=True
)


def _version(asked: bool) -> None:
    if asked:
        sys.stdout.write(f"twodof {importlib.import_module('twodof').__version__}\n")
        raise typer.Exit


@app.callback()
def twodof(version: bool = typer.Option(False, "--version", callback=_version, is_eager=True)) -> None:
    """An open control laboratory around the 2DoF Drone."""


def show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning as a note, without its place in the code."""
    say_line(f"note: {message}")


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit status; the process does not end.

    An error of ours is printed as what, where and remedy, without a traceback; with --json also on stdout as
    `{"error": {"kind", "what", "where", "remedy"}}`.
    """
    try:
        status = _run(arguments)
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        reader_has_left()  # Python would complain again at exit
        return WENT_WRONG
    except OSError:
        reason = broken_output()
        if reason is None:
            raise
        print_error(TwodofError(f"standard output cannot be written: {reason}"))
        reader_has_left()
        return WENT_WRONG
    return status


def _run(arguments: Sequence[str]) -> int:
    try:
        with warnings.catch_warnings():
            warnings.showwarning = show_warning
            app(args=list(arguments), prog_name="twodof")
    except (TwodofError, OSError) as found:
        if isinstance(found, TwodofError):
            error = found
        elif found.filename is None:
            raise
        else:  # a name that is too long, a folder that is no folder, a full disk, ...
            what, remedy = f"the file system refuses: {found.strerror}", "choose another name or folder"
            error = TwodofError(what, str(found.filename), remedy)
        print_error(error)
        if "--json" in arguments:
            said = {"what": error.what, "where": error.where, "remedy": remedy_in_shell(error.remedy)}
            print_json({"error": {"kind": type(error).__name__, **said}})
        return status_of(error)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else FINE if end.code is None else WENT_WRONG
    return FINE
