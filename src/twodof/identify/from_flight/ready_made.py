"""What is fitted to which of the paper's experiments: the structures by name, and what an earlier flight fixes."""

from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType

from twodof.errors import IdentificationError, shown
from twodof.flightlog.log import FlightLog
from twodof.identify.disturbance.disturbance_model import Disturbance
from twodof.identify.disturbance.search import LONG
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import KINDS, kind_of, only
from twodof.identify.from_flight.closed_loop import POLES_BEFORE, FlownMachine
from twodof.identify.greybox import fit
from twodof.identify.record import SHORTEST_PIECE, Record
from twodof.identify.repeated import Repeated, repeat
from twodof.identify.simple_pitch import SimplePitch, identify_pitch
from twodof.identify.simple_velocity import SimpleVelocity, identify_velocity
from twodof.models.structure import Structure
from twodof.models.structures import free_response, pitch_on_cart, pitch_rate, rail, velocity

AUTO = "auto"
"""The paper's structure for the experiment."""

STRUCTURES: Mapping[str, Callable[[], Structure]] = MappingProxyType(
    {
        "pitch-rate": pitch_rate,
        "pitch-rate-lag": lambda: pitch_rate(lag=True),
        "free-response": free_response,
        "pitch-on-cart": pitch_on_cart,
        "velocity": velocity,
        "rail": rail,
    }
)
"""The ready-made structures; `velocity` is the paper's, between on-board estimates."""

FLOWN_AS: Mapping[str, str] = MappingProxyType(
    {
        "velocity-doublet": "velocity",
        "velocity-doublets": "velocity",
        "position-sweep": "velocity",
        "attitude-steps": "attitude",
        "attitude-prbs": "attitude",
        "rate-doublets": "attitude",
    }
)
"""What an experiment of `KINDS` is called where it is flown, if it is another name."""

NOT_BY_HAND = "in closed loop nothing is read by hand: the controller answers what the ruler would measure"
"""Why the simple method refuses a flight in closed loop."""

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
    if name == AUTO and experiment == "attitude":
        return pitch_on_cart()
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
    if experiment == "attitude":
        raise IdentificationError(
            NOT_BY_HAND,
            f"experiment '{experiment}'",
            "take output error with its noise model",
        )
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
    machines: Sequence[FlownMachine] = (),
) -> tuple[Estimate | Repeated, list[Record]]:
    """What was found, and the records as they were fitted and validated: in closed loop the pieces of the first.

    `machines` are those of the flights, one for each of `records` and then of `others`. In closed loop what its
    calibration knows of the cart is held, and what it knows less well is known before; what is known before and not
    asked for is held at its mean. In a long open loop the poles are known before. `free` is the impulse's record of a
    doublet: its fit with the same structure fixes the poles. Several `records` are repetitions, each fitted by itself.
    Raises IdentificationError as `fit` and `repeat`, and for flights in closed loop of different machines.
    """
    given = dict(values or {})
    wanted = tuple(estimate) if estimate else None
    if free is not None:
        swing = fit(structure, free, values=given, disturbance=disturbance)
        held = {name: swing[name] for name in SWING if name in swing.labels and name not in (estimate or ())}
        given = {**held, **given}
        wanted = wanted or tuple(name for name in structure.estimate if name not in held)
    if experiment == "attitude":
        return _in_closed_loop(structure, records, others, wanted, given, disturbance, machines)
    fitted, checked = list(records), list(others)
    before: dict[str, tuple[float, float]] | None = None
    if experiment == "doublet" and free is None and min(one.steps for one in fitted) >= LONG:
        # Slow noise passes for a swing of a long test signal, which a short one does not know of.
        known = (machines or [FlownMachine()])[0].prior(structure)
        before = {name: one for name, one in known.items() if name in POLES_BEFORE and name not in given}
    if experiment == "velocity":
        # From the on-board pitch to the on-board velocity, as in the paper, or from the gyro to the range sensor.
        output = "v" if "theta" in structure.inputs else "x"
        fitted, checked = [only(one, output) for one in fitted], [only(other, output) for other in checked]
        wanted = (*TRAVEL, "q_trim") if wanted is None and output == "x" else wanted
    if len(fitted) > 1:
        repeated = repeat(structure, fitted, estimate=wanted, values=given, disturbance=disturbance, prior=before)
        return repeated, fitted
    found = fit(
        structure,
        fitted[0],
        estimate=wanted,
        values=given,
        validation=checked,
        disturbance=disturbance,
        prior=before,
    )
    return found, [fitted[0], *checked]


def _in_closed_loop(
    structure: Structure,
    records: Sequence[Record],
    others: Sequence[Record],
    wanted: tuple[str, ...] | None,
    given: Mapping[str, float],
    disturbance: Disturbance,
    machines: Sequence[FlownMachine],
) -> tuple[Estimate | Repeated, list[Record]]:
    machines = machines or [FlownMachine()] * len(records)
    if len(set(machines)) > 1:
        raise IdentificationError(
            f"these flights are of different machines: {' and '.join(dict.fromkeys(one.text for one in machines))}",
            ", ".join(record.name for record in (*records, *others)),
            "give the flights of one machine",
        )
    machine = machines[0]
    estimate = wanted or tuple(name for name in machine.estimate(structure) if name not in given)
    known = {**structure.prior, **machine.prior(structure)}
    # What is not asked for is held where it is known to be, not at the paper's drone.
    held = {name: mean for name, (mean, _) in known.items() if name not in estimate}
    values = {**held, **machine.values(structure), **given}
    before = {name: one for name, one in machine.prior(structure).items() if name in estimate and name not in given}
    pieces = [record.pieces() for record in records]
    if not all(pieces):
        raise IdentificationError(
            f"the moment is lost so often that no stretch of {SHORTEST_PIECE} samples is whole",
            ", ".join(record.name for record, whole in zip(records, pieces, strict=True) if not whole),
            "give another window, or another log",
        )
    # What a lost command did to the drone comes back in the next ones: between gaps each piece has a start of its own.
    found = [
        fit(
            structure,
            whole,
            estimate=estimate,
            values=values,
            validation=others,
            disturbance=disturbance,
            prior=before,
        )
        for whole in pieces
    ]
    if len(found) > 1:
        return Repeated(tuple(record.name for record in records), tuple(found)), list(records)
    return found[0], [*pieces[0], *others]
