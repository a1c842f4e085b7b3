"""The whole walk: fly, cut, identify, compare. What `twodof demo` does, a machine at a time."""

from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from twodof.errors import ExperimentError
from twodof.experiment.experiments import IDENTIFICATION, Experiment
from twodof.experiment.flight import Flight, Laboratory
from twodof.flight.gains import NAMED
from twodof.flightlog.files import read_log
from twodof.flightlog.log import FlightLog
from twodof.flightlog.public_data import PUBLIC_LOGS
from twodof.identify.experiments import KINDS, around, cut
from twodof.identify.information import predict
from twodof.identify.ready_made import FlownMachine
from twodof.identify.record import Record
from twodof.models.structures import pitch_rate
from twodof.report.characterisation.characterise import FORCED, ExperimentRecords, characterise
from twodof.report.characterisation.compose import CharacterisedMachine
from twodof.report.content import ReportTable
from twodof.report.wording import plain, power_of_ten, table
from twodof.rig.parameters import lab, load_rig
from twodof.rig.rig import model_parameters
from twodof.sim.replay import replay
from twodof.sim.resimulation import resimulate

StepProgress = Callable[[str], None]
"""Called with what is begun."""

REPETITIONS = 10
"""Flights of each experiment on a virtual rig, seeds from 1: their spread is the one sigma of a reading by hand."""

_PAPER_EXPERIMENT = {"impulse": "impulse", "doublet": "doublet", "velocity": "velocity-doublet"}

_TEXTS = table("demonstration.toml")

Fly = Callable[[Experiment, int], Flight]
"""Flies an experiment with the noise of a seed."""


def virtual(
    laboratory: Laboratory, fly: Fly, progress: StepProgress, repetitions: int = REPETITIONS
) -> CharacterisedMachine:
    """Fly the paper's experiments by `fly` on the rig of `laboratory` ("paper" or "lab") and identify.

    `fly` is `laboratory.fly`, or flies over MAVLink on a drone of that rig. A flight that was broken off
    is left out, and said. Raises ExperimentError or IdentificationError where the rig cannot be flown or the models be
    found at all.
    """
    rig = laboratory.rig_name
    records: dict[str, list[Record]] = {}
    surroundings, remarks, broken_off = {}, [], []
    for kind, name in _PAPER_EXPERIMENT.items():
        progress(f"{rig}: look at {name}, {repetitions} flights")
        records[kind] = []
        for seed in range(1, repetitions + 1):
            flight = fly(IDENTIFICATION[name], seed)
            if flight.reason:
                broken_off.append((name, seed, flight.reason))
                continue
            record = cut(flight.log, KINDS[kind], name=f"{name} {seed}")
            records[kind].append(record)
            surroundings[record.name] = around(flight.log, record)
            remarks += [f"{name} {seed}: {check.name}, {check.seen}." for check in flight.checks if not check.passed]
    progress(f"{rig}: identify")
    if lacking := [kind for kind, found in records.items() if not found]:
        raise ExperimentError(
            f"every {lacking[0]} was broken off", f"rig '{rig}'", f"the last: {broken_off[-1][2]}; fly it gentler"
        )
    flights = ExperimentRecords(
        records["impulse"],
        records["doublet"],
        records["velocity"],
        machine=FlownMachine(rig),
        surroundings=surroundings,
    )
    found = characterise(flights, dry_friction=laboratory.parameters["coulomb_idle"] > 0.0)
    truth = truth_of(laboratory.parameters.snapshot())
    text = _TEXTS["machines"][rig]
    if broken_off:
        told = "; ".join(f"{name} {seed}: {escape(reason)}" for name, seed, reason in broken_off)
        text = f"{text} {_TEXTS['broken_off']['text']} {told}."
    return CharacterisedMachine(f"virtual rig “{rig}”", text, found, truth, remarks)


def planned(machines: Mapping[str, CharacterisedMachine]) -> ReportTable:
    """Return the uncertainties predicted for the doublet by Fisher information beside the found ones, by rig name."""
    rows: list[tuple[str, ...]] = []
    structure = pitch_rate(lag=True)
    for name, machine in machines.items():
        found, doublet = machine.found, machine.found.flights.doublets[0]
        if found.forced is None:
            continue
        rig = load_rig(name)
        lag = max(rig["lag"], structure.unknowns["lag"].lower)
        information = predict(
            structure,
            {"M": doublet.inputs["M"]},
            doublet.dt,
            {"q": float(np.hypot(rig["gyro_hover"], rig["gyro_line"]))},
            values={key: machine.truth[key] for key in ("w_n", "xi", "mu")}
            | {"lag": lag, "dead_time": machine.truth["tau"] - lag},
            estimate=FORCED,
            disturbance=found.forced.disturbance,
        )
        spreads = np.linalg.inv(information.matrix)
        for key, unit, scale in (("mu", "rad/s²", 1.0), ("tau", "ms", 1e3)):
            parts = [information.labels.index(part) for part in structure.sums.get(key, (key,))]
            predicted = scale * float(np.sqrt(spreads[np.ix_(parts, parts)].sum()))
            spread = found.spreads.get(key)
            rows.append(
                (
                    f"{machine.name}, {'μ' if key == 'mu' else 'τ'}",
                    unit,
                    plain(predicted, 2),
                    plain(scale * found.greybox[key].sigma, 2),
                    "–" if spread is None else plain(scale * spread.value, 2),
                )
            )
    return _table("planned", rows)


def _table(name: str, rows: Sequence[Sequence[str]]) -> ReportTable:
    return ReportTable(name, rows=rows, **_TEXTS["tables"][name])


def truth_of(rig: Mapping[str, float]) -> dict[str, float]:
    """Return the true parameters of Table 1 (SI) of a virtual rig; dry friction if it has any."""
    known = model_parameters(rig)
    dry = {name: known[name] for name in ("coulomb", "hardening") if known[name] > 0.0}
    return {name: known[name] for name in ("w_n", "xi", "mu", "tau", "k_v", "p_v")} | dry


def real(logs: Mapping[str, Path], progress: StepProgress) -> CharacterisedMachine | None:
    """Identify the real drone from the public logs on this computer; return None without any of the three."""
    needed = {stem: read_log(logs[stem]) for stem in dict.fromkeys(row[0] for row in _REAL) if stem in logs}
    if not needed:
        return None
    progress("real drone: identify")
    return CharacterisedMachine(
        "real drone", _TEXTS["machines"]["real"], characterise(_real_flights(needed), dry_friction=True), {}
    )


_REAL = (
    ("free-response-impulse", "impulse", None, "free response"),
    # From the moment in which the motors start: before, nothing moves.
    ("doublet-0.03", "doublet", (244.66, 245.75), "doublet"),
    ("velocity-doublets-0.25", "velocity", (151.0, 155.2), "velocity doublet 1"),
    ("velocity-doublets-0.25", "velocity", (155.0, 159.2), "velocity doublet 2"),
)
"""The public logs that hold the experiments: file stem, kind, window [s] on the log's axis, name of the record."""


def _real_flights(logs: Mapping[str, FlightLog]) -> ExperimentRecords:
    records: dict[str, list[Record]] = {kind: [] for kind in KINDS}
    surroundings = {}
    for stem, kind, window, name in _REAL:
        if stem in logs:
            record = cut(logs[stem], KINDS[kind], window, name)
            records[kind].append(record)
            surroundings[name] = around(logs[stem], record)
    # The drone was at rest at M = 0 when the motors started; the velocity loop gave no doublet of pitch to read.
    return ExperimentRecords(
        records["impulse"],
        records["doublet"],
        records["velocity"],
        by_hand=frozenset({"pitch"}),
        trim=0.0,
        gyro_bias=True,
        surroundings=surroundings,
    )


def comparisons(logs: Mapping[str, Path], progress: StepProgress) -> list[ReportTable]:
    """Compare compiled code with the real flights: the laws replayed, and the lab rig flown like them."""
    replayed, flown = [], []
    rig = lab()
    for name, known in PUBLIC_LOGS.items():
        if name not in logs:
            continue
        progress(f"real drone: replay {name}")
        log = read_log(logs[name])
        laws = replay(log, NAMED[known.gains])
        if laws.nrms:
            shown = (power_of_ten(laws.nrms[c]) if c in laws.nrms else "–" for c in ("M", "q0", "theta0", "T"))
            replayed.append((name, *shown, f"{100.0 * min(laws.coverage.values()):.0f} %"))
        fit = resimulate(log, rig, NAMED[known.gains], known.window).fit
        flown.append((name, *(f"{fit[c]:.1f}" if c in known.compared else "–" for c in ("theta", "q", "x", "v"))))
    if not flown:
        return []
    return [_table("replay", replayed), _table("like", flown)]
