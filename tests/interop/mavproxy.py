"""MAVProxy without a screen: a process to whose commands one writes and in whose words one waits for an answer."""

from __future__ import annotations

import queue
import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.patience import PATIENCE_S

PROGRAM = Path(sys.executable).with_name("mavproxy.py")


class MavProxy:
    """`mavproxy.py --master=URL`, driven by its standard input. A context manager."""

    def __init__(self, master: str, folder: Path) -> None:
        modules = "link,param,arm,mode,signing,log,fence"  # what its default list has and needs no screen
        self._process = subprocess.Popen(
            [sys.executable, "-u", str(PROGRAM), f"--master={master}", "--no-state", f"--default-modules={modules}"],
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            bufsize=1,
        )
        self._heard: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.text = ""
        self._read = 0
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._process.kill()
        self._process.wait(PATIENCE_S)
        self._thread.join(PATIENCE_S)
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    def type(self, command: str) -> None:
        """Enter a command."""
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()

    def expect(self, pattern: str, seconds: float = PATIENCE_S) -> re.Match[str]:
        """Wait for `pattern` in what it says after the last match; else AssertionError with everything it said."""
        end = time.monotonic() + seconds
        while (found := re.search(pattern, self.text[self._read :])) is None:
            left = end - time.monotonic()
            assert left > 0, f"no {pattern!r} within {seconds} s in:\n{self.text}"
            try:
                self.text += self._heard.get(timeout=left)
            except queue.Empty:
                continue
        self._read += found.end()
        return found

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._heard.put(line)
