"""PitchLaw: the law of the pitch that a drone flies, from its parameters and, where one flies, its own controller."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from twodof.blocks.schema.json_form import from_json
from twodof.design.uncertain.pitch_family import PitchFamily
from twodof.design.uncertain.robustness import Robustness, robustness
from twodof.design.uncertain.sampled_controller import SampledController
from twodof.design.uncertain.tuning_preview import TuningPreview, controller_preview, tuning_preview
from twodof.errors import ParameterError
from twodof.flight.gains import Gains
from twodof.flight.templates import ATTITUDE

GAINS = ("RATE_KP", "RATE_KI", "RATE_KD", "ATT_KP")
"""The parameters of the stock law of the pitch that a preview knows."""

SURE = 200
"""Members that are drawn for a verdict, as for a preview."""


@dataclass(frozen=True, eq=False)
class PitchLaw:
    """`controller` is the law as matrices; `gains` those of the stock law, None of a user's controller `name`.

    `parameters` are the names of what tunes it.
    """

    name: str
    controller: SampledController
    gains: Gains | None
    parameters: frozenset[str]

    @classmethod
    def flown(
        cls, values: Mapping[str, float], diagram: str | bytes | None = None, paths: Mapping[str, str] | None = None
    ) -> Self:
        """The law of a drone with the parameters `values`, by name.

        `diagram` is the JSON of its own controller of the template attitude_control, whose parameters `paths` says
        where they are: name -> "attitude_control.k_q". Raises ParameterError for gains that cannot be, DiagramError for
        a controller that has no linear model.
        """
        if diagram is not None:
            found = from_json(diagram if isinstance(diagram, str) else diagram.decode())
            start = f"{ATTITUDE.name}."
            inside = {name: path[len(start) :] for name, path in (paths or {}).items() if path.startswith(start)}
            set_to = {path: values[name] for name, path in inside.items() if name in values}
            return cls(found.name, SampledController.of(found, set_to), None, frozenset(inside))
        gains = Gains.flown({"parameters": dict(values)})
        if gains is None:
            raise ParameterError("its gains are out of their bounds", "the drone's parameters", "set them back")
        return cls("", SampledController.of_cascade(*gains.rate, gains.attitude), gains, frozenset(GAINS))

    @property
    def digest(self) -> str:
        """The same for the same law to the bit, and for no other."""
        parts = (self.controller.a, self.controller.b, self.controller.c, self.controller.d)
        return hashlib.sha256(b"".join(repr(part.shape).encode() + part.tobytes() for part in parts)).hexdigest()

    def preview(self, family: PitchFamily, goal: float) -> TuningPreview:
        """What it does on `family`, with a step of theta by `goal` [rad]."""
        if self.gains is not None:
            return tuning_preview(family, self.gains, goal=goal, members=SURE)
        return controller_preview(family, self.controller, goal=goal, members=SURE)

    def verdict(self, family: PitchFamily) -> Robustness:
        """Whether a member of the family is found that it does not keep stable, as in the preview; without a proof."""
        return robustness(self.controller, family, SURE, most=1)
