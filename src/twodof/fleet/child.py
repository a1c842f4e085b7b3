"""`python -m twodof.fleet.child ARGUMENTS`: run `twodof ARGUMENTS` and end with the parent process.

The parent holds the other end of our standard input and never writes. End of file means that the parent has died.
"""

import os
import runpy
import signal
import threading


def _end_with_parent() -> None:
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    threading.Thread(target=_end_with_parent, daemon=True).start()
    runpy.run_module("twodof.cli", run_name="__main__")
