"""The command line: `twodof <noun-or-verb>`; `main` is the entry point."""

import sys

from twodof.cli.app import INTERRUPTED, run


def main() -> None:
    """Run the command line on the process's arguments and end the process with its exit status."""
    try:
        status = run(sys.argv[1:])
    except KeyboardInterrupt:
        status = INTERRUPTED
    sys.exit(status)
