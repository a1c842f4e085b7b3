"""What is fitted to which of the paper's experiments: the structures by name, and what an earlier flight fixes."""

from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType

from twodof.errors import IdentificationError, shown
from twodof.flightlog.log import FlightLog
from twodof.identify.disturbance.disturbance_model import Disturbance
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import KINDS, kind_of, only
from twodof.identify.greybox import fit
from twodof.identify.record import Record
from twodof.identify.repeated import Repeated, repeat
from twodof.identify.simple_pitch import SimplePitch, identify_pitch
from twodof.identify.simple_velocity import SimpleVelocity, identify_velocity
from twodof.models.structure import Structure
from twodof.models.structures import free_response, pitch_rate, rail, velocity

AUTO = "auto"
"""The paper's structure for the experiment."""

STRUCTURES: Mapping[str, Callable[[], Structure]] = MappingProxyType(
    {
        "pitch-rate": pitch_rate,
        "pitch-rate-lag": lambda: pitch_rate(lag=True),
        "free-response": free_response,
        "velocity": velocity,
        "rail": rail,
    }
)
"""The ready-made structures; `velocity` is the paper's, between on-board estimates."""

FLOWN_AS: Mapping[str, str] = MappingProxyType({"velocity-doublet": "velocity"})
"""What an experiment of `KINDS` is called where it is flown, if it is another name."""

SWING = ("w_n", "xi", "coulomb", "hardening")
"""What a free response tells and a doublet hardly does: it is over before the poles show."""

TRAVEL = ("k_v", "p_v", "tau", "theta_0", "x_0", "v_0")
"""What a motion along the rail tells. The range sensor's age beyond its stamp passes for less friction if it is 0."""


def experiment_in(log: FlightLog) -> str:
    """Which of `KINDS` a log holds: what it says, else what it looks like.

    Raises LogError where none is found, IdentificationError where it says an experiment that tells no model.
    """
    said = log.provenance.get("experiment")
    if not isinstance(said, str):
        return kind_of(log).name
    name = FLOWN_AS.get(said, said)
    if name not in KINDS:
        raise IdentificationError(
            f"nothing is identified from the experiment {shown(said)}",
            log.source,
            f"say which it is: {', '.join(KINDS)}",
        )
    return name


def structure_for(experiment: str, name: str = AUTO) -> Structure:
    """The structure `name` of `STRUCTURES`, or with `AUTO` the paper's for an experiment of `KINDS`.

    Raises IdentificationError for a name that is not there, and for a structure of another experiment's inputs.
    """
    if name == AUTO:
        return rail(thrust=True) if experiment == "velocity" else pitch_rate(lag=experiment == "doublet")
    if name not in STRUCTURES:
        raise IdentificationError(f"no structure called {shown(name)}", "", f"there are: {', '.join(STRUCTURES)}")
    structure = STRUCTURES[name]()
    if experiment in KINDS and not set(structure.inputs) <= set(KINDS[experiment].inputs):
        driven = ", ".join(KINDS[experiment].inputs)
        raise IdentificationError(
            f"this structure is driven by {', '.join(structure.inputs)}, the experiment by {driven}",
            f"structure '{name}', experiment '{experiment}'",
            f"take the structure {AUTO!r}",
        )
    return structure


def by_hand(
    experiment: str, record: Record, others: Sequence[Record] = (), free: Record | None = None
) -> SimplePitch | SimpleVelocity:
    """The paper's simple method; of a doublet it needs the `free` response too. Raises IdentificationError."""
    if experiment == "velocity":
        return identify_velocity([record, *others])
    if experiment == "impulse" or free is None:
        raise IdentificationError(
            "by hand, the poles are read from a free response and the rest from a doublet",
            f"experiment '{experiment}'",
            "give a doublet's log, and the impulse's beside it",
        )
    return identify_pitch(free, [record, *others])


def by_output_error(
    experiment: str,
    structure: Structure,
    records: Sequence[Record],
    others: Sequence[Record] = (),
    estimate: Collection[str] | None = None,
    values: Mapping[str, float] | None = None,
    free: Record | None = None,
    disturbance: Disturbance = "auto",
) -> tuple[Estimate | Repeated, list[Record]]:
    """What was found, and the records as they were fitted (the first) and validated.

    `free` is the impulse's record of a doublet: its fit with the same structure fixes the poles. Several `records` are
    repetitions, each fitted by itself. Raises IdentificationError as `fit` and `repeat`.
    """
    given = dict(values or {})
    wanted = tuple(estimate) if estimate else None
    if free is not None:
        swing = fit(structure, free, values=given, disturbance=disturbance)
        held = {name: swing[name] for name in SWING if name in swing.labels and name not in (estimate or ())}
        given = {**held, **given}
        wanted = wanted or tuple(name for name in structure.estimate if name not in held)
    fitted, checked = list(records), list(others)
    if experiment == "velocity":
        # From the on-board pitch to the on-board velocity, as in the paper, or from the gyro to the range sensor.
        output = "v" if "theta" in structure.inputs else "x"
        fitted, checked = [only(one, output) for one in fitted], [only(other, output) for other in checked]
        wanted = (*TRAVEL, "q_trim") if wanted is None and output == "x" else wanted
    if len(fitted) > 1:
        return repeat(structure, fitted, estimate=wanted, values=given, disturbance=disturbance), fitted
    found = fit(structure, fitted[0], estimate=wanted, values=given, validation=checked, disturbance=disturbance)
    return found, [fitted[0], *checked]
