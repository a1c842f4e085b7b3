"""Fly many designs on random members of their families, and count how often their promises hold.

`python -m tools.promises [--designs 200] [--members 1000] [--flights 5] [--seed 1]` prints a line for each channel and
figure. Every design has an identified family of its own: an estimate, its covariance, a gust and a noise of the gyro.
It flies on a rig that is one member of it, several times, in other gusts and noise. The design did not see this member.
The lanes of one compiled closed loop fly them.
"""

import argparse
import math
import sys
from dataclasses import dataclass, replace

import numpy as np

from twodof.design.cascade import cascade_design
from twodof.design.pitch_family import PitchFamily
from twodof.design.promise import CHANNELS, Promise, promise
from twodof.design.sampled_controller import SampledController
from twodof.flight.gains import Gains
from twodof.flight.starters.attitude import stock_attitude
from twodof.models.plant import PAPER_PITCH_RATE, PitchRate
from twodof.rig.parameters import paper
from twodof.signals import Q_AGE
from twodof.sim.promised.rail_promise import RigFlights, fly_rigs

VIBRATION = float(paper()["vibration_hz"]), float(paper()["vibration_r2"])


@dataclass(frozen=True)
class FlownDesign:
    """A family, the gains designed for it, what is promised of them, and the member that flies, by name."""

    family: PitchFamily
    gains: Gains
    promise: Promise
    member: dict[str, float]


def random_family(rng: np.random.Generator) -> PitchFamily:
    """An estimate as the logs give it, of a drone near the paper's and the laboratory's, with its gust and noise."""
    values = {
        "w_n": rng.uniform(2.5, 4.0),
        "xi": rng.uniform(0.05, 0.2),
        "mu": rng.uniform(270.0, 380.0),
        "dead_time": rng.uniform(0.010, 0.020),
        "lag": rng.uniform(0.002, 0.011),
    }
    sigmas = {
        "w_n": 0.05 * values["w_n"],
        "xi": 0.2 * values["xi"],
        "mu": rng.uniform(0.01, 0.05) * values["mu"],
        "dead_time": rng.uniform(0.0003, 0.0015),
    }
    disturbance = rng.uniform(0.5, 2.3), rng.uniform(0.1, 0.2), rng.uniform(0.005, 0.03)
    return replace(PitchFamily.of(values, sigmas, *disturbance), q_band=VIBRATION)


def designed(count: int, members: int, seed: int) -> list[FlownDesign]:
    """`count` designs, each with its promise; those that the covariance does not keep stable are not flown."""
    rng = np.random.default_rng(seed)
    found: list[FlownDesign] = []
    while len(found) < count:
        family = random_family(rng)
        v = family.values
        plant = PitchRate(v["w_n"], v["xi"], v["mu"], v["dead_time"])
        gains = cascade_design(plant, float(rng.uniform(10.0, 28.0)), lag=v["lag"]).gains
        controller = SampledController.of(stock_attitude(gains))
        number = len(found)
        made = promise(controller, family, members=members, seed=2 * number + 2)
        if made.robust:
            found.append(FlownDesign(family, gains, made, family.draw(1, seed=10_000 + seed + number).one(0)))
            sys.stderr.write(f"\r{len(found)} of {count} designs")
    sys.stderr.write("\n")
    return found


def rig_of(design: FlownDesign) -> dict[str, float]:
    """Parameters of the rig that is the design's member, of `paper`'s except for these."""
    member, inertia = design.member, float(paper()["inertia"]) * PAPER_PITCH_RATE.mu / design.member["mu"]
    viscous = 2.0 * member["xi"] * member["w_n"] * inertia
    return {
        **paper().snapshot(),
        "inertia": inertia,
        "spring": member["w_n"] ** 2 * inertia,
        "viscous_idle": viscous,
        "viscous_run": viscous,
        "delay": member["dead_time"] + Q_AGE,
        "lag": member["lag"],
        "gust": design.family.gust * inertia,
        "gust_time": design.family.gust_time,
        "gyro_hover": design.family.q_noise,
    }


def flown(designs: list[FlownDesign], seed: int) -> RigFlights:
    """The noisy flights, a lane for each design."""
    every = [one.gains.parameters() for one in designs]
    return fly_rigs(
        [rig_of(one) for one in designs],
        "theta0",
        designs[0].promise.goal,
        float(designs[0].promise.time[-1]),
        tuned={f"flight.cascade.{path}": [gains[path] for gains in every] for path in every[0]},
        read=CHANNELS,
        seed=seed,
    )


def shares(designs: list[FlownDesign], seed: int, flights: int = 1) -> dict[str, float]:
    """The share of `flights` of each design in which its promise held, by channel and by figure."""
    kept: dict[str, int] = {}
    for flight in range(flights):
        made = flown(designs, seed + flight * len(designs))
        for k, one in enumerate(designs):
            found = one.promise.verdict(made.time, {name: y[:, k] for name, y in made.channels.items()})
            for name in found.names:
                kept[name] = kept.get(name, 0) + found.steps[0].kept(name)
    return {name: count / (flights * len(designs)) for name, count in kept.items()}


def main() -> None:
    """Print the shares."""
    options = argparse.ArgumentParser(description=__doc__)
    for name, default in (("designs", 200), ("members", 1000), ("flights", 5), ("seed", 1)):
        options.add_argument(f"--{name}", type=int, default=default)
    asked = options.parse_args()
    designs = designed(asked.designs, asked.members, asked.seed)
    count = asked.designs * asked.flights
    lines = [f"{asked.designs} designs, {asked.members} members each, {count} flights, promised at 95 %; kept by:"]
    for name, share in shares(designs, 1000 * asked.seed, asked.flights).items():
        lines.append(f"  {name:14}{100.0 * share:6.1f} %")
    lines.append(f"({count} flights tell a share of 95 % to within {196.0 * math.sqrt(0.95 * 0.05 / count):.1f} %)")
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
