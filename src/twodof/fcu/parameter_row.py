"""One parameter of the vehicle, as it goes over the wire."""

from __future__ import annotations

from dataclasses import dataclass

from twodof.parameters import Parameter


@dataclass(frozen=True)
class Row(Parameter):
    """A parameter with what a vehicle says of it besides.

    `group` is where a ground station shows it. `disarmed`: it is changed only while disarmed; `reboot`: a change acts
    after the next start. `acts` is False for one that clients of PX4 ask for and nothing on board reads. `of` names the
    parameter that this one is another name of. `path` is where it stands in the failsafe's diagram.
    """

    group: str = "Flight"
    disarmed: bool = False
    reboot: bool = False
    acts: bool = True
    of: str = ""
    path: str = ""

    @property
    def fixed(self) -> bool:
        """Whether it has only one value, which tells a client something."""
        return self.low == self.high
