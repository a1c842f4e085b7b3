"""How long a test waits before it says that something hangs: one figure for every wait that states nothing itself.

It ends what would wait for ever, and no machine, however loaded, takes so long over what works. A time that a test
*states* is measured where load does not count: in virtual time, in control periods, in processor time, or against
something else that runs beside it.
"""

PATIENCE_S = 120.0
