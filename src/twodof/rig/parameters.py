"""Two named sets of rig parameters, `paper` and `lab`, each number with its origin; sets as JSON files."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from twodof.errors import LogError, ParameterError
from twodof.flightlog.atomic import atomic_write, check_free
from twodof.flightlog.provenance import read_bytes, text_of
from twodof.models.plant import PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX, thrust_curve
from twodof.parameters import Parameter, ParameterSet
from twodof.rig.rig import rig_params
from twodof.rig.rotors import lift
from twodof.signals import HOVER, Q_AGE

CONDITIONS = frozenset(
    (
        *(f"{name}_start" for name in ("theta", "q", "x", "v", "wake", "charge", "polarised")),
        *(f"{name}_bias" for name in ("acc", "gyro", "tof")),
        *("rings", "ring_place", "rail_force", "trim", "tof_phase", "noise", "seed"),
    )
)
"""Parameters of the rig diagram that belong to one flight (how it starts, trims and biases), not to the machine."""

_MASS = 0.374 + 0.160
_FULL = 1e9  # a battery that does not sag


def _paper() -> dict[str, tuple[float, str]]:
    pitch, cart = PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX
    mu_idle, pulse = 130.0, 0.1
    curve = thrust_curve(mu_idle, pitch.mu, pulse, HOVER)
    pair_thrust = cart.k_v * _MASS / (2.0 * lift(HOVER, curve))
    inertia = 0.1 * pair_thrust / (mu_idle / (1.0 - curve + curve * pulse))
    viscous = 2.0 * pitch.xi * pitch.w_n * inertia
    fit = "the paper's mu 358.5 at T = .4, and 130 at T = 0, M = .1 (our assumption)"
    return {
        "pair_thrust": (pair_thrust, "paper Table 1: k_v 4.748 at T = .4"),
        "curve": (curve, fit),
        "inertia": (inertia, fit),
        # The rig samples q in the tick in which M is computed, so the age of q is part of its delay.
        "delay": (pitch.tau + Q_AGE, "paper section 4.1: tau 20 ms; with the age of q when M is computed"),
        "lag": (0.0, "the paper's model has a pure delay"),
        "offset": (0.0, "the paper's model has no coupling of pitch and cart"),
        "spring": (pitch.w_n**2 * inertia, "paper section 4.1: w_n 3.437 rad/s"),
        "softening": (0.0, "the paper's model is linear"),
        "hardening": (0.0, "the paper's model is linear"),
        "viscous_idle": (viscous, "paper section 4.1: xi 0.0836"),
        "viscous_run": (viscous, "paper section 4.1: xi 0.0836"),
        "coulomb_idle": (0.0, "the paper's model is linear"),
        "coulomb_run": (0.0, "the paper's model is linear"),
        "rail_viscous": (cart.p_v * _MASS, "paper Table 1: p_v 1.168"),
        "rail_coulomb": (0.0, "the paper's model is linear"),
        "trim_start": (0.0, "not in the paper"),
        "wake_fade": (0.0, "not in the paper"),
        "gust": (0.0, "the paper's model has no disturbance"),
        "gyro_hover": (0.06, "hover noise of q in the logs, taken as measurement noise"),
        "tof_age": (0.0, "not in the paper"),
        **dict.fromkeys(("imu_below", "imu_ahead"), (0.0, "not in the paper")),
        "capacity": (_FULL, "the paper's thrust is constant"),
        "resistance": (0.0, "the paper's thrust is constant"),
    }


_CALIBRATED = "calibrate.py on the seven logs"
_BY_ARM = "calibrate.py on the seven logs, for an arm of 0.1 m: a flight shows arm / inertia only"

CALIBRATED: Mapping[str, str] = MappingProxyType(
    {
        "pair_thrust": "calibrate.py on the seven logs, for the masses as weighed",
        "delay": _CALIBRATED + "; with the .4 ms that a gyro sample is old when M is computed",
        **dict.fromkeys(("inertia", "offset", "softening", "hardening", "viscous_idle", "viscous_run"), _BY_ARM),
        **dict.fromkeys(("coulomb_idle", "coulomb_run"), _BY_ARM),
        **dict.fromkeys(("curve", "lag", "rail_viscous", "rail_coulomb"), _CALIBRATED),
        **dict.fromkeys(("trim_start", "wake_lag", "wake_fade", "tof_age", "imu_below"), _CALIBRATED),
    }
)
"""The parameters that the calibration finds, and how; the file lab.json keeps them."""

_SPECTRUM = "logs, level holds: tools/hover_spectra.py"

_LAB: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(("acc_x_hover", "acc_z_hover", "gyro_hover"), _SPECTRUM + ", between the rotors' lines"),
        **dict.fromkeys(
            ("acc_x_idle", "acc_z_idle"), _SPECTRUM + ", below 10 Hz. At rest .03, and lines of idling rotors"
        ),
        **dict.fromkeys(("vibration_hz", "vibration_r2"), _SPECTRUM + ": even from 40 to 100 Hz"),
        **dict.fromkeys(("acc_x_line", "acc_z_line", "gyro_line"), _SPECTRUM + ", 15 to 60 Hz, cart free"),
        "imu_ahead": "logs, level holds: acc_z against the turning, 4 to 8 Hz",
        "ring_shake": _SPECTRUM + ", cart locked against free: 1.0 to .5 (x), 1.6 to .7 m/s2 (z)",
        **dict.fromkeys(
            ("resistance", "polarised_share", "polarised_time"),
            "logs: the rotors lose 9 to 12 of 285 turns a second in hover, in 5 to 11 s; by the battery: a guess",
        ),
    }
)
"""Origins of numbers that only `lab` has, besides `CALIBRATED`."""

_SHARED = MappingProxyType(
    {
        **dict.fromkeys(("mass_drone", "mass_cart"), "weighed"),
        **dict.fromkeys(("rail_bounce", "ring_play"), "assumed"),
        **dict.fromkeys(("pitch_stop", "pitch_bounce"), "logs: doublet-0.03 after 245.8 s"),
        **dict.fromkeys(("voltage_full", "voltage_empty"), "three lithium-polymer cells"),
        **dict.fromkeys(("acc_x_idle", "acc_z_idle", "gyro_idle", "tof_noise"), "logs, motors idle"),
        **dict.fromkeys(("acc_x_hover", "acc_z_hover"), "logs, level holds"),
        **dict.fromkeys(("vibration_hz", "vibration_r2"), "logs, level holds: spectrum of acc"),
        **dict.fromkeys(("acc_x_line", "acc_z_line", "gyro_line", "ring_shake"), "no lines"),
        "rotor_hz": "logs: lines of the rotors in acc and gyr, 275 to 290 by flight and time",
        **dict.fromkeys(("polarised_share", "polarised_time"), "the paper's thrust is constant"),
        "arm": "assumed: only arm / inertia shows in a flight",
        "rail_stop": "paper section 2: stroke of about 80 cm",
        "capacity": "assumed: a three-cell pack of 1.3 A h",
        "hover_current": "assumed: about 13 minutes in hover",
        "gyro_hover": "logs, level holds: differences from sample to sample",
        "acc_scale": "logs: in 1DoF a gain error would show as a velocity in proportion to the pitch, and none does",
        "gyro_scale": "logs: as acc_scale",
        "acc_step": "assumed: 16 bits over +-8 g",
        "gyro_step": "assumed: 16 bits over +-2000 deg/s",
        "tof_rate": "logs",
        "tof_stamp": "logs: a range's stamp is that of its arrival",
        "tof_step": "the sensor counts millimetres",
        "wake_lag": "not in the paper",
        "gust_time": "logs: three level holds show .07 to .08 s, give or take .03 s",
        "gust": "logs: three level holds show 1.2 to 1.9 rad/s2 of pitch; this is 1.8",
        "spring": "logs: the pendulum's own stiffness and the hardening suffice",
    }
)

TABLE: tuple[Parameter, ...] = tuple(
    Parameter(p.name, float(p.value), float(p.low), float(p.high), p.unit, p.text or p.name.replace("_", " "))
    for p in rig_params().values()
    if p.name not in CONDITIONS
)
"""Bounds, unit and text of every parameter of the machine."""

LAB_FILE = Path(__file__).with_name("lab.json")
NAMES = ("paper", "lab")
MAX_BYTES = 1 << 20


def paper() -> ParameterSet:
    """Return the rig that behaves as the paper's models do: linear springs, viscous friction only, no disturbance."""
    return ParameterSet({name: value for name, (value, _) in _paper().items()}, TABLE)


def lab() -> ParameterSet:
    """Return the real drone's set, as `calibrate.py` found it on its logs."""
    return load_rig(LAB_FILE)


def origins(name: str) -> Mapping[str, str]:
    """Return the origin of each number of the set `name`, "paper" or "lab". Raises ParameterError for another name."""
    if name not in NAMES:
        raise ParameterError(f"no rig called {name!r:.80}", "origins", f"use {' or '.join(NAMES)}")
    own = {n: text for n, (_, text) in _paper().items()} if name == "paper" else {**_LAB, **CALIBRATED}
    return MappingProxyType({**_SHARED, **own})


def load_rig(source: str | Path) -> ParameterSet:
    """Return the set "paper" or "lab", or that of the JSON file `source`. What the file leaves out has its default.

    Raises ParameterError for a file that cannot be read, is not a set, or holds a value out of bounds.
    """
    if source == "paper":
        return paper()
    path = LAB_FILE if source == "lab" else Path(source)
    try:
        text = text_of(read_bytes(path, MAX_BYTES))
    except (LogError, ValueError) as reason:
        why = reason.what if isinstance(reason, LogError) else "cannot be read: it is not UTF-8 text"
        raise ParameterError(why, str(path), f"name a JSON file or one of {', '.join(NAMES)}") from reason
    values = ParameterSet(table=TABLE)
    try:
        values.load_json(text)
    except ParameterError as reason:
        raise ParameterError(reason.what, str(path), reason.remedy) from reason
    return values


def save_rig(values: ParameterSet, path: str | Path, overwrite: bool = False) -> None:
    """Write a set to a JSON file, for `load_rig`; an interrupted write leaves the old file.

    Raises LogError if the file exists and `overwrite` is false, or if it cannot be written.
    """
    check_free(path, overwrite)
    with atomic_write(path, "w") as file:
        file.write(values.to_json() + "\n")
