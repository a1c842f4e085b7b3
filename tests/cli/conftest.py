"""A command line that runs in this process."""

from collections.abc import Sequence

import pytest

from tests.cli.program import Said, Shell
from twodof.cli.app import run


@pytest.fixture
def shell(capfd: pytest.CaptureFixture[str]) -> Shell:
    """Run arguments, check the exit status, and return everything printed since the last call."""

    def answer(arguments: Sequence[str], status: int = 0) -> Said:
        found = run(arguments)
        said = Said(*capfd.readouterr())
        assert found == status, said
        return said

    return answer
