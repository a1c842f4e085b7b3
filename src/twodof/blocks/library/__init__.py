"""The library of blocks; docs/reference/blocks.md lists them with their ports and parameters.

Each file names its own blocks in `__all__`; nothing else has to know of a new one.
"""

from twodof.blocks.library.continuous import *
from twodof.blocks.library.control import *
from twodof.blocks.library.delays import *
from twodof.blocks.library.discrete import *
from twodof.blocks.library.estimation import *
from twodof.blocks.library.filters import *
from twodof.blocks.library.functions import *
from twodof.blocks.library.logic import *
from twodof.blocks.library.math import *
from twodof.blocks.library.nonlinear import *
from twodof.blocks.library.playback import *
from twodof.blocks.library.routing import *
from twodof.blocks.library.sources import *
from twodof.blocks.library.waveforms import *
