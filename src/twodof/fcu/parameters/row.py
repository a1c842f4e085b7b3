"""One parameter of the vehicle, as it goes over the wire."""

import struct
from dataclasses import dataclass

from twodof.parameters import Parameter


@dataclass(frozen=True)
class VehicleParameter(Parameter):
    """A parameter as a vehicle describes it.

    `group` is where a ground station shows it. `disarmed`: it is changed only while disarmed; `reboot`: a change acts
    after the next start. `acts` is False for one that clients of PX4 ask for and nothing on board reads. `of` names the
    parameter that this one is another name of. `user_path` is its place in a user's diagram, such as
    `attitude_control.k_q`, with an index for an array's element. One without bounds in the diagram is not `bounded`.
    """

    group: str = "Flight"
    disarmed: bool = False
    reboot: bool = False
    acts: bool = True
    of: str = ""
    user_path: str = ""
    bounded: bool = True

    def bits(self, value: float) -> bytes:
        """The four bytes of a value, as PARAM_VALUE carries them."""
        return struct.pack("<i", int(value)) if self.kind == "int32" else struct.pack("<f", value)

    @property
    def fixed(self) -> bool:
        """Whether it has only one value, which tells a client something."""
        return self.low == self.high
