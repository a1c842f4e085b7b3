"""A virtual drone in a thread of its own, for the synchronous face; what it did on board, step by step."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from twodof.fcu.control.flight_code import ControlStep
from twodof.flightlog.log import Channel
from twodof.flightlog.steps import step_channels
from twodof.gcs.loop_thread import LoopThread
from twodof.sim.virtual_drone import VirtualDrone


class OnBoard:
    """A virtual drone at `url` and every step that it made."""

    def __init__(self, drone: VirtualDrone, url: str) -> None:
        self.drone = drone
        self.url = url
        self.steps: list[ControlStep] = []
        self.truth: list[tuple[float, float, float, float]] = []
        drone.controller.bus.subscribe(ControlStep, self._seen)

    def _seen(self, step: ControlStep) -> None:
        self.steps.append(step)

    def channels(self) -> dict[str, Channel]:
        """The drone's own log of these steps, by .mat names."""
        sample = ("acc_x", "acc_y", "acc_z", "gyro_x", "gyro_y", "gyro_z", "dist", "dist_new", "voltage", "charge")
        flown = ("theta", "q", "x", "v", "theta0", "q0", "x0", "v0", "M", "T")
        out: dict[str, Any] = {name: np.array([getattr(step.sample, name) for step in self.steps]) for name in sample}
        out |= {name: np.array([getattr(step, name) for step in self.steps]) for name in flown}
        mode = np.array([step.asked.mode for step in self.steps], dtype=np.int32)
        return step_channels(np.array([step.tick for step in self.steps], dtype=np.int64), out, mode)


@contextmanager
def on_board(
    listen: str = "tcpin://127.0.0.1:0", spoil: Callable[[VirtualDrone], None] = lambda drone: None, **options: Any
) -> Iterator[OnBoard]:
    """A virtual drone that listens while the block runs; `spoil` is called with it before."""
    runner = LoopThread("virtual drone")
    try:

        async def start() -> OnBoard:
            drone = VirtualDrone(**options)
            spoil(drone)
            await drone.__aenter__()
            listening = await drone.listen(listen)
            return OnBoard(drone, listening.replace("in://", "://"))

        async def stop() -> None:
            await there.drone.__aexit__(None, None, None)

        there = runner.run(start())
        try:
            yield there
        finally:
            runner.run(stop())
    finally:
        runner.close()
