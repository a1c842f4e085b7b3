"""Ctrl-C at any moment: one line and status 130, never a traceback.

While modules are imported nothing is at stake, and what is imported may make anything of an exception: the process ends
at once. While a command works it is KeyboardInterrupt, so that files and drones are left in order. When it has ended
there is nothing left to interrupt.
"""

# What is imported here is imported before Ctrl-C is met: only what every Python has loaded already, or has built in.
import _signal
import _thread
import os
import sys

INTERRUPTED = 130
LINE = "interrupted; no file was left half written\n"


def begin() -> None:
    """Let Ctrl-C end the process at once, unless its parent ignores Ctrl-C."""
    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _leave)
        sys.unraisablehook = _raise_again


def raise_keyboard_interrupt() -> None:
    """Let Ctrl-C raise KeyboardInterrupt; for the time after all imports."""
    if _signal.getsignal(_signal.SIGINT) is _leave:
        _signal.signal(_signal.SIGINT, _signal.default_int_handler)


def print_interrupted() -> None:
    """Print that the command was interrupted, and ignore further Ctrl-C."""
    end()
    sys.stderr.write(LINE)


def end() -> None:
    """Ignore further Ctrl-C, since the exit status is settled."""
    if sys.unraisablehook is _raise_again:  # what `begin` began
        _signal.signal(_signal.SIGINT, _signal.SIG_IGN)


def _leave(*_: object) -> None:
    os.write(2, LINE.encode())
    os._exit(INTERRUPTED)


def _raise_again(unraisable: "sys.UnraisableHookArgs") -> None:
    """Raise an interrupt again that came where Python cannot raise (a destructor, a callback of C)."""
    if unraisable.exc_type is KeyboardInterrupt:
        _thread.start_new_thread(_thread.interrupt_main, ())  # from here it would come within this very hook
    else:
        sys.__unraisablehook__(unraisable)
