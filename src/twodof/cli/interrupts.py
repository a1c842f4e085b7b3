"""Ctrl-C at any moment: one line and status 130, never a traceback.

While modules are imported nothing is at stake, and what is imported may make anything of an exception: the process ends
at once. While a command works it is KeyboardInterrupt, so that files and drones are left in order. When it has ended
there is nothing left to interrupt.
"""

from __future__ import annotations

# What is imported here is imported before Ctrl-C is met: only what every Python has loaded already, or has built in.
import _signal
import _thread
import os
import sys

INTERRUPTED = 130
LINE = "interrupted; no file was left half written\n"


def begin() -> None:
    """From now on Ctrl-C ends the process at once, unless who started it wants it ignored."""
    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _leave)
        sys.unraisablehook = _again


def works() -> None:
    """What is needed has been imported: from now on Ctrl-C raises KeyboardInterrupt."""
    if _signal.getsignal(_signal.SIGINT) is _leave:
        _signal.signal(_signal.SIGINT, _signal.default_int_handler)


def said() -> None:
    """Says in a line that it was interrupted; what comes after that changes nothing any more."""
    end()
    sys.stderr.write(LINE)


def end() -> None:
    """The status is settled: a Ctrl-C that comes now, or once more, changes nothing of it."""
    if sys.unraisablehook is _again:  # what `begin` began
        _signal.signal(_signal.SIGINT, _signal.SIG_IGN)


def _leave(*_: object) -> None:
    os.write(2, LINE.encode())
    os._exit(INTERRUPTED)


def _again(unraisable: sys.UnraisableHookArgs) -> None:
    """An interrupt that came where Python can raise nothing (a destructor, a callback of C) comes again behind it."""
    if unraisable.exc_type is KeyboardInterrupt:
        _thread.start_new_thread(_thread.interrupt_main, ())  # from here it would come within this very hook
    else:
        sys.__unraisablehook__(unraisable)
