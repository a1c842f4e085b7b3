"""The module of `pitch`, built once a worker, and a fresh process of it for each test."""

from __future__ import annotations

import pytest

from tests.compile.px4.build import Bench
from tests.compile.px4.modules import PITCH_LOG, pitch
from twodof.compile.px4.export import make_module


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """The module of `pitch`."""
    return Bench(make_module(pitch(), PITCH_LOG), tmp_path_factory.mktemp("pitch"))


@pytest.fixture
def bench(built: Bench) -> Bench:
    """A fresh process, in which the module has been started."""
    built.fresh()
    built.command("start")
    return built
