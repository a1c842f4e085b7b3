"""Virtual drones in lockstep for tests: in a process of their own, or in a thread, where a test can spoil them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bench.stack.programs import Running, running
from tests.gcs.virtual import on_board
from twodof.sim.virtual_drone import VirtualDrone


@contextmanager
def drone_process(folder: Path, rig: str, *options: str) -> Iterator[tuple[Running, str]]:
    """`twodof fcu` with `options` that keeps its state in `folder`, and its URL."""
    arguments = ("fcu", "--rig", rig, "--listen", "tcpin://127.0.0.1:0", "--state", str(folder), *options)
    with running(*arguments, urls=1, folder=folder) as program:
        yield program, program.urls[0].replace("tcpin", "tcp")


@contextmanager
def drone_thread(spoil: Callable[[VirtualDrone], None] = lambda drone: None, **options: Any) -> Iterator[str]:
    """The URL of a virtual drone in a thread; `spoil` is called with it before it runs."""
    with on_board(spoil=spoil, **({"lockstep": True} | options)) as there:
        yield there.url
