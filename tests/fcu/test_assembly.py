"""The whole program put together: what it says of itself."""

from __future__ import annotations

import pytest

from tests.fcu.assembled import INTERVAL, Assembled
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.link.mavlink.dialect import message_id


def test_who_wants_to_know_what_flies_in_every_period_takes_no_time_to_fly(monkeypatch: pytest.MonkeyPatch) -> None:
    """All parameters are looked through once a change, not once a message, and no message tells an old count."""
    looked = []
    count = ParameterStore.changed

    def changed(store: ParameterStore) -> dict[str, float]:
        looked.append(store)
        return count(store)

    monkeypatch.setattr(ParameterStore, "changed", changed)
    there = Assembled()
    there.command(INTERVAL, float(message_id("TWODOF_RIG")), 4000.0)
    counts = []
    for value in (0.5, 0.6, 0.6):
        there.run(50)
        there.sent.clear()
        there.run(50)
        told = {got.changed for got in there.sent if got.get_type() == "TWODOF_RIG"}
        assert len([got for got in there.sent if got.get_type() == "TWODOF_RIG"]) == 50
        counts.append(told)
        there.drone.assembly.store.set("THRUST_BAR", value)
    there.drone.assembly.store.set("THRUST_BAR", 0.5)
    there.sent.clear()
    there.run(50)
    counts.append({got.changed for got in there.sent if got.get_type() == "TWODOF_RIG"})
    assert counts == [{0}, {1}, {1}, {1}]
    assert len(looked) <= 5
