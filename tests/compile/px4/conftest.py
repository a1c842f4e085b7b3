"""Modules on the bench, each built once a worker, and a fresh process of them for each test."""

from collections.abc import Callable

import pytest

from tests.compile.px4.build import Bench
from tests.compile.px4.flown import mode
from tests.compile.px4.modules import PITCH_LOG, attitude_alone, both, motors, overflowing, pitch, rail
from twodof.compile.px4.export import make_module

OTHERS = {"overflow": overflowing, "rail": rail, "both": both, "mixer": motors, "alone": attitude_alone}


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """The module of `pitch`, built as PX4 builds it."""
    return Bench(make_module(pitch(), PITCH_LOG), tmp_path_factory.mktemp("pitch"))


@pytest.fixture
def started(built: Bench) -> Bench:
    """A fresh process, in which the module has been started."""
    built.fresh()
    built.command("start")
    return built


@pytest.fixture
def bench(started: Bench) -> Bench:
    """The same, armed in a mode in which the module commands."""
    mode(started)
    return started


@pytest.fixture(scope="session")
def benches(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Bench]:
    """A fresh process of another module; what is tested there does not depend on the optimisation."""
    made: dict[str, Bench] = {}

    def fresh(name: str) -> Bench:
        if name not in made:
            made[name] = Bench(make_module(OTHERS[name]()), tmp_path_factory.mktemp(name), "-O0")
        made[name].fresh()
        return made[name]

    return fresh
