"""The server compiles the virtual rig when it starts; a preview during that asks to come again."""

import asyncio
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.lab.served import ServedLab, served, virtual_drone
from tests.patience import patiently
from twodof.lab import lab as lab_module
from twodof.lab.processes import Workbench

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_preview_during_the_warm_up_comes_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled, do = threading.Event(), Workbench.do

    async def slow(self: Workbench, work: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        if options.get("seconds") == lab_module.WARM_UP_S:
            await asyncio.to_thread(compiled.wait)
        return await do(self, work, *arguments, **options)

    monkeypatch.setattr(Workbench, "do", slow)
    monkeypatch.setattr(lab_module, "PATIENCE_S", 0.05)
    asked = {"excitation": {"kind": "impulse", "unit": "m", "amplitude": 0.1, "width": 1.0}, "loop": "x", "drone": 1}
    with virtual_drone("lab") as url, served(tmp_path, url, warm_up=True) as server:
        lab = ServedLab(server.port, tmp_path)
        assert any(lab.call("GET", "drones")[1] for _ in patiently()), "the drone is not heard"
        try:
            found = lab.call("POST", "excitations/preview", asked)[1]
            assert (found["motion"], found["again"]) == (None, True)
            assert "is being compiled" in found["why"]
        finally:
            compiled.set()
        for _ in patiently():
            found = lab.call("POST", "excitations/preview", asked)[1]
            if not found["again"]:
                break
        assert found["motion"]["by"].startswith("the virtual rig 'lab'")
