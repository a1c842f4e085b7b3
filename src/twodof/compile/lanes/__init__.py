"""Many instances of one diagram at once, in the processor's vectors."""

from twodof.compile.lanes.lanes_program import LanesMachine, LanesProgram, build_lanes

__all__ = ["LanesMachine", "LanesProgram", "build_lanes"]
