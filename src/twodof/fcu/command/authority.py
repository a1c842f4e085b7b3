"""Authority: who may command, and whether the drone hears it.

The rules are those of the lease (docs/reference/protocol.md).
"""

from __future__ import annotations

from twodof.fcu.command.command_lease import COMMANDING, CommandLease, LeaseState
from twodof.fcu.command.result import ACCEPTED, DENIED, TEMPORARILY_REJECTED, CommandResult, Source
from twodof.signals import PERIOD

DONE = CommandResult(ACCEPTED)


class CommandAuthority:
    """Answers who asks for the lease, and says in each tick whether the link is alive.

    A sender is one whose system is not 0; its component may be, as that of many a script is, and PX4 takes those too.
    With `granted` the time that passes was granted by the holder, so the link is alive in every tick.
    """

    def __init__(self, granted: bool) -> None:
        self._granted = granted
        self._lease = CommandLease()
        self._heard = False

    @property
    def holder(self) -> Source | None:
        """Who holds the lease, None: nobody."""
        return self._lease.holder

    @property
    def changes(self) -> int:
        """Counts the changes of holder."""
        return self._lease.revision

    @property
    def orphaned(self) -> bool:
        """Whether the drone was left without a pilot in flight, and nobody took over since."""
        return self._lease.orphaned

    @property
    def tuning_withheld(self) -> bool:
        """Whether nobody but the holder may change parameters."""
        return self._lease.tuning_withheld

    @property
    def heard(self) -> bool:
        """Whether the link is alive in the tick that comes."""
        return self._heard or self._granted

    def lease(self, tick: int, flying: bool) -> LeaseState:
        """How the lease stands at `tick`."""
        return self._lease.state(tick, flying)

    def hear(self, source: Source, is_client: bool, tick: int) -> None:
        """Notes a frame of any kind: the holder's keeps the link alive, or while nobody holds the lease a client's."""
        if self._lease.holder is None:
            self._heard |= is_client and not self._lease.orphaned
        elif self._lease.hear(source, tick):
            self._heard = True

    def take(self, source: Source, what: str, tick: int) -> CommandResult:
        """Whether `source` may command; takes a free lease for it. `what` it wanted is named in a refusal."""
        if not source[0]:
            return CommandResult(DENIED, f"{what} refused: it has no sender")
        if not self._lease.command(source, tick):
            return CommandResult(TEMPORARILY_REJECTED, f"{what} refused: {self._who()} holds the lease")
        self._heard = True
        return DONE

    def may_tune(self, source: Source, what: str, tick: int) -> CommandResult:
        """Whether `source` may change parameters: anybody, unless the holder withholds it.

        It takes no lease; that of its holder it renews. `what` it wanted is named in a refusal.
        """
        if not source[0]:
            return CommandResult(DENIED, f"{what} refused: it has no sender")
        if not self._lease.may_tune(source):
            return CommandResult(
                TEMPORARILY_REJECTED, f"{what} refused: {self._who()} holds the lease and withholds tuning"
            )
        return self.take(source, what, tick) if self._lease.holder == source else DONE

    def ask(self, source: Source, duration_ms: int, tick: int, withhold_tuning: bool = False) -> CommandResult:
        """Takes the lease, or renews it, for a time of 30 s at most (0: 2 s); refused while another holds it.

        `withhold_tuning`: until it is renewed without that, or ends, nobody else may change parameters.
        """
        if not source[0]:
            return CommandResult(DENIED, "lease refused: it has no sender")
        ticks = round(duration_ms * 1e-3 / PERIOD) if duration_ms else COMMANDING
        if not self._lease.ask(source, tick, ticks, withhold_tuning):
            return CommandResult(TEMPORARILY_REJECTED, f"lease refused: {self._who()} holds it")
        self._heard = True
        return DONE

    def give_up(self, source: Source, flying: bool) -> CommandResult:
        """Frees the lease; refused to all but its holder."""
        if self._lease.give_up(source, flying):
            return DONE
        return CommandResult(TEMPORARILY_REJECTED, f"lease not given up: {self._who()} holds it")

    def passes(self, tick: int, flying: bool) -> None:
        """The tick before `tick` has begun: what was heard was for that one, and a lease may be over."""
        self._heard = False
        if self._granted and self._lease.holder is not None:
            self._lease.hear(self._lease.holder, tick - 1)
        self._lease.expire(tick, flying)

    def stands(self, ticks: int) -> None:
        """So much real time has passed while none was granted."""
        self._lease.stands(ticks)

    def landed(self) -> None:
        """The motors stand: nobody is missed any more."""
        self._lease.orphaned = False

    def restart(self, tick: int) -> None:
        """Time begins again at 0, it was `tick`; who holds the lease has as much of it left."""
        self._lease.moved(-tick)
        self._heard = False

    def _who(self) -> str:
        holder = self._lease.holder
        return f"system {holder[0]}, component {holder[1]}" if holder is not None else "nobody"
