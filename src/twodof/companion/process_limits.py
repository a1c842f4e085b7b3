"""Started by the supervisor as a script of its own: sets limits on itself, then becomes the app.

`python -I -S process_limits.py LIMITS PARENT COMMAND...`: LIMITS is JSON (memory, file, files, niceness). Limits set in
the child before it runs leave no moment without them, and no Python runs between fork and exec of a threaded parent.
"""

import ctypes
import json
import os
import resource
import signal
import sys

_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG: the app does not outlive a supervisor that was killed


def main(limits: str, parent: str, command: list[str]) -> None:
    """Limit this process and replace it by `command`."""
    wanted = json.loads(limits)
    rows = {resource.RLIMIT_CORE: 0, resource.RLIMIT_AS: wanted["memory"]}
    rows |= {resource.RLIMIT_FSIZE: wanted["file"], resource.RLIMIT_NOFILE: wanted["files"]}
    for kind, most in rows.items():
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard),) * 2)
    os.nice(wanted["niceness"])
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DEATH_SIGNAL, signal.SIGKILL)
        if os.getppid() != int(parent):  # it was killed before we could ask
            sys.exit(1)
    os.execvp(command[0], command)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
