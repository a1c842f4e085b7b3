"""What the workbench tells the editor before anything is drawn."""

import pytest

from twodof.compile.toolchain import compilers
from twodof.lab import diagram_work


def test_the_catalogue_says_what_to_run_where_nothing_can_be_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compilers, "find_zig", lambda: None)
    monkeypatch.setenv("PATH", "")
    said = diagram_work.catalogue()["not_simulated"]
    assert said.startswith("there is no compiler for WebAssembly: run `make sandbox`")
