"""Flights of the rows: `python -m tests.fmea.fly [--times N] [text]` prints what the rows with `text` measured."""

import argparse
import sys
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.fmea.loop import ONSET, fly, rig_values, settled
from tests.fmea.rows import ROWS, SITUATIONS, Row
from twodof.flight.failsafe.causes_and_actions import ACTIONS, named_causes
from twodof.rig.parameters import NAMES

BATCH = 512
"""Instances that fly at once."""

AT_A_STOP = 300
"""How long motors may be on once a stop was met, at a fault that can be seen [ms]."""


@dataclass(frozen=True)
class Flown:
    """A row in one situation on one rig; what the witness saw by name, (times,) each."""

    row: Row
    situation: str
    rig: str
    seen: dict[str, NDArray[Any]]

    @property
    def breaks(self) -> bool:
        """Return True if the motors were on for longer than AT_A_STOP after a stop was met."""
        return bool(self.seen["on_after"].max() > AT_A_STOP)

    def at(self, action: str) -> str:
        """When an action or a stronger one was taken, the earliest and the latest."""
        times = self.seen[f"{action}_at"] if action in ACTIONS[1:] else np.array([-1])
        taken = times[times >= 0]
        return f"{taken.min()}..{taken.max()}" if taken.size else "-"

    def line(self) -> str:
        """As text, the worst of all times."""
        seen = self.seen
        did = " or ".join(ACTIONS[a] for a in sorted(set(seen["strongest"].tolist())))
        causes = ", ".join(named_causes(int(np.bitwise_or.reduce(seen["reason"]))))
        return (
            f"{self.row.component} | {self.row.text} | {self.situation} | {self.rig} "
            f"| first at {self.at('level')} {did} at {self.at(ACTIONS[int(seen['strongest'].max())])} ms "
            f"| theta {seen['theta'].max():.2f} x {seen['x'].max():.3f} "
            f"| impact {seen['impact_q'].max():.1f} rad/s {seen['impact_v'].max():.2f} m/s "
            f"| touched at {seen['touched_at'].min()}..{seen['touched_at'].max()} "
            f"on at it {seen['at_stop'].max()} on after it {seen['on_after'].max()} ms "
            f"| {causes}{' | BREAK' if self.breaks else ''}"
        )


def flown(rows: Sequence[Row], times: Sequence[int]) -> Iterator[Flown]:
    """Each row in each of its situations on each rig, so many `times`, each with a seed of its own."""
    jobs = [(row, situation, rig) for row in rows for situation in row.situations for rig in NAMES]
    rigs = {rig: rig_values(rig) for rig in NAMES}
    lanes, changes = [], []
    for row, situation, rig in jobs:
        script = {f"script.{name}": value for name, value in SITUATIONS[situation].items() if name != "rings"}
        # The seed is that of the row, so that a new row leaves the figures of the others as they are.
        first = zlib.crc32(f"{row.name} {situation} {rig}".encode()) % 2**20
        for seed in (first + 2**20 * time for time in times):
            of_seed = {
                "seed": seed,
                "rings": SITUATIONS[situation]["rings"],
                "rig.tof_phase": 0.37 * seed % 1.0,
                "onset": ONSET if row.changes else ONSET + 53 * seed % 220,
            }
            lanes.append(rigs[rig] | script | of_seed | dict(row.faults))
            changes.append(row.changes)
    start = settled()
    parts = []
    for begin in range(0, len(lanes), BATCH):
        mine, later = lanes[begin : begin + BATCH], changes[begin : begin + BATCH]
        parts.append(fly(mine, later, start))
    seen = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    for place, (row, situation, rig) in enumerate(jobs):
        mine_of = slice(place * len(times), (place + 1) * len(times))
        yield Flown(row, situation, rig, {name: values[mine_of] for name, values in seen.items()})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("text", nargs="?", default="", help="part of a row's name, component: fault")
    parser.add_argument("--times", type=int, default=1)
    given = parser.parse_args()
    chosen = [row for row in ROWS if given.text in row.name]
    for one in flown(chosen, range(given.times)):
        sys.stdout.write(f"{one.line()}\n")
