"""The command line: `twodof <noun-or-verb>`; `main` is the entry point."""

import importlib
import os
import sys

from twodof.cli import interrupts


def main() -> None:
    """Run the command line on the process's arguments and end the process with its exit status.

    The rest of the package is imported here, so that Ctrl-C while it loads is met as at any later time.
    """
    interrupts.begin()
    # Matrices are small: more threads wait for each other, and the last digits of a fit hang on the number of cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the shell (>&-): the command still does its work
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    try:
        status = importlib.import_module("twodof.cli.app").run(sys.argv[1:])
    except (KeyboardInterrupt, ImportError) as end:
        # Ctrl-C while the system loads an extension module comes as its failure.
        if isinstance(end, ImportError) and not isinstance(end.__cause__, KeyboardInterrupt):
            raise
        status = interrupts.INTERRUPTED
        interrupts.print_interrupted()
    interrupts.end()
    sys.exit(status)
