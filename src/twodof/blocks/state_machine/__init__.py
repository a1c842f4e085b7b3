"""State machines: modes, transitions and actions as one block. See docs/how-to/write-a-state-machine.md."""

from twodof.blocks.state_machine.chart import Mode as Mode
from twodof.blocks.state_machine.chart import Transition as Transition
from twodof.blocks.state_machine.state_machine import StateMachine as StateMachine
