"""Controllers of public repositories beside the C that MathWorks' coder made of them.

TWODOF_SLX_REPOS names a folder of checkouts, OWNER+NAME, of which nothing is kept here: JakubRichardson/IGDP-DroneProj
at f54bdc9, and with their history Firmament-Autopilot/FMT-Model and FMT-Firmware, robotology/icub-firmware-models and
icub-firmware, and ts1413/test. A model and its C must have one version.
"""

import ctypes
import os
import re
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.computing.simulink_controller import GENERATED, MODEL, STATES, flight_controller
from tests.slx.generated_c import TYPES, built, drawn, leaves, ours, plain, value
from twodof.compile import build
from twodof.compile.machine import CompiledMachine
from twodof.slx.importer import Imported, import_system
from twodof.slx.matlab.script import read_workspace, run
from twodof.slx.matlab.values import Value
from twodof.slx.model import read_model

REPOS = os.environ.get("TWODOF_SLX_REPOS", "")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not REPOS, reason="let TWODOF_SLX_REPOS name the folder of the public repositories' checkouts"),
]
STEPS = 2000
KEPT = ("Attitude.Discrete_Time_Integrator.x", "Attitude.Delay.buffer", "S_R_Flip_Flop.f_x")
DRIVER = """
#include <stdio.h>
#include "flightController.h"
#include "flightController_private.h"
int main(void) {
  CommandBus c = {0};
  statesEstim_t s;
  float in[20], out[12];
  flightController_Init();
  while (fread(in, sizeof in, 1, stdin) == 1) {
    c.controlModePosVSOrient = in[0] != 0.0F;
    c.takeoff_flag = in[1] != 0.0F;
    for (int i = 0; i < 3; i++) { c.pos_ref[i] = in[2 + i]; c.orient_ref[i] = in[5 + i]; }
    for (int i = 0; i < 12; i++) ((float *) &s)[i] = in[8 + i];
    flightController_run(&c, &s, out, out + 4);
    fwrite(out, sizeof out, 1, stdout);
    fwrite(flightController_DW.DiscreteTimeIntegrator_DSTATE, sizeof(float), 2, stdout);
    fwrite(flightController_DW.Delay_DSTATE, sizeof(float), 2, stdout);
    float taken_off = flightController_DW.Memory_PreviousInput;
    fwrite(&taken_off, sizeof(float), 1, stdout);
  }
  return 0;
}
"""


def sines(seed: int) -> np.ndarray:
    """Seeded sums of sines as the 20 inputs, the first two as flags."""
    draw = np.random.default_rng(seed)
    t = np.arange(STEPS)[:, None] * 0.005
    size = np.r_[1.0, 1.0, 1.0, 1.0, 1.0, [0.3] * 3, 1.0, 1.0, 1.0, [0.5] * 3, 0.5, 0.5, 0.5, 2.0, 2.0, 2.0]
    found = sum(size * np.sin(t * draw.uniform(0.5, 20.0, 20) + draw.uniform(0.0, 6.0, 20)) for _ in range(3))
    found[:, :2] = found[:, :2] > 0.5
    return found.astype(np.float32)


def by_mathworks(folder: Path, inputs: np.ndarray, made: Path) -> np.ndarray:
    """Return what the C gives: motors, pose, and its five states after each step."""
    (made / "driver.c").write_text(DRIVER, encoding="utf-8")
    parts = [f"-I{folder}", f"-I{folder.parent / '_sharedutils'}", str(folder / "flightController.c")]
    command = ["gcc", "-O1", "-ffp-contract=off", "-w", *parts, str(made / "driver.c"), "-o", str(made / "run"), "-lm"]
    subprocess.run(command, check=True)
    done = subprocess.run([str(made / "run")], input=inputs.tobytes(), stdout=subprocess.PIPE, check=True)
    return np.frombuffer(done.stdout, np.float32).reshape(STEPS, 17)


def by_import(repository: Path, inputs: np.ndarray) -> np.ndarray:
    found = flight_controller(repository)
    assert found.diagram is not None, found.refused
    assert found.dt == 0.005
    machine = build(found.diagram, dt=found.dt, precision="float32").machine()
    rows = []
    for row in inputs:
        command = {"controlModePosVSOrient": bool(row[0]), "takeoff_flag": bool(row[1]), "pos_ref": row[2:5],
                   "orient_ref": row[5:8], "live_time_ticks": 0}  # fmt: skip
        estimate = dict(zip(STATES, row[8:].tolist(), strict=True))
        got = machine.step({"ReferenceValueServerBus": command, "states_estim": estimate})
        kept = [np.ravel(machine.state(f"Flight_Controller.{path}")) for path in KEPT]
        rows.append(np.concatenate([np.ravel(got["motors_refout"]), np.ravel(got["pose_refout"]), *kept]))
    return np.array(rows, np.float32)


def both(tmp_path: Path, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what the C and the import give. The model and the C must have one version."""
    repository = Path(REPOS) / "JakubRichardson+IGDP-DroneProj"
    folder = repository / GENERATED[0]
    said = re.search(r"Model version\s*: ([\d.]+)", (folder / "flightController.c").read_text(encoding="utf-8"))
    assert said is not None
    assert read_model(repository / MODEL).version == said[1]
    return by_mathworks(folder, inputs, tmp_path), by_import(repository, inputs)


@pytest.mark.parametrize("positions", [False, True])
def test_a_flight_controller_has_the_bits_of_mathworks_c(tmp_path: Path, positions: bool) -> None:
    """2,000 steps of outputs and states: set-points of the attitude, and of positions where the yaw is 0."""
    inputs = sines(11)
    inputs[:, 0] = positions
    if positions:
        inputs[:, 8 + STATES.index("yaw")] = 0.0  # no elementary function but sin(0) and cos(0)
    wanted, found = both(tmp_path, inputs)
    assert np.array_equal(found[:, :12], wanted[:, :12])
    assert np.array_equal(found[:, 12:], wanted[:, 12:])
    assert np.ptp(wanted[:, :4], axis=0).min() > 100.0


def test_sines_of_the_yaw_stay_within_two_units_in_the_last_place(tmp_path: Path) -> None:
    inputs = sines(12)
    wanted, found = both(tmp_path, inputs)
    # Of a signal's largest value: a sum of nearly opposite terms is smaller than its own rounding.
    unit = np.spacing(np.abs(wanted).max(axis=0))
    assert (np.abs(found - wanted).max(axis=0) <= 2.0 * unit).all()
    assert 0.2 < inputs[:, 0].mean() < 0.8


# --- controllers of the Firmament autopilot: buses, single precision, variants, enabled and reset parts, whole numbers


@dataclass(frozen=True)
class Pair:
    """A controller or filter of FMT-Model, and the C of its version in FMT-Firmware: commits, version, period [s]."""

    name: str
    model: str
    code: str
    version: str
    period: float = 0.002
    part: str = "Controller"

    @property
    def folders(self) -> tuple[str, str]:
        """The folders of the model, and of the C."""
        kind = {"Controller": "control", "INS": "ins"}[self.part]
        beside = {"Controller": "controller", "INS": "ins"}[self.part]
        return f"model/{self.part}/{self.name}-{self.part}", f"src/model/{kind}/{self.name.lower()}_{beside}/lib"


PAIRS = [
    Pair("ADRC", "f09f371", "19dd53b", "1.976"),
    Pair("Base", "f217475", "8f7d94f", "1.885"),
    Pair("Base", "9cbc49f", "af5eb63", "1.965"),
    Pair("Boat", "f09f371", "19dd53b", "1.1188", 0.01),
    Pair("Car", "f09f371", "19dd53b", "1.1151", 0.01),
    Pair("FW", "f09f371", "19dd53b", "1.1112"),
    Pair("MC", "f09f371", "3b6e900", "1.1001"),
    Pair("VTOL", "413929b", "102edd7", "1.859"),
    Pair("Submarine", "f09f371", "19dd53b", "1.1007"),
    Pair("CF", "c38f0a0", "165555c", "1.4482", part="INS"),
]
STRUCTURES = {
    "Controller": ("ExtU", "ExtY", "DW", "DW"),
    "INS": ("ExternalInputs", "ExternalOutputs", "D_Work", "DWork"),
}
"""Of a part's C the types of inputs, outputs and states, and the name of the states."""
SPANS = {"reset": (0, 2), "ctrl_mode": (0, 9), "status": (0, 4), "state": (0, 8)}
"""Whole numbers of inputs that mean something, from the first to before the last."""


def taken(repository: str, commit: str, folder: str, made: Path) -> Path:
    """Take a folder of a commit out of a checkout."""
    made.mkdir(exist_ok=True)
    kept = subprocess.run(
        ["git", "-C", str(Path(REPOS) / repository), "archive", commit, folder], stdout=subprocess.PIPE, check=True
    )
    subprocess.run(["tar", "-x", "-C", str(made)], input=kept.stdout, check=True)
    return made / folder


def controller(one: Pair, made: Path) -> Imported:
    """Import a controller with its buses and parameters."""
    repository = "Firmament-Autopilot+FMT-Model"
    buses, library = (taken(repository, one.model, name, made) for name in ("bus", "lib"))
    folder = taken(repository, one.model, one.folders[0], made)
    names: dict[str, Value] = {}
    for script in (*sorted(buses.glob("*.m")), *sorted(folder.glob("*_init.m"))):
        read_workspace(script, names, [folder])
    model = read_model(folder / f"{one.part}.slx")
    assert model.version == one.version
    return import_system(model, "", names, [folder, library, buses / "enum"], one.period)


@pytest.mark.parametrize("one", PAIRS, ids=[f"{one.name} {one.version}" for one in PAIRS])
def test_a_part_of_firmament_has_the_bits_of_mathworks_c(tmp_path: Path, one: Pair) -> None:
    """2,000 steps of outputs and of all states that have one here."""
    part, files = one.part, [f"{one.part}.c", f"{one.part}_data.c"]
    folder = taken("Firmament-Autopilot+FMT-Firmware", one.code, one.folders[1], tmp_path / "c")
    assert re.search(rf"Model version\s*: {one.version}$", (folder / files[0]).read_text("utf-8"), re.MULTILINE)
    code = built(folder, [name for name in files if (folder / name).exists()], tmp_path, single=True)
    *types, kept_in = STRUCTURES[part]
    inputs, outputs, memory = (code.at(f"{kind}_{part}_T", f"{part}_{name}")
                               for kind, name in zip(types, ("U", "Y", kept_in), strict=True))  # fmt: skip
    found = controller(one, tmp_path)
    assert found.diagram is not None, found.refused
    mixed = part == "INS"
    program = build(found.diagram, dt=found.dt, precision="float64" if mixed else "float32")
    widths = {path: state.width or 1 for path, (state, _) in program.states.items()}
    # A delay whose first values come by a port keeps them beside its buffer here.
    widths = {path: width for path, width in widths.items() if not re.search(r"\.inside\.(past|y)\.", path)}
    states = code.states(f"{types[-1]}_{part}_T", widths)
    assert len(states) >= 4
    draw, machine = np.random.default_rng(7), program.machine()
    columns = [
        (path, holder, name, drawn(kind, count, STEPS, SPANS.get(name, (0, 2**16)), draw), count)
        for path, holder, name, kind, count in leaves(inputs)
        if path in machine.inputs
    ]
    getattr(code.library, f"{part}_init")()
    wanted, given = [], []
    for k in range(STEPS):
        for _, holder, name, column, count in columns:
            setattr(holder, name, (type(getattr(holder, name))(*column[k].tolist()) if count > 1 else column[k].item()))
        getattr(code.library, f"{part}_step")()
        ours = machine.step({path: column[k].tolist() if count > 1 else column[k].item()
                             for path, _, _, column, count in columns})  # fmt: skip
        theirs = {path: value(holder, name) for path, holder, name, _, _ in leaves(outputs)}
        theirs |= {state: value(memory, member) for member, state in states.items()}
        wanted.append(np.concatenate(list(theirs.values())))
        kept = {state: machine.state(state) for state in states.values()}
        given.append(np.concatenate([np.ravel({**flat(ours), **kept}[path]).astype(float) for path in theirs]))
    assert np.array_equal(given, wanted)
    assert (np.ptp(wanted, axis=0) > 0.0).sum() > len(states)


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The fields of buses by path."""
    found: dict[str, Any] = {}
    for name, one in values.items():
        found |= flat(one, f"{prefix}{name}.") if isinstance(one, Mapping) else {f"{prefix}{name}": one}
    return found


# --- filters of the iCub robot's motor boards, in C++


ICUB = "robotology+icub-firmware-models"
ESTIMATION = "boards/common/models/motion_control/estimation"
CPP = "emBODY/eBcode/arch-arm/mbd"
SINES = """
#include <cmath>
namespace std { float given_sin(float); float given_cos(float); }
#define sin given_sin
#define cos given_cos
"""
"""Of the iCub's C++ the sine and cosine are those that the driver reads."""
READING = """
#define private public
#include <cstdio>
#include <cstring>
#include <initializer_list>
#include "{name}.h"
{constants}
static float given[2];
namespace std {{ float given_sin(float) {{ return given[0]; }} float given_cos(float) {{ return given[1]; }} }}
int main() {{
  {start}
  float in[{inputs}], out[{outputs}] = {{0}};
  while (fread(in, sizeof in, 1, stdin) == 1) {{
    {step}
    fwrite(out, sizeof out, 1, stdout);
  }}
  return 0;
}}
"""


@dataclass(frozen=True)
class Filter:
    """A filter: where model and C++ are, its version, its workspace, and a step of the C++ from `in` to `out`."""

    name: str
    model: str
    folders: tuple[str, ...]
    version: str
    script: str
    inputs: int
    outputs: int
    start: str
    step: str
    commit: str = "b42992119"
    period: float = 0.001
    constants: str = ""
    """Of the C++, those that its own code leaves to another file."""


FILTERS = {
    "kalman": Filter(
        "kalman_filter", "kalman_filter", ("kalman_filter",), "1.10",
        "Ts = .001; sysd.A = [1 .001 5e-7; 0 1 .001; 0 0 1]; sysd.C = [1 0 0];", 10, 15,
        "static kalmanfilter::KalmanFilter f; f.initialize();",
        """float (&x0)[3] = *(float (*)[3]) (in + 2), (&Q)[3] = *(float (*)[3]) (in + 6), (&x)[3] = *(float (*)[3]) out;
           f.step(in[0] > 0, in[1], x0, in[5], Q, in[9], x);
           memcpy(out + 3, f.kalman_filter_DW.MemoryP_DSTATE, 36);
           memcpy(out + 12, f.kalman_filter_DW.MemoryX_DSTATE, 12);""",
    ),
    "median": Filter(
        "filter_current", ESTIMATION, ("amcbldc/filter-current", "amcbldc/sharedutils"), "8.0", "", 1, 1,
        "static DW_filter_current_f_T w; filter_current_Init(&w); FOCOutputs u = {};",
        "u.Iq_fbk = in[0]; filter_current(&u, out, &w);",
    ),
    "velocity": Filter(
        "estimation_velocity", ESTIMATION, ("amcbldc/estimator", "amcbldc/sharedutils"), "8.11",
        "EstimationVelocity_Ts = .001;", 3, 1,
        "static DW_estimation_velocity_f_T w; estimation_velocity_Init(&w);",
        """auto mode = (EstimationVelocityModes) (int) in[0]; uint32_T window = (uint32_T) in[2];
           estimation_velocity(&mode, in + 1, &window, out, &w);""",
    ),
    "messages": Filter(
        "SupervisorFSM_TX", "boards/common/models/motion_control/supervision",
        ("amcbldc/supervisor-tx", "amcbldc/sharedutils"), "10.14", "Ts_Supervision = .001;", 8, 9,
        "static DW_SupervisorFSM_TX_f_T w; static BUS_MESSAGES_TX m; BUS_STATUS_TX s; SupervisorFSM_TX_Init(&m, &s);",
        """SensorsData d = {}; EstimatedData e = {}; Flags f = {}; FOCOutputs o = {}; boolean_T fault = in[2] > 0;
           f.enable_sending_msg_status = in[0] > 0; f.control_mode = (ControlModes) (int) in[1];
           f.hw_faults.overcurrent = in[3] > 0; e.Iq_filtered = in[4]; e.velocity = in[5]; d.position = in[6];
           o.Vq = in[7]; SupervisorFSM_TX(&d, &e, &f, &o, &fault, &m, &s, &w);
           float now[] = {m.foc.current, m.foc.velocity, m.foc.position, (float) m.status.control_mode,
             m.status.pwm_fbk, (float) m.status.flags.ExternalFaultAsserted,
             (float) m.status.flags.OverCurrentFailure, (float) s.foc, (float) s.status};
           memcpy(out, now, sizeof now);""", "d8e5c72e7",
    ),
    "edges": Filter(
        "SupervisorFSM_TX", "boards/amcbldc_legacy/supervisor", ("amcbldc/supervisor-tx", "amcbldc/sharedutils"),
        "7.4", "", 8, 9, "static BUS_MESSAGES_TX m; BUS_STATUS_TX s; SupervisorFSM_TX_Init(&m);",
        """SensorsData d = {}; EstimatedData e = {}; Flags f = {}; ControlOutputs o = {};
           f.enable_sending_msg_status = in[0] > 0; f.control_mode = (ControlModes) (int) in[1];
           f.fault_button = in[2] > 0; f.overcurrent = in[3] > 0; e.Iq_filtered.current = in[4];
           e.jointvelocities.velocity = in[5]; d.jointpositions.position = in[6]; o.Vq = in[7];
           SupervisorFSM_TX(&d, &e, &f, &o, &m, &s);
           float now[] = {m.foc.current, m.foc.velocity, m.foc.position, (float) m.status.control_mode,
             m.status.pwm_fbk, (float) m.status.flags.ExternalFaultAsserted,
             (float) m.status.flags.OverCurrentFailure, (float) s.foc, (float) s.status};
           memcpy(out, now, sizeof now);""", "b819124cb",
    ),
    "packets": Filter(
        "can_encoder", "boards/amcbldc/messaging", ("amcbldc/can-encoder", "amcbldc/sharedutils"), "9.1", "", 9, 44, "",
        """BUS_MESSAGES_TX m = {}; BUS_STATUS_TX s = {in[0] > 0, in[1] > 0}; BUS_CAN_MULTIPLE p; float *to = out;
           m.status.control_mode = (MCControlModes) (int) in[2]; m.status.flags.ExternalFaultAsserted = in[3] > 0;
           m.status.flags.OverCurrentFailure = in[4] > 0; m.foc.current = in[5]; m.foc.velocity = in[6];
           m.foc.position = in[7]; m.status.pwm_fbk = in[8]; can_encoder(&m, &s, &p);
           for (const BUS_CAN &c : p.packets) {
             *to++ = c.available; *to++ = c.length; *to++ = c.packet.ID;
             for (uint8_T one : c.packet.PAYLOAD) *to++ = one;
           }""", "b481fc47a", constants="uint8_T CAN_ID_AMC = 3; real32_T CAN_ANGLE_DEG2ICUB = 65536.0F / 360.0F;",
    ),
    "decoder": Filter(
        "can_decoder", "boards/amcbldc/messaging", ("amcbldc/can-decoder", "amcbldc/sharedutils"), "9.0", "", 44, 124,
        "static MdlrefDW_can_decoder_T w; can_decoder_Init(&w.rtb, &w.rtdw);",
        """BUS_CAN_MULTIPLE p = {}; static ReceivedEvents m[4]; const float *from = in; float *to = out;
           for (BUS_CAN &c : p.packets) {
             c.available = *from++ > 0; c.length = *from++; c.packet.ID = *from++;
             for (uint8_T &one : c.packet.PAYLOAD) one = *from++;
           }
           can_decoder(&p, m, &w.rtb, &w.rtdw);
           for (const ReceivedEvents &e : m) {
             auto &t = e.targets_content; auto &k = e.pid_content; auto &l = e.limits_content;
             auto &c = e.motor_config_content;
             for (float one : {(float) e.motor_id, (float) e.event_type, t.position, t.velocity, t.current, t.voltage,
               (float) k.type, k.OutMax, k.OutMin, k.P, k.I, k.D, k.N, k.I0, k.D0, (float) k.shift_factor,
               (float) e.control_mode_content, l.overload, l.peak, l.nominal, (float) l.type,
               (float) c.enable_verbosity, (float) c.has_hall_sens, (float) c.has_quadrature_encoder,
               (float) c.has_speed_quadrature_encoder, (float) c.has_temperature_sens, (float) c.encoder_tolerance,
               (float) c.pole_pairs, (float) c.rotor_encoder_resolution, (float) c.rotor_index_offset,
               (float) c.use_index}) *to++ = one;
           }""", "ccd52a2f9", constants="uint8_T CAN_ID_AMC = 3; real32_T CAN_ANGLE_ICUB2DEG = 360.0F / 65536.0F;",
    ),
    "currents": Filter(
        "control_foc", "boards/common/models/motion_control/control",
        ("amcbldc/control-foc", "amcbldc/sharedutils"), "8.9", "", 18, 11,
        "static MdlrefDW_control_foc_T w; control_foc_initialize(&w.rtzce); control_foc_Init(&w.rtdw);",
        """SensorsData s = {}; FOCSlowInputs f = {}; FOCOutputs o; auto &pid = f.actuator_configuration.pids.currentPID;
           auto &outer = f.control_outer_outputs; auto &x = w.rtdw.FOCinnerloop;
           outer.pid_reset = in[0] > 0; outer.cur_en = in[1] > 0; outer.out_en = in[2] > 0;
           s.driversensors.Vcc = in[3]; memcpy(s.motorsensors.Iabc, in + 4, 12); s.motorsensors.angle = in[7];
           f.actuator_configuration.motor.Vmax = in[8]; pid.P = in[9]; pid.I = in[10]; pid.D = in[11]; pid.N = in[12];
           f.targets.voltage = in[13]; outer.motorcurrent = in[14]; outer.current_limiter = in[15];
           memcpy(given, in + 16, 8); control_foc(&s, &f, &o, &w.rtb, &w.rtdw, &w.rtzce);
           float now[] = {o.Vq, o.Vabc[0], o.Vabc[1], o.Vabc[2], o.Iq_fbk, o.Id_fbk, x.FilterDifferentiatorTF_states,
             x.FilterDifferentiatorTF_states_k, x.Integrator_DSTATE, x.Integrator_DSTATE_o, x.UnitDelay_DSTATE};
           memcpy(out, now, sizeof now);""", "d8e5c72e7", 4.5e-5,
    ),
    "cascade": Filter(
        "control_outer", "boards/common/models/motion_control/control",
        ("amcbldc/control-outer", "amcbldc/sharedutils"), "8.0", "", 20, 12,
        """static MdlrefDW_control_outer_T w; control_outer_initialize(&w.rtzce); control_outer_Init(&w.rtdw);
           control_outer_Enable(&w.rtdw);""",
        """Flags g = {}; ActuatorConfiguration c = {}; EstimatedData e = {}; SensorsData s = {}; Targets t = {};
           static ControlOuterOutputs o; g.control_mode = (ControlModes) (int) in[0];
           g.enable_thermal_protection = in[1] > 0; c.thresholds.jntVelMax = in[2];
           c.thresholds.motorNominalCurrents = in[3]; c.thresholds.motorPeakCurrents = in[4];
           memcpy(&c.pids.positionPID.P, in + 5, 16); memcpy(&c.pids.velocityPID.P, in + 9, 16);
           c.pids.currentPID.I = in[13]; e.velocity = in[14]; e.Iq_filtered = in[15]; s.position = in[16];
           t.position = in[17]; t.velocity = in[18]; t.current = in[19];
           control_outer(&g, &c, &e, &s, &t, &o, &w.rtb, &w.rtdw, &w.rtzce); auto &x = w.rtdw;
           float now[] = {(float) o.vel_en, (float) o.cur_en, (float) o.out_en, (float) o.pid_reset, o.motorcurrent,
             o.current_limiter, x.FilterDifferentiatorTF_states, x.FilterDifferentiatorTF_states_c, x.Integrator_DSTATE,
             x.Integrator_DSTATE_i, x.Integrator_DSTATE_b, x.UnitDelay_DSTATE};
           memcpy(out, now, sizeof now);""", "d8e5c72e7",
    ),
}  # fmt: skip


def by_cpp(one: Filter, inputs: np.ndarray, made: Path) -> np.ndarray:
    folders = [taken("robotology+icub-firmware", one.commit, f"{CPP}/{folder}", made) for folder in one.folders]
    text = (folders[0] / f"{one.name}.cpp").read_text("utf-8")
    assert re.search(rf"Model version\s*: {one.version}$", text, re.MULTILINE)
    driver = READING.format(name=one.name, start=one.start, step=one.step, inputs=one.inputs, outputs=one.outputs,
                            constants=one.constants)  # fmt: skip
    (made / "driver.cpp").write_text(driver, encoding="utf-8")
    sources = [
        *sorted(folders[0].glob("*.cpp")),
        *(
            at
            for folder in folders[1:]
            for name in ("rt_hypotf.cpp", "const_params.cpp")
            if (at := folder / name).exists() and "mw_cmsis" not in at.read_text("utf-8")
        ),
    ]
    (made / "sines.h").write_text(SINES, encoding="utf-8")
    flags = ["-O1", "-ffp-contract=off", "-w", "-include", str(made / "sines.h")]
    command = ["g++", *flags, *(f"-I{folder}" for folder in folders), *map(str, sources)]
    subprocess.run([*command, str(made / "driver.cpp"), "-o", str(made / "run")], check=True)
    given = inputs.astype(np.float32).tobytes()
    done = subprocess.run([str(made / "run")], input=given, stdout=subprocess.PIPE, check=True)
    return np.frombuffer(done.stdout, np.float32).reshape(len(inputs), one.outputs)


def filter_of(one: Filter, made: Path) -> CompiledMachine:
    folder = taken(ICUB, "4a3c62e", one.model, made)
    model, names = read_model(folder / f"{one.name}.slx"), dict[str, Value]()
    assert model.version == one.version
    assert run(one.script, names) == []
    beside = sorted({path.parent for end in ("sldd", "m") for path in (Path(REPOS) / ICUB).rglob(f"*.{end}")
                     if ("legacy" in str(path)) == ("legacy" in one.model)})  # fmt: skip
    found = import_system(model, "", names, [folder, *beside], one.period)
    assert found.diagram is not None, found.refused
    return build(found.diagram, dt=one.period, precision="float32").machine()


def test_a_kalman_filter_has_the_bits_of_mathworks_code(tmp_path: Path) -> None:
    """Estimate, covariance and state, where the filter is switched on and off."""
    one, draw = FILTERS["kalman"], np.random.default_rng(3)
    inputs = np.abs(drawn(ctypes.c_float, one.inputs, STEPS, (0, 0), draw))
    inputs[:, 0] = drawn(ctypes.c_bool, 1, STEPS, (0, 2), draw)[:, 0]
    inputs[:, 1] = drawn(ctypes.c_float, 1, STEPS, (0, 0), draw)[:, 0]
    wanted, machine, found = by_cpp(one, inputs, tmp_path), filter_of(one, tmp_path), []
    for row in inputs:
        u = {"enable": bool(row[0]), "y1": row[1], "x0": row[2:5], "P0": row[5], "Q": row[6:9], "R": row[9]}
        xhat = machine.step(u)["xhat"]
        kept = [np.array(machine.state(f"Kalman_Filter.KF.f_{name}")).T.ravel() for name in "Px"]
        found.append(np.concatenate([np.ravel(xhat), *kept]))
    assert np.array_equal(np.array(found, np.float32), wanted)


def test_a_median_of_32_has_the_bits_of_mathworks_code(tmp_path: Path) -> None:
    one = FILTERS["median"]
    inputs = drawn(ctypes.c_float, 1, STEPS, (0, 0), np.random.default_rng(4))
    inputs += np.random.default_rng(5).normal(0.0, 0.3, inputs.shape)
    machine = filter_of(one, tmp_path)
    found = machine.run(STEPS, {"ControlOutputs.Iq_fbk": inputs[:, 0].astype(np.float32)})["FilteredCurrent"]
    assert np.array_equal(np.array(found, np.float32), by_cpp(one, inputs, tmp_path)[:, 0])


def test_a_velocity_has_the_bits_of_mathworks_code_but_for_its_fit(tmp_path: Path) -> None:
    """A mean over up to 120 samples of a ring of 100, to the bit; of the fit of a line its product with a matrix."""
    one, draw = FILTERS["velocity"], np.random.default_rng(6)
    inputs = np.hstack([drawn(ctypes.c_uint8, 1, STEPS, (0, 3), draw), drawn(ctypes.c_float, 1, STEPS, (0, 0), draw),
                        drawn(ctypes.c_uint8, 1, STEPS, (1, 120), draw)])  # fmt: skip
    wanted = by_cpp(one, inputs, tmp_path)[:, 0]
    machine = filter_of(one, tmp_path)
    columns = {"EstimationConfig": inputs[:, 0].astype(int), "position": inputs[:, 1].astype(np.float32),
               "est_window": inputs[:, 2]}  # fmt: skip
    found = np.array(machine.run(STEPS, columns)["EstimatedVelocity"], np.float32)
    fitted = inputs[:, 0] == 2
    assert np.array_equal(found[~fitted], wanted[~fitted])
    assert fitted.any()
    unit = np.spacing(np.abs(wanted).max())  # of the largest: the terms of a fit nearly cancel
    assert np.allclose(found[fitted], wanted[fitted], rtol=0.0, atol=4.0 * unit)


def flown(machine: CompiledMachine, inputs: np.ndarray, names: list[str], kept: list[str]) -> np.ndarray:
    """Return the outputs and the states `kept` after each step; a name of `names` has as many columns as it is wide."""
    zero = {path: 0 if one.width is None else [0] * one.width for path, one in machine.inputs.items()}
    rows = []
    for row in inputs:
        at, u = 0, dict(zero)
        for name in names:
            width, kind = machine.inputs[name].width or 1, machine.inputs[name].kind
            part = row[at : at + width].tolist()
            u[name] = (
                part if width > 1 else bool(part[0]) if kind == "bool" else int(part[0]) if "int" in kind else part[0]
            )
            at += width
        outputs = list(flat(machine.step(u)).values())
        rows.append(np.concatenate([np.ravel(one) for one in (*outputs, *map(machine.state, kept))]))
    return np.array(rows, np.float32)


def test_a_control_of_currents_has_the_bits_of_mathworks_code(tmp_path: Path) -> None:
    """Clarke's and Park's transforms, and two PIDs that follow a signal or are limited, by trapezoids."""
    one, draw = FILTERS["currents"], np.random.default_rng(9)
    inputs = drawn(ctypes.c_float, one.inputs, STEPS, (0, 0), draw)
    inputs[:, :3] = drawn(ctypes.c_bool, 3, STEPS, (0, 2), draw)
    inputs[:, [3, 8, 12]] = 30.0 + 5.0 * inputs[:, [3, 8, 12]]
    inputs[:, 9:12] = np.abs(inputs[:, 9:12])
    sines = [ours(name, 1, True) for name in ("sin", "cos")]
    inputs[:, 16:] = [[of(angle) for of in sines] for angle in inputs[:, 7] * np.float32(np.pi / 180.0)]
    slow, sensors = "FocSlowInputs.", "Sensors."
    pid, outer = f"{slow}actuator_configuration.pids.currentPID.", f"{slow}control_outer_outputs."
    names = [f"{outer}pid_reset", f"{outer}cur_en", f"{outer}out_en", f"{sensors}driversensors.Vcc",
             f"{sensors}motorsensors.Iabc", f"{sensors}motorsensors.angle", f"{slow}actuator_configuration.motor.Vmax",
             *(f"{pid}{term}" for term in "PIDN"), f"{slow}targets.voltage", f"{outer}motorcurrent",
             f"{outer}current_limiter"]  # fmt: skip
    machine, wanted = filter_of(one, tmp_path), by_cpp(one, inputs, tmp_path)
    kept = [f"I{axis}_PID_control.{part}.x" for part in ("slope", "integral") for axis in "qd"]
    found = flown(machine, inputs, names, [f"FOC_inner_loop.{one}" for one in (*kept, "Unit_Delay.x")])
    assert np.array_equal(np.delete(found, [6, 7], axis=1), wanted)  # without the RMS, which are 0
    assert (np.ptp(wanted, axis=0) > 0.0).all()


def test_a_cascade_has_the_bits_of_mathworks_code(tmp_path: Path) -> None:
    one, draw = FILTERS["cascade"], np.random.default_rng(10)
    inputs = drawn(ctypes.c_float, one.inputs, STEPS, (0, 0), draw)
    inputs[:, 0] = drawn(ctypes.c_uint8, 1, STEPS, (0, 8), draw)[:, 0]
    inputs[:, 1] = drawn(ctypes.c_bool, 1, STEPS, (0, 2), draw)[:, 0]
    inputs[:, 2:14] = np.abs(inputs[:, 2:14])
    inputs[:, [8, 12]] += 50.0
    given = "ConfigurationParameters."
    names = ["Flags.control_mode", "Flags.enable_thermal_protection", f"{given}thresholds.jntVelMax",
             f"{given}thresholds.motorNominalCurrents", f"{given}thresholds.motorPeakCurrents",
             *(f"{given}pids.{one}PID.{term}" for one in ("position", "velocity") for term in "PIDN"),
             f"{given}pids.currentPID.I", "Estimates_velocity", "Estimates_Iq_filtered", "Sensors_position",
             "Targets_position", "Targets_velocity", "Targets_current"]  # fmt: skip
    machine, wanted = filter_of(one, tmp_path), by_cpp(one, inputs, tmp_path)
    position, velocity = "Position_PID_control.Position", "Velocity_PID_control"
    kept = [f"{position}_PID.slope.x", f"{velocity}.slope.x", f"{position}_PID.integral.x",
            f"{position}_Direct_PID.integral.x", f"{velocity}.integral.x", "Unit_Delay.x"]  # fmt: skip
    assert np.array_equal(flown(machine, inputs, names, kept), wanted)
    assert (np.ptp(wanted, axis=0) > 0.0).all()


MESSAGES = ("foc.current", "foc.velocity", "foc.position", "status.control_mode", "status.pwm_fbk",
            "status.flags.ExternalFaultAsserted", "status.flags.OverCurrentFailure")  # fmt: skip


MESSAGES_BITS = ("control_mode", "flags.ExternalFaultAsserted", "flags.OverCurrentFailure")
MESSAGES_REALS = ("foc.current", "foc.velocity", "foc.position", "status.pwm_fbk")
LEGACY = {
    "ExternalFlags_fault_button": "Flags.fault_button",
    "Flags.hw_faults.overcurrent": "Flags.overcurrent",
    "EstimatedData.Iq_filtered": "EstimatedData.Iq_filtered.current",
    "SensorsData.position": "SensorsData.jointpositions.position",
    "EstimatedData.velocity": "EstimatedData.jointvelocities.velocity",
}


@pytest.mark.parametrize(("kind", "other"), [("messages", {}), ("edges", LEGACY)])
def test_a_chart_in_c_has_the_bits_of_mathworks_code(tmp_path: Path, kind: str, other: dict[str, str]) -> None:
    """Parallel states, a function in MATLAB's language, outputs of buses that begin anew, and events that are edges."""
    one, draw = FILTERS[kind], np.random.default_rng(8)
    whole = [drawn(ctypes.c_uint8, 1, STEPS, (0, n), draw) for n in (2, 8, 2, 2)]
    inputs = np.hstack([*whole, drawn(ctypes.c_float, 4, STEPS, (0, 0), draw)])
    wanted, machine, found = by_cpp(one, inputs, tmp_path), filter_of(one, tmp_path), []
    zero = {path: 0 for path in machine.inputs if machine.inputs[path].width is None}
    for row in inputs:
        u = {"Flags.enable_sending_msg_status": bool(row[0]), "Flags.control_mode": int(row[1]),
             "ExternalFlags_fault_button": int(row[2]), "Flags.hw_faults.overcurrent": bool(row[3]),
             "EstimatedData.Iq_filtered": row[4], "EstimatedData.velocity": row[5], "SensorsData.position": row[6],
             "ControlOutputs.Vq": row[7]}  # fmt: skip
        got = flat(machine.step({**zero, **{other.get(name, name): value for name, value in u.items()}}))
        found.append([got[f"MessagesTx.{name}"] for name in MESSAGES] + [got["StatusTx.foc"], got["StatusTx.status"]])
    assert np.array_equal(np.array(found, np.float32), wanted)
    assert len(set(map(tuple, wanted[:, 3:4].tolist()))) >= 4


def test_an_array_of_buses_has_the_bits_of_mathworks_code(tmp_path: Path) -> None:
    """Four packets whose bytes two MATLAB Functions put together."""
    one, draw = FILTERS["packets"], np.random.default_rng(14)
    whole = [drawn(ctypes.c_uint8, 1, STEPS, (0, n), draw) for n in (2, 2, 8, 2, 2)]
    inputs = np.hstack([*whole, 20.0 * drawn(ctypes.c_float, 4, STEPS, (0, 0), draw)]).astype(np.float32)
    flags = [f"messages_tx.status.{name}" for name in MESSAGES_BITS]
    names = ["status_tx.foc", "status_tx.status", *flags, *(f"messages_tx.{name}" for name in MESSAGES_REALS)]
    wanted, machine, found = by_cpp(one, inputs, tmp_path), filter_of(one, tmp_path), []
    zero = dict.fromkeys(machine.inputs, 0)
    for row in inputs:
        given = [*map(int, row[: len(whole)]), *row[len(whole) :]]
        u = dict(zip(names, given, strict=True))
        got = flat(machine.step({**zero, **u}))
        parts = [got[f"pck_tx.packets.{name}"] for name in ("available", "length", "packet.ID", "packet.PAYLOAD")]
        found.append(np.hstack([np.reshape(one, (4, -1)) for one in parts]).ravel())
    assert np.array_equal(np.array(found, np.float32), wanted)
    assert (np.ptp(wanted[:, :22], axis=0) > 0.0).sum() >= 14


def test_a_decoder_has_the_bits_of_mathworks_code(tmp_path: Path) -> None:
    """A chart in C for each of four packets: bits, casts and whole numbers, and local events to a parallel state."""
    one, draw = FILTERS["decoder"], np.random.default_rng(15)
    opcodes, modes = [9, 72, 101, 105, 119, 33], [0, 80, 10, 11, 6, 176, 160, 33]
    packets = draw.integers(0, 256, (STEPS, 4, 11))
    packets[..., 0] = draw.random((STEPS, 4)) < 0.8
    packets[..., 1] = draw.choice([8, 8, 8, 0, 1, 2, 9], (STEPS, 4))
    packets[..., 2] = draw.choice([0x003, 0x013, 0x10F, 0x10F, 0x102, 0x204], (STEPS, 4))
    packets[..., 3] = draw.choice(opcodes, (STEPS, 4)) + 128 * draw.integers(0, 2, (STEPS, 4))
    packets[..., 4] = np.where(packets[..., 3] & 127 == 9, draw.choice(modes, (STEPS, 4)), packets[..., 4])
    packets[..., 10] %= 16  # a shift by less than 0 bits has no meaning in C
    wanted = by_cpp(one, packets.reshape(STEPS, -1), tmp_path)
    machine, found = filter_of(one, tmp_path), []
    at = "pck_rx_raw.packets."
    for row in packets:
        u = {f"{at}available": row[:, 0].astype(bool).tolist(), f"{at}length": row[:, 1].tolist(),
             f"{at}packet.ID": row[:, 2].tolist(), f"{at}packet.PAYLOAD": row[:, 3:].tolist()}  # fmt: skip
        found.append(np.array([np.ravel(one) for one in flat(machine.step(u)).values()]).T.ravel())
    assert np.array_equal(np.array(found, np.float32), wanted)
    assert (np.ptp(wanted, axis=0) > 0.0).sum() > 60


# --- one block each, of a suite of test cases: signals are global variables, and rates are functions of their own


SUITE = "ts1413+test"
BLOCKS = {
    "kohei-y/Logic_and_Bit": ("Bitwise_Operator_mask", "Bitwise_Operator_nomask", "Shift_Arithmetic_Input"),
    "kohei-y/Signal_Attr": ("Data_Type_Conversion", "IC", "Rate_Transition_1z", "Rate_Transition_Buf",
                            "Rate_Transition_Copy", "Rate_Transition_DbBuf", "Rate_Transition_ZOH",
                            "Signal_Conversion_Copy"),
    "kohei-y/Signal_Rout": ("Merge",),
    "ts1413/Math_Operations": ("Product_of_Elements", "Sum_of_elements", "Trigonometric_Function"),
    "ts1413/Stateflow": ("Chart",),
    "yamasefu/CommonUsedBlocks": ("DataTypeConversion1", "DataTypeConversion2", "Gain1", "Product1",
                                  "Product2", "RelationalOperator", "Saturation", "Sum1", "Sum2", "Switch",
                                  "Unit_Delay"),
    "yamasefu/LookupTables": ("LookupTable1D1", "LookupTable1D2", "LookupTable1D5", "LookupTable2D", "LookupTablenD"),
    "yoshi12/Ports_Subsystems": ("if_and_if_action_subsys",),
}  # fmt: skip
"""Models of S2B-Q/test-cases at d883906, by folder, each with its C beside it in NAME_ert_rtw."""


@pytest.mark.parametrize(("folder", "name"), [(folder, name) for folder, names in BLOCKS.items() for name in names])
def test_a_block_has_the_bits_of_mathworks_c(tmp_path: Path, folder: str, name: str) -> None:
    """2,000 steps of the output; faster functions of a model with several rates come first, as in its main program."""
    at = taken(SUITE, "d883906", f"S2B-Q/test-cases/{folder}", tmp_path / "c")
    model, c = read_model(next(at.glob(f"{name}.[sm][ld][xl]"))), at / f"{name}_ert_rtw"
    text, header = ((c / f"{name}.{end}").read_text("utf-8", "replace") for end in "ch")
    assert re.search(rf"Model version\s*: {model.version}$", text, re.MULTILINE)
    found = import_system(model, otherwise=0.1)
    assert found.diagram is not None, found.refused
    code = built(c, [one.name for one in sorted(c.glob("*.c")) if one.name != "ert_main.c"], tmp_path, single=False)
    root = model.system("")
    shown = {plain(root.blocks[line.source.sid].name) for line in root.lines if line.source is not None
             for pin in line.wire.sinks() if root.blocks[pin.sid].type == "Outport"}  # fmt: skip
    cells = {
        plain(block): TYPES[kind].in_dll(code.library, variable)
        for kind, variable, block in re.findall(
            r"^extern (\w+) (\w+);\s*/\* '<Root>/([^']*)' \*/", header, re.MULTILINE
        )
    }
    rates = [
        (step, round(float(period) / found.dt))
        for step, period in re.findall(rf"void ({name}_step\d+)\(void\)\s*/\* Sample time: \[([\d.]+)s", text)
    ] or [(f"{name}_step", 1)]
    draw, machine = np.random.default_rng(9), build(found.diagram, dt=found.dt).machine()
    columns = {port: drawn(type(cells[plain(port)]), 1, STEPS, (-100, 100), draw)[:, 0] for port in machine.inputs}
    getattr(code.library, f"{name}_initialize")()
    wanted, given = [], []
    for k in range(STEPS):
        for port, column in columns.items():
            cells[plain(port)].value = column[k].item()
        for step, divider in rates:
            if k % divider == 0:
                getattr(code.library, step)()
        wanted.append([cells[one].value for one in sorted(shown)])
        given.append(list(machine.step({port: column[k].item() for port, column in columns.items()}).values()))
    assert len(set(map(tuple, wanted))) > 1
    assert np.array_equal(given, wanted)
