"""A small load on the server: every client that reads gets every row, also beside one that reads nothing.

That no control period is missed is for the benchmark to say, on a machine that does nothing else.
"""

import pytest

from bench.stack import lab_clients

pytestmark = pytest.mark.slow


@pytest.mark.long
@pytest.mark.waits
def test_no_client_starves_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lab_clients, "SETTLES_S", 1.0)
    figures = {figure.name: figure for figure in lab_clients.measure(2, 4, 2.0)}
    assert figures["rows that the worst served client got"].value == 1.0
    assert figures["rows dropped for clients that read"].value == 0.0
    # What the server gained is for the benchmark too: in two seconds it has not settled.
