"""State machines: modes, guarded transitions and their actions as one block. See docs/how-to/state-machine.md."""

from twodof.blocks.state_machine.mode import Mode as Mode
from twodof.blocks.state_machine.mode import Transition as Transition
from twodof.blocks.state_machine.state_machine import StateMachine as StateMachine
