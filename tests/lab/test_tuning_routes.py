"""Tuning over the API on a virtual drone: transactions, undo, snapshots, files and the model's guard."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from tests.lab.served import ServedLab, served_lab
from twodof.gcs import Drone
from twodof.gcs.parameter_file import ParameterFile

pytestmark = pytest.mark.slow

WILD = {"RATE_KP": 0.12, "RATE_KD": 0.003, "ATT_KP": 15.0}
MODEL = {
    "experiment": "doublet",
    "structure": "pitch_rate_lag",
    "fixed": {"w_n": 3.437, "xi": 0.0836, "lag": 0.001},
    "estimates": {
        "mu": {"value": 358.5, "unit": "rad/s2", "sigma": 9.0, "sigma_robust": 12.0},
        "dead_time": {"value": 0.0185, "unit": "s", "sigma": 0.0005, "sigma_robust": 0.0005},
    },
    "correlation": [[1.0, 0.3], [0.3, 1.0]],
    "noise": {"q": 0.01},
}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedLab]:
    with served_lab(tmp_path_factory.mktemp("lab"), watch_token="only-to-look") as found:
        yield found


@pytest.fixture(autouse=True)
def as_at_first(lab: ServedLab) -> Iterator[None]:
    yield
    lab.call("PUT", "tuning/1/model", {"model": None})
    rows = lab.call("GET", "drones/1/parameters")[1]
    tuned = [row for row in rows if row["tuning"] and not row["same_as"]]
    moved = {row["name"]: row["default"] for row in tuned if row["value"] != row["default"]}
    if moved:
        assert lab.call("PATCH", "drones/1/parameters", moved)[0] == 200


def value(lab: ServedLab, name: str) -> float:
    return {row["name"]: row["value"] for row in lab.call("GET", "drones/1/parameters")[1]}[name]


def test_several_are_changed_together_or_not_at_all_and_taken_back(lab: ServedLab) -> None:
    status, told = lab.call("PATCH", "drones/1/parameters", {"RATE_KP": 0.07, "RATE_KI": 0.2})
    assert status == 200
    assert told["changed"][0] == {"name": "RATE_KP", "before": 0.0854, "value": 0.07}
    status, told = lab.call("PATCH", "drones/1/parameters", {"RATE_KI": 0.1, "RATE_KP": 7.0})
    assert status == 422
    assert "RATE_KP" in told["where"]
    assert value(lab, "RATE_KI") == 0.2, "nothing was changed"
    assert lab.call("POST", "drones/1/parameters/undo")[0] == 200
    assert (value(lab, "RATE_KP"), value(lab, "RATE_KI")) == (0.0854, 0.251)


def test_what_somebody_has_changed_since_is_not_taken_back(lab: ServedLab) -> None:
    assert lab.call("PATCH", "drones/1/parameters", {"POS_KP": 1.0})[0] == 200
    with Drone.connect(lab.call("GET", "drones")[1][0]["url"]) as script:
        script.parameters["POS_KP"] = 1.1
    status, told = lab.call("POST", "drones/1/parameters/undo")
    assert (status, told["what"]) == (409, "POS_KP changed since then")
    assert value(lab, "POS_KP") == 1.1


def test_a_snapshot_says_what_it_would_change_and_brings_it_back(lab: ServedLab) -> None:
    assert lab.call("POST", "drones/1/parameters/snapshots", {"name": "first", "note": "as delivered"})[0] == 201
    assert lab.call("POST", "drones/1/parameters/snapshots", {"name": "first"})[0] == 409, "it is there already"
    lab.call("PATCH", "drones/1/parameters", {"ATT_KP": 9.0})
    told = lab.call("GET", "drones/1/parameters/snapshots/first")[1]
    changes = {row["name"]: (row["before"], row["value"]) for row in told["changes"]}
    assert changes == {"ATT_KP": (9.0, 11.0)}, "once, though it has two names"
    assert lab.call("PATCH", "drones/1/parameters", {name: row[1] for name, row in changes.items()})[0] == 200
    assert lab.call("GET", "drones/1/parameters/snapshots/first")[1]["changes"] == []
    lab.call("PATCH", "drones/1/parameters", {"ATT_KP": 9.0})
    assert told["about"]["Note"] == "as delivered"
    lab.call("POST", "drones/1/parameters/snapshots", {"name": "second"})
    told = lab.call("GET", "drones/1/parameters/snapshots/second?other=first")[1]
    assert {"name": "ATT_KP", "before": 11.0, "value": 9.0} in told["changes"]
    assert [row["name"] for row in lab.call("GET", "drones/1/parameters/snapshots")[1]] == ["second", "first"]
    for name in ("first", "second"):
        assert lab.call("DELETE", f"drones/1/parameters/snapshots/{name}")[0] == 204
    assert lab.call("GET", "drones/1/parameters/snapshots/first")[0] == 404


def test_a_deleted_log_has_no_steps(lab: ServedLab) -> None:
    status, told = lab.call("POST", "tuning/1/measured", {"log": "deleted-meanwhile.mcap"})
    assert (status, told["steps"], told["unclear"]) == (200, [], "there is no such log")


def test_the_file_is_read_back_and_by_anybody_who_reads_tabs(lab: ServedLab) -> None:
    _, content = lab.call("GET", "drones/1/parameters/file")
    assert isinstance(content, bytes)
    file = ParameterFile.read(content)
    assert file.values["RATE_KP"] == 0.0854
    assert all(len(line.split("\t")) == 5 for line in content.decode().splitlines() if not line.startswith("#"))
    assert lab.call("POST", "drones/1/parameters/file", content)[1]["changes"] == []
    other = content.replace(b"RATE_KP\t0.0854", b"RATE_KP\t0.070000000298023224") + b"1\t1\tNOT_HERE\t1\t6\n"
    told = lab.call("POST", "drones/1/parameters/file", other)[1]
    assert [(row["name"], row["before"]) for row in told["changes"]] == [("RATE_KP", 0.0854)]
    assert told["missing"] == ["NOT_HERE"]
    status, told = lab.call("POST", "drones/1/parameters/file", b"no parameters\n")
    assert (status, told["where"]) == (422, "the file, line 1")


class TestGuard:
    """A model that is chosen guards the gains."""

    @pytest.fixture(autouse=True)
    def chosen(self, lab: ServedLab) -> None:
        if lab.call("GET", "models/careful")[0] == 404:
            assert lab.call("PUT", "models/careful", MODEL)[0] == 201
        assert lab.call("PUT", "tuning/1/model", {"model": "careful"})[1]["model"] == "careful"

    @pytest.mark.long
    def test_unstable_gains_need_a_confirmation(self, lab: ServedLab) -> None:
        status, told = lab.call("PATCH", "drones/1/parameters", WILD)
        assert status == 409
        assert "unstable within the uncertainty" in told["what"]
        assert value(lab, "RATE_KP") == 0.0854
        # By the real drone's names it is the same law.
        assert lab.call("PATCH", "drones/1/parameters", {"FC_PARAM_6": 0.003, "FC_PARAM_4": 0.12})[0] == 409
        shown = lab.call("POST", "tuning/1/preview", {"changes": WILD})[1]
        assert shown["unstable"]
        assert shown["touches"]
        calm = lab.call("POST", "tuning/1/preview", {"changes": {"RATE_KP": 0.08}})[1]
        assert not calm["unstable"]
        assert lab.call("PATCH", f"drones/1/parameters?confirm={calm['confirm']}", WILD)[0] == 409, "another's token"
        assert lab.call("PATCH", f"drones/1/parameters?confirm={shown['confirm']}", WILD)[0] == 200
        assert value(lab, "RATE_KD") == 0.003
        # To take back what makes them calm is such a change too.
        assert lab.call("PATCH", "drones/1/parameters", {"RATE_KP": 0.0854, "RATE_KD": 0.0, "ATT_KP": 11.0})[0] == 200
        status, told = lab.call("POST", "drones/1/parameters/undo")
        assert status == 409
        assert "unstable within the uncertainty" in told["what"]
        assert value(lab, "RATE_KD") == 0.0
        status, told = lab.call("POST", f"drones/1/parameters/undo?confirm={shown['confirm']}")
        assert status == 200
        assert {"name": "RATE_KP", "before": 0.0854, "value": 0.12} in told["changed"]

    def test_stable_gains_and_other_parameters_pass(self, lab: ServedLab) -> None:
        assert lab.call("PATCH", "drones/1/parameters", {"RATE_KP": 0.08, "POS_KP": 1.0})[0] == 200

    def test_a_preview_has_the_band_the_margins_and_the_figures(self, lab: ServedLab) -> None:
        told = lab.call("POST", "tuning/1/preview", {"changes": {"ATT_KP": 8.0}, "goal": 0.1})[1]
        assert set(told["loops"]) == {"motors", "rate", "attitude"}
        band = told["bands"]["theta"]
        assert len(band["low"]) == len(told["time"])
        assert band["middle"][-1] == pytest.approx(0.1, rel=0.1), "the estimate comes to its goal"
        assert all(low <= high for low, high in zip(band["low"], band["high"], strict=True))
        assert told["figures"]["rise_time"]["low"] <= told["figures"]["rise_time"]["high"]
        assert "RATE_KP" in told["parameters"]

    def test_a_step_alone_lies_within_the_previews_band(self, lab: ServedLab) -> None:
        asked = {"changes": {"ATT_KP": 8.0}, "goal": 0.1}
        whole, alone = (lab.call("POST", f"tuning/1/{what}", asked)[1] for what in ("preview", "step"))
        assert (alone["time"], alone["goal"]) == (whole["time"], whole["goal"])
        band, middle = whole["bands"]["theta"], alone["bands"]["theta"]["middle"]
        assert all(low < m < high for low, m, high in zip(band["low"], middle, band["high"], strict=True) if m)

    @pytest.mark.parametrize("asked", [{"changes": {"RATE_KP": True}}, {"changes": {}, "goal": "0.1"}])
    def test_only_a_number_is_previewed_as_a_number(self, lab: ServedLab, asked: dict[str, object]) -> None:
        status, told = lab.call("POST", "tuning/1/preview", asked)
        assert status == 422, told
        assert "valid number" in told["what"]

    @pytest.mark.parametrize("damaged", [b"", b"\xff", b"[1]", b'{"1": 5}'])
    def test_a_damaged_choice_guards_nothing_and_is_made_anew(self, lab: ServedLab, damaged: bytes) -> None:
        (lab.folder / "models" / ".chosen").write_bytes(damaged)
        status, told = lab.call("GET", "tuning/1")
        assert (status, told["model"]) == (200, None)
        assert lab.call("PUT", "tuning/1/model", {"model": "careful"})[1]["model"] == "careful"

    def test_a_watcher_may_preview_and_not_change(self, lab: ServedLab) -> None:
        watcher = replace(lab, token="only-to-look")
        assert watcher.call("GET", "tuning/1")[0] == 200
        assert watcher.call("POST", "tuning/1/preview", {"changes": {}, "goal": 9.0})[0] == 422, "let in, and read"
        assert watcher.call("PATCH", "drones/1/parameters", {"RATE_KP": 0.08})[0] == 403
        assert watcher.call("PUT", "tuning/1/model", {"model": None})[0] == 403
        assert watcher.call("POST", "drones/1/parameters/snapshots", {"name": "x"})[0] == 403
        assert watcher.call("DELETE", "models/careful")[0] == 403


@pytest.mark.long
@pytest.mark.parametrize("name", ["..%2Fup", "a%2Fb", ".chosen"])
def test_a_models_name_stays_in_its_folder(lab: ServedLab, name: str) -> None:
    assert lab.call("PUT", f"models/{name}", MODEL)[0] in (404, 405, 422)
    assert lab.call("GET", f"models/{name}")[0] in (404, 422)
    assert not list(Path(lab.folder).glob("*.json"))


@pytest.mark.long
def test_a_model_that_is_none_is_listed_with_the_reason(lab: ServedLab) -> None:
    assert lab.call("PUT", "models/broken", {"estimates": {"mu": "no"}})[0] == 201
    row = next(row for row in lab.call("GET", "models")[1] if row["name"] == "broken")
    assert not row["pitch"]
    assert row["why"]
    status, told = lab.call("PUT", "tuning/1/model", {"model": "broken"})
    assert (status, bool(told["remedy"])) == (422, True)
    assert lab.call("DELETE", "models/broken")[0] == 204
    json.dumps(row)
