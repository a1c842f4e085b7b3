"""`python -m twodof.cli.child ARGUMENTS`: a command line that ends with the process that started it.

The parent holds the other end of our standard input and never writes: its end is the parent's, however that died.
"""

from __future__ import annotations

import os
import signal
import threading

from twodof.cli import main


def _outlive_nobody() -> None:
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    threading.Thread(target=_outlive_nobody, daemon=True).start()
    main()
