"""The lease: one holder at most, nobody else's command acts, kill and disarm always do, and it ends in bounded time."""

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from tests.fcu.command.cockpit import COMPANION, ME, OTHER, Cockpit, armed
from twodof.errors import RefusalReason
from twodof.excitation import Impulse
from twodof.fcu.command.arming import PATIENCE
from twodof.fcu.command.command_lease import COMMANDING, HEARD, LONGEST, Source
from twodof.fcu.command.commander import Commander
from twodof.fcu.command.excitation_player import MOST_EFFORT, PLAYING, written_out
from twodof.fcu.command.setpoints import CAPACITY, FRESH, HORIZON
from twodof.fcu.control.loop import MOST_GRANTED
from twodof.flight.failsafe.state_machine import OFF
from twodof.link.mavlink import modes
from twodof.link.mavlink.setpoints import SetPoint
from twodof.signals import ATTITUDE

CLIENTS = (ME, OTHER, COMPANION)
MANY = 400  # one example is some milliseconds
IMPULSE = written_out(Impulse(0.05, 0.02, settle=0.2))


def standing(commander: Commander) -> tuple[Source | None, int, int]:
    """Return holder of the lease, its remaining ticks, and the count of changes."""
    return commander.lease.holder, commander.lease.left, commander.lease.revision


def test_disarmed_it_ends_two_seconds_after_the_last_command_however_much_its_holder_says() -> None:
    cockpit = Cockpit(talking=(ME,))
    cockpit.run(2)
    cockpit.commander.set_mode(ME, modes.RATE)
    cockpit.run(COMMANDING - 1)
    assert standing(cockpit.commander) == (ME, 1, 1)
    cockpit.run()
    assert cockpit.commander.lease.holder is None


def test_armed_it_lasts_while_its_holder_is_heard_and_three_seconds_more() -> None:
    cockpit = armed(talking=(ME,))
    cockpit.run(3 * HEARD)
    assert cockpit.commander.lease.holder == ME
    cockpit.talking = (OTHER,)
    cockpit.run(HEARD - 2)  # it was last heard before the tick that ran last
    assert standing(cockpit.commander) == (ME, 1, 1)
    cockpit.run()
    assert cockpit.commander.lease.holder is None
    assert cockpit.commander.lease.request(OTHER).accepted


def test_the_times_are_those_of_the_page() -> None:
    """docs/reference/protocol.md in ticks of 4 ms: 2 s, 3 s, 30 s; set-points above 2 Hz; a minute ahead; 256 wait."""
    assert (COMMANDING, HEARD, LONGEST, FRESH, HORIZON, CAPACITY) == (500, 750, 7500, 125, 15_000, 256)
    assert (PATIENCE, MOST_GRANTED, MOST_EFFORT) == (25, 25_000, 1e8)
    commander = Cockpit(talking=()).commander
    assert commander.lease.request(ME).accepted
    assert commander.lease.left == COMMANDING


def test_every_change_of_holder_is_counted() -> None:
    cockpit = Cockpit(talking=())
    cockpit.commander.lease.request(ME, 4)
    assert cockpit.commander.lease.revision == 1
    cockpit.commander.lease.give_up(ME)
    assert cockpit.commander.lease.revision == 2
    cockpit.commander.lease.request(OTHER, 4)
    cockpit.run(5)
    assert standing(cockpit.commander) == (None, 0, 4)
    assert cockpit.commander.remarks == [(6, "nobody holds the lease any more")]


def test_asked_for_it_lasts_its_time_and_half_a_minute_at_most() -> None:
    cockpit = Cockpit(talking=())
    cockpit.run(2)
    for asked_ms, ticks in ((10_000, 2500), (0, COMMANDING), (1, 1), (2**32 - 1, LONGEST)):
        assert cockpit.commander.lease.request(ME, asked_ms).accepted
        assert cockpit.commander.lease.left == ticks
    cockpit.run(LONGEST - 1)
    assert cockpit.commander.lease.holder == ME
    cockpit.run()
    assert cockpit.commander.lease.holder is None


def test_in_lockstep_the_time_that_its_holder_grants_does_not_end_it_in_flight() -> None:
    cockpit = armed(talking=(), lockstep=True)
    assert cockpit.run(5 * HEARD).link_new
    assert standing(cockpit.commander) == (ME, HEARD - 1, 1)


def test_its_holder_goes_on_with_it_however_long_time_stood() -> None:
    commander = Cockpit(lockstep=True).commander
    assert commander.lease.request(ME, 30_000).accepted
    commander.lease.note_standstill(10 * HEARD)
    assert standing(commander) == (ME, 0, 1)
    assert commander.lease.take(ME).accepted
    assert standing(commander) == (ME, LONGEST, 1)


def test_before_anybody_is_heard_there_is_no_link_and_what_was_heard_counts_for_a_tick() -> None:
    cockpit = Cockpit(talking=())
    assert not cockpit.run().link_new
    cockpit.commander.lease.note_frame(COMPANION, True)
    cockpit.commander.lease.note_frame((2, 1), False)  # another vehicle, after it
    assert cockpit.run().link_new
    cockpit.commander.lease.note_frame(COMPANION, True)
    cockpit.commander.restart()
    assert not cockpit.commander.control_input(0).link_new


def test_a_script_without_a_component_commands_like_another() -> None:
    """pymavlink's default is component 0. It is none of the others of its system."""
    script: Source = (250, 0)
    cockpit = Cockpit(talking=(script,))
    cockpit.run(3)
    assert cockpit.arm(script).accepted
    assert cockpit.commander.lease.holder == script
    assert cockpit.commander.arming.arm(ME).text == "arming refused: system 250, component 0 holds the lease"
    cockpit.run(2 * HEARD)
    assert cockpit.commander.lease.holder == script


def test_the_link_is_the_holders_and_with_no_holder_any_clients() -> None:
    cockpit = Cockpit(talking=())
    cockpit.commander.lease.note_frame(OTHER, True)
    assert cockpit.run().link_new
    assert not cockpit.run().link_new
    cockpit.commander.lease.note_frame((2, 1), False)  # another vehicle
    assert not cockpit.run().link_new
    cockpit.commander.lease.request(ME, 10_000)
    cockpit.run()
    cockpit.commander.lease.note_frame(OTHER, True)
    assert not cockpit.run().link_new
    cockpit.commander.lease.note_frame(ME, True)
    assert cockpit.run().link_new


def test_a_pilot_that_fell_silent_in_flight_is_not_replaced_by_who_only_listens() -> None:
    cockpit = armed(talking=(ME,))
    cockpit.talking = (OTHER,)
    linked = [cockpit.run().link_new for _ in range(2 * HEARD)]
    assert cockpit.commander.remarks[-1] == (4, "nobody holds the lease any more")
    assert not any(linked[1:])  # the failsafe's timer runs out
    cockpit.talking = ()
    cockpit.commander.lease.request(OTHER, 10_000)
    assert cockpit.run().link_new
    assert not cockpit.run().link_new
    cockpit.commander.set_mode(OTHER, modes.HOLD)
    assert cockpit.run().link_new


def test_a_pilot_that_gave_up_in_flight_is_not_replaced_by_who_only_listens_either() -> None:
    cockpit = armed(talking=(ME,))
    assert cockpit.commander.lease.give_up(ME).accepted
    cockpit.talking = (ME, OTHER)
    cockpit.run()
    assert not any(cockpit.run().link_new for _ in range(2 * HEARD))
    cockpit.commander.lease.request(OTHER, 10_000)
    assert cockpit.run().link_new


def test_the_holders_disarming_is_a_command_that_renews_it_and_anothers_is_not() -> None:
    cockpit = Cockpit(talking=())
    cockpit.run(2)
    cockpit.commander.set_mode(ME, modes.RATE)
    cockpit.run(100)
    cockpit.commander.arming.disarm(OTHER)
    assert cockpit.commander.lease.left == COMMANDING - 100
    cockpit.commander.arming.disarm(ME)
    assert cockpit.commander.lease.left == COMMANDING
    cockpit.run(COMMANDING)
    cockpit.commander.arming.disarm(ME)
    assert cockpit.commander.lease.holder is None, "nor does it take one"


def test_nobody_is_missed_once_the_failsafe_has_stopped_the_motors() -> None:
    cockpit = armed(talking=(ME,))
    cockpit.failsafe.acts = OFF
    cockpit.run(2)
    assert cockpit.commander.lease.give_up(ME).accepted
    cockpit.talking = ()
    cockpit.run(2)
    cockpit.commander.lease.note_frame(COMPANION, True)
    assert cockpit.run().link_new


def test_where_time_stands_who_died_gives_way_with_all_that_it_has_sent_ahead() -> None:
    """`stands` counts real time without a grant of the holder; a frame of the holder resets the count."""
    for take in (lambda one: one.lease.request(OTHER), lambda one: one.lease.take(OTHER)):
        cockpit = armed(talking=(), lockstep=True)
        commander = cockpit.commander
        for ahead in (3, 5):
            commander.setpoint(ME, SetPoint(ATTITUDE, theta0=0.1, thrust=0.4), cockpit.tick + ahead)
        commander.lease.note_standstill(HEARD - 1)
        commander.lease.note_frame(ME, True)
        commander.lease.note_standstill(HEARD - 1)
        assert commander.lease.left == 1
        assert not take(commander).accepted
        commander.lease.note_standstill(1)
        assert standing(commander) == (ME, 0, 1)
        assert take(commander).accepted
        assert (commander.lease.holder, commander.lease.revision) == (OTHER, 2)
        assert commander.lease.left > 1
        assert commander.refused == {RefusalReason.LEASE: 2}
        assert cockpit.run(10).mode == 0


class TwoClients(RuleBasedStateMachine):
    """Anybody says anything at any time; a model of two lines says who may command."""

    @initialize(lockstep=st.booleans())
    def begin(self, lockstep: bool) -> None:
        self.cockpit = Cockpit(lockstep=lockstep, talking=())
        self.commander = self.cockpit.commander
        self.transfer = 0
        self.killed = False
        self.heard_at = dict.fromkeys(CLIENTS, -(10**6))
        self.asked_at = dict.fromkeys(CLIENTS, (-(10**6), 0))
        self.cockpit.run(2)

    def _may(self, source: Source) -> bool:
        holder = self.commander.lease.holder
        self.heard_at[source] = self.cockpit.tick
        return holder in (None, source)

    def _checked(self, source: Source, may: bool, accepted: bool, busy: bool = True) -> None:
        if not may:
            assert not accepted
            assert self.commander.lease.holder not in (None, source)
        elif busy:
            assert self.commander.lease.holder == source

    @rule(source=st.sampled_from(CLIENTS), ms=st.sampled_from([0, 4, 400, 5000, 2**32 - 1]))
    def ask(self, source: Source, ms: int) -> None:
        may = self._may(source)
        verdict = self.commander.lease.request(source, ms)
        assert verdict.accepted == may
        self._checked(source, may, verdict.accepted)
        if may:
            self.asked_at[source] = (self.cockpit.tick, min(ms // 4, LONGEST))

    @rule(source=st.sampled_from(CLIENTS))
    def give_up(self, source: Source) -> None:
        held = self.commander.lease.holder == source
        assert self.commander.lease.give_up(source).accepted == held
        assert not held or self.commander.lease.holder is None

    @rule(source=st.sampled_from(CLIENTS), mode=st.sampled_from([*modes.BY_NUMBER]))
    def choose(self, source: Source, mode: int) -> None:
        may, before = self._may(source), self.commander.custom_mode
        verdict = self.commander.set_mode(source, mode)
        self._checked(source, may, verdict.accepted)
        assert may or self.commander.custom_mode == before

    @rule(source=st.sampled_from(CLIENTS))
    def arm(self, source: Source) -> None:
        may = self._may(source)
        verdict = self.commander.arming.arm(source)
        self._checked(source, may, verdict.result in (0, 5))

    @rule(source=st.sampled_from(CLIENTS), theta0=st.sampled_from([-0.1, 0.1]), ahead=st.sampled_from([0, 0, 3, 300]))
    def aim(self, source: Source, theta0: float, ahead: int) -> None:
        may = self._may(source)
        mark = theta0 * (1 + CLIENTS.index(source))  # tells whose it is
        setpoint = SetPoint(ATTITUDE, theta0=mark, thrust=0.4)
        verdict = self.commander.setpoint(source, setpoint, self.cockpit.tick + ahead if ahead else 0)
        self._checked(source, may, verdict.accepted)
        if may and not ahead:
            self.latest = source
        if not may:
            assert self.cockpit.run().theta0 != mark or self.latest == source

    latest: Source | None = None

    @rule(source=st.sampled_from(CLIENTS), start=st.booleans())
    def excite(self, source: Source, start: bool) -> None:
        may, before = self._may(source), self.commander.excitation.player.state
        if start:
            verdict = self.commander.excitation.start(source, self.transfer, 0, 0.4)
        else:
            self.transfer += 1
            verdict = self.commander.excitation.define(source, self.transfer, IMPULSE)
        self._checked(source, may, verdict.accepted)
        assert may or self.commander.excitation.player.state == before

    @rule(source=st.sampled_from(CLIENTS), kill=st.booleans())
    def stop(self, source: Source, kill: bool) -> None:
        verdict = self.commander.arming.kill(source) if kill else self.commander.arming.disarm(source)
        assert verdict.accepted
        asked = self.cockpit.run()
        assert (asked.arm, asked.mode) == (False, 0)
        self.killed = self.killed or kill
        assert (self.commander.arming.killed_by is not None) == self.killed
        assert self.commander.excitation.player.state != PLAYING

    @rule(source=st.sampled_from(CLIENTS))
    def release(self, source: Source) -> None:
        may = self._may(source)
        verdict = self.commander.arming.release(source)
        self._checked(source, may, verdict.accepted)
        self.killed = self.killed and not may
        assert (self.commander.arming.killed_by is not None) == self.killed

    @rule(sources=st.sets(st.sampled_from(CLIENTS)), ticks=st.sampled_from([1, 5, 300, 800]))
    def pass_time(self, sources: set[Source], ticks: int) -> None:
        self.cockpit.talking = sources
        self.cockpit.run(ticks)
        self.cockpit.talking = ()
        for source in sources:
            self.heard_at[source] = self.cockpit.tick

    @invariant()
    def ends_in_bounded_time(self) -> None:
        lease = self.commander.lease
        assert lease.holder is not None or lease.left == 0
        assert lease.left <= LONGEST
        if lease.holder is not None and lease.left == 0:
            # Its time may be over in the very tick in which the motors stop; then it ends in the next one.
            self.cockpit.run()
            lease = self.commander.lease
            assert lease.holder is None or lease.left > 0
        if lease.holder is not None and not self.cockpit.lockstep:
            silent = self.cockpit.tick - self.heard_at[lease.holder]
            since, ticks = self.asked_at[lease.holder]
            assert silent <= max(COMMANDING, HEARD) or self.cockpit.tick <= since + max(ticks, COMMANDING)

    @invariant()
    def never_armed_while_killed(self) -> None:
        assert not (self.commander.arming.killed_by and self.cockpit.run().arm)


TestTwoClients = TwoClients.TestCase
TestTwoClients.settings = settings(max_examples=MANY // 16, stateful_step_count=40, deadline=None)


@pytest.mark.soak
class TestTwoClientsAtLength(TwoClients.TestCase):
    """The same, many times."""

    settings = settings(max_examples=MANY, stateful_step_count=40, deadline=None)
