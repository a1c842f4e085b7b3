"""Flashing over the API: rehearsed for this drone and confirmed, or not at all."""

import os
from collections.abc import Iterator
from typing import Any

import pytest

from tests.lab.served import ServedLab, served_lab
from tests.patience import patiently
from tests.processes import child, stopped
from twodof.blocks.schema.json_form import to_json
from twodof.flight.starters import starter

pytestmark = pytest.mark.slow

OWN = to_json(starter("notch-attitude"))
WILD = to_json(starter("pid-attitude")).replace('"value": 0.0854', '"value": 0.9')


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedLab]:
    with served_lab(tmp_path_factory.mktemp("lab")) as found:
        yield found


def over(lab: ServedLab, job: dict[str, Any], state: str) -> dict[str, Any]:
    """Return the job at its end, in this state."""
    told: dict[str, Any] = lab.ended((202, job))
    assert told["state"] == state, told
    return told


def rehearsed(lab: ServedLab, text: str) -> tuple[str, dict[str, Any]]:
    status, job = lab.call("POST", "diagrams/rehearsal", {"text": text, "drone": 1})
    assert status == 202
    return job["id"], over(lab, job, "done")["result"]


@pytest.mark.long
def test_only_rehearsed_diagrams_are_flashed(lab: ServedLab) -> None:
    job, found = rehearsed(lab, OWN)
    assert found["template"] == "attitude_control"
    assert found["trial"]["fault"] is None
    assert found["against"] == "the stock controller"
    assert any(change["path"] == "notch" and change["kind"] == "added" for change in found["changes"])
    status, refused = lab.call("POST", "diagrams/flash", {"text": WILD, "drone": 1, "rehearsal": job})
    assert (status, refused["what"]) == (409, "this diagram was not rehearsed for this drone")
    flashed = {"text": OWN, "drone": 1, "rehearsal": job}
    with stopped(child(os.getpid(), "fcu")):  # or it might have all of the diagram, and build it, before we end the job
        status, sent = lab.call("POST", "diagrams/flash", flashed)
        assert status == 202
        status, refused = lab.call("POST", "diagrams/flash", flashed)
        assert (status, refused["what"]) == (409, "another diagram is being flashed there")
        over(lab, lab.call("DELETE", f"jobs/{sent['id']}")[1], "cancelled")
    sent = lab.call("POST", "diagrams/flash", flashed)[1]
    for _ in patiently():
        told = lab.call("GET", f"jobs/{sent['id']}")[1]
        if told["bound"]:
            break
    with stopped(child(os.getpid(), "fcu")):  # or it might be done
        assert told["text"] == "the drone builds it"
        status, refused = lab.call("DELETE", f"jobs/{sent['id']}")
        assert (status, refused["what"]) == (409, "the job cannot be ended now: the drone builds it")
    over(lab, sent, "done")
    wild, found = rehearsed(lab, WILD)
    assert found["against"] == "what flies on drone 1"
    assert any(change["path"] == "notch" and change["kind"] == "removed" for change in found["changes"])
    assert found["trial"]["fault"]
    status, refused = lab.call("POST", "diagrams/flash", {"text": WILD, "drone": 1, "rehearsal": wild})
    assert status == 409
    assert "unstable" in refused["what"]
