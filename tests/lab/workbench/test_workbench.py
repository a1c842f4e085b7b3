"""The workbench: what it is asked is done in its turn, and ended when it takes too long or nobody waits for it."""

import asyncio
import io
import os
import subprocess
import time
import zipfile
from collections.abc import Callable, Coroutine
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from tests.patience import PATIENCE_S, patiently
from tests.slx.files import written
from twodof.blocks import Diagram
from twodof.blocks.library import Gain, UnitDelay
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile.toolchain import compilers
from twodof.errors import DiagramError, LogError, Rejected, Timeout, TwodofError
from twodof.flight.starters import starter
from twodof.lab import diagram_work
from twodof.lab.access import CLIENT, LabClient, Role
from twodof.lab.answers import status_of
from twodof.lab.processes import Workbench

pytestmark = pytest.mark.slow


def on_a_bench(use: Callable[[Workbench], Coroutine[Any, Any, Any]]) -> Any:
    async def run() -> Any:
        bench = Workbench()
        try:
            return await use(bench)
        finally:
            await bench.close()

    return asyncio.run(run())


def _pid() -> int:
    return os.getpid()


def _compile_for_ever(place: str) -> None:
    """A process of our own, as a compiler is, that does not end by itself."""
    with subprocess.Popen(["sleep", "600"], start_new_session=True) as compiler:
        try:
            with open(place, "w", encoding="ascii") as file:  # noqa: PTH123
                file.write(str(compiler.pid))
            compiler.wait()
        except BaseException:
            compiler.kill()
            raise


def _runs(process: int) -> bool:
    with suppress(OSError):
        os.kill(process, 0)
        return True
    return False


def test_it_stays_warm_and_says_what_is_wrong() -> None:
    async def use(bench: Workbench) -> None:
        first = await bench.do(_pid, seconds=PATIENCE_S)
        with pytest.raises(DiagramError, match="not a diagram"):
            await bench.do(diagram_work.canonical, "[]", seconds=PATIENCE_S)
        assert await bench.do(_pid, seconds=PATIENCE_S) == first != os.getpid()

    on_a_bench(use)


GROUP = Path("/proc/self/autogroup")
"""Group of a process's session on Linux, with its niceness, "/autogroup-7 nice 0"."""


@pytest.mark.skipif(not GROUP.exists(), reason="this kernel does not share the processor among sessions")
def test_a_watchers_session_is_nice() -> None:
    async def use(bench: Workbench) -> None:
        for role, niceness in ((Role.COMMAND, 0), (Role.WATCH, 10)):
            CLIENT.set(LabClient(role, "test"))
            assert (await bench.do(GROUP.read_text)).endswith(f"nice {niceness}\n")

    on_a_bench(use)


def _fill_a_disk(through_a_log: bool) -> None:
    if not through_a_log:
        Path("/dev/full").write_bytes(b"x")
    try:
        Path("/dev/full").write_bytes(b"x")
    except OSError as reason:
        raise LogError(f"cannot be written: {reason.strerror}", "/srv/flights/a.csv", "make room") from reason


@pytest.mark.parametrize("through_a_log", [False, True])
def test_a_full_disk_stays_one_outside(through_a_log: bool) -> None:
    async def use(bench: Workbench) -> None:
        with pytest.raises(TwodofError) as raised:
            await bench.do(_fill_a_disk, through_a_log, seconds=PATIENCE_S)
        assert status_of(raised.value) == 507
        assert "make room" in raised.value.remedy

    on_a_bench(use)


@pytest.mark.parametrize("why", ["late", "left"])
def test_late_and_abandoned_work_ends_with_its_compiler(why: str, tmp_path: Any) -> None:
    place = tmp_path / "pid"

    async def use(bench: Workbench) -> None:
        first = await bench.do(_pid, seconds=PATIENCE_S)

        async def gone() -> bool:
            return why == "left" and place.exists()

        began = time.monotonic()
        with pytest.raises((Timeout, Rejected)):
            await bench.do(_compile_for_ever, str(place), seconds=2.0 if why == "late" else PATIENCE_S, gone=gone)
        assert time.monotonic() - began < PATIENCE_S / 2
        assert await bench.do(_pid, seconds=PATIENCE_S) != first

    on_a_bench(use)
    for _ in patiently():
        if not _runs(int(place.read_text())):
            return


def test_a_loop_is_told_by_its_signals() -> None:
    d = starter("pid-attitude")
    del d.connections["error", "b"]
    d.connect("pid", "error.b")
    (problem,) = diagram_work.check(to_json(d))["problems"]
    assert sorted(set(problem["loop"])) == ["error.y", "pid.M"]


def test_shapes_say_which_changes_leave_a_program_as_it_is() -> None:
    forms = [{"type": "gain", "config": {"k": k}} for k in (1.0, 2.0)]
    forms += [{"type": "gain", "config": {"k": 1.0, "width": 3}}, {"type": "sum", "config": {"signs": "x"}}]
    one, other, wide, refused = diagram_work.shapes(forms)
    assert one["structure"] == other["structure"] != wide["structure"]
    assert [p["value"] for p in other["params"]] == [2.0]
    assert refused["what"] == "signs='x'"
    assert refused["remedy"]


def test_a_diagram_that_fits_no_template_is_not_compiled() -> None:
    d = Diagram("other")
    d.input("u")
    d.add("late", UnitDelay(), u="u")
    d.add("gain", Gain(2.0), u="late")
    d.output("y", "gain")
    assert diagram_work.check(to_json(d))["fine"]
    with pytest.raises(DiagramError, match="no template"):
        diagram_work.compiled(to_json(d), "lab")


def test_the_catalogue_says_what_to_run_where_nothing_can_be_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compilers, "find_zig", lambda: None)
    monkeypatch.setenv("PATH", "")
    said = diagram_work.catalogue()["not_simulated"]
    assert said.startswith("no compiler for WebAssembly was found: run `pip install ziglang`")


def simulink(folder: Path, *files: tuple[str, bytes], system: str = "") -> dict[str, Any]:
    """Return the laboratory's report on a Simulink model of these files."""
    (folder / "files").write_bytes(b"".join(content for _, content in files))
    names, sizes = [name for name, _ in files], [len(content) for _, content in files]
    return diagram_work.simulink(str(folder), names, sizes, system)


@pytest.mark.parametrize("layout", ["single", "counts", "text", "braces"])
def test_a_simulink_model_is_drawn_and_translated(tmp_path: Path, layout: str) -> None:
    model = written(layout, tmp_path)
    workspace = ("gains.m", b"g.ki = 0.25; M_MAX = 0.2;")
    (tmp_path / "in").mkdir()
    bare = simulink(tmp_path / "in", (model.name, model.read_bytes()))
    assert bare["text"] == ""
    assert {line["path"] for line in bare["report"] if line["status"] == "refused"} >= {"P gain"}
    found = simulink(tmp_path / "in", (model.name, model.read_bytes()), workspace)
    assert set(from_json(found["text"]).parts) >= {"P_gain", "limits_all"}
    assert found["svg"].startswith("<svg")
    assert ["limits//all", 3] in found["systems"]
    inner = simulink(tmp_path / "in", (model.name, model.read_bytes()), workspace, system="limits//all")
    assert set(from_json(inner["text"]).parts) == {"Saturation"}


def test_hostile_simulink_files_are_refused(tmp_path: Path) -> None:
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("simulink/blockdiagram.xml", b" " * (300 << 20))
    for content in (b"", b"PK", bomb.getvalue()):
        with pytest.raises(DiagramError):
            simulink(tmp_path, ("a.slx", content))
    with pytest.raises(DiagramError, match="nowhere"):
        simulink(tmp_path, ("single.slx", written("single", tmp_path).read_bytes()), system="nowhere")
