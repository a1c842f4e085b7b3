"""The command line: `twodof <noun-or-verb>`; `main` is the entry point."""

import importlib
import sys

# app.INTERRUPTED, which may not be there yet when Ctrl-C comes.
_INTERRUPTED = 130


def main() -> None:
    """Run the command line on the process's arguments and end the process with its exit status.

    The rest of the package is imported here, so that Ctrl-C while it loads is met as at any later time.
    """
    try:
        status = importlib.import_module("twodof.cli.app").run(sys.argv[1:])
    except KeyboardInterrupt:
        status = _INTERRUPTED
    sys.exit(status)
