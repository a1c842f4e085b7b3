"""State machine of the failsafe, on integers and flags only, and the memory of the causes for which it acts."""

from functools import reduce
from operator import or_
from typing import Any

from twodof.blocks import Block, Port, State, int32, maximum, where
from twodof.flight.declarations import ports, tunable, tunables
from twodof.flight.failsafe.causes_and_actions import ACTIONS, BIT, CAUSES, NONE
from twodof.flight.failsafe.flags import ticks

STATES = ("disarmed", "refused", "flying", "level", "brake", "descend", "off")
"""States of the failsafe, by number. Motors may turn in flying, level, brake and descend."""

DISARMED, REFUSED, FLYING, LEVEL, BRAKE, DESCEND, OFF = range(len(STATES))

MAY_TURN = (FLYING, LEVEL, BRAKE, DESCEND)
"""The states in which motors may turn."""


class FailsafeStateMachine(Block):
    """Arming, the actions of the failsafe, and the transitions between them.

    ========== =========================================================================================
    from       to
    ========== =========================================================================================
    any        disarmed, while `arm` is false
    disarmed   flying where `ready`, else refused: until `arm` was false once
    armed      off where `off`; else
    descend    off after `descent` s, in every case
    armed      descend where `descend`, or after `level_limit` s of level and brake; else
    armed      brake where `brake`; else
    armed      level where `level` or the user's controller has failed; else flying
    off        stays, until disarmed
    ========== =========================================================================================

    An action follows its cause in the same tick. The faults that the gate finds behind the controllers (`user_lost`,
    `command_lost`) stop the motors at the gate, and reach this machine in the next tick. `user_flies` is true if the
    user's controller flies, unless the gate finds a fault in this tick; after a fault it does not fly again until the
    drone is disarmed. `stuck` means that the commands to the motors do not change. `timer` counts the ticks of descend,
    or of level and brake together, 0 in the first. `action` is the index into `causes_and_actions.ACTIONS`.
    """

    inputs = (
        *(Port(name, "bool") for name in ("arm", "ready", "off", "descend", "brake", "level", "stuck")),
        *ports("user_given", "user_lost", "command_lost"),
    )
    outputs = (
        *ports("state", "timer"),
        Port("action", "int32"),
        Port("armed", "bool"),
        *ports("user_flies", "failed", "stopped", "stuck_off"),
    )
    states = (State("state", DISARMED, "int32"), State("timer", 0, "int32"), State("user_failed", False, "bool"))
    derived = (Port("level_ticks", "int32"), Port("descent_ticks", "int32"))
    params = (*tunables("failsafe.machine"), tunable("failsafe.descent"))

    def prepare(self, p: Any, t: Any) -> Any:
        return {"level_ticks": ticks(p.level_limit, t.dt), "descent_ticks": ticks(p.descent, t.dt)}

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        held = x.state
        # A state that does not exist counts as none in which motors may turn, and stays until disarmed.
        armed = (held >= int32(FLYING)) & (held <= int32(DESCEND))
        user_flew = u.user_given & ~x.user_failed & (held == int32(FLYING))
        stuck_off = armed & u.stuck & ~user_flew
        failed = u.arm & (x.user_failed | (user_flew & u.stuck))
        spent = maximum(x.timer, int32(0)) + int32(1)  # ticks of the action, if this is one more
        acted = (held == int32(LEVEL)) | (held == int32(BRAKE))
        weaker = where(u.brake, int32(BRAKE), where(u.level | failed, int32(LEVEL), int32(FLYING)))
        end = where(
            held == int32(DESCEND),
            where(spent >= p.descent_ticks, int32(OFF), int32(DESCEND)),
            where(u.descend | (acted & (spent >= p.level_ticks)), int32(DESCEND), weaker),
        )
        state = where(
            ~u.arm,
            int32(DISARMED),
            where(
                held == int32(DISARMED),
                where(u.ready & ~(u.off | u.descend | u.brake | u.level), int32(FLYING), int32(REFUSED)),
                where(armed, where(u.off | stuck_off, int32(OFF), end), held),
            ),
        )
        acts = (state == int32(LEVEL)) | (state == int32(BRAKE))
        counted = (acts & acted) | ((state == int32(DESCEND)) & (held == int32(DESCEND)))
        stopped = (state < int32(FLYING)) | (state > int32(DESCEND))
        return {
            "state": state,
            "timer": where(counted, spent, int32(0)),
            "action": where(stopped, int32(ACTIONS.index("off")), state - int32(FLYING)),
            "armed": ~stopped,
            "user_flies": u.user_given & (state == int32(FLYING)) & ~failed,
            "failed": failed,
            "stopped": stopped,
            "stuck_off": stuck_off,
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        now = self.output(u, x, p, t)
        return {
            "state": where(u.command_lost & ~now["stopped"], int32(OFF), now["state"]),
            "timer": now["timer"],
            "user_failed": u.arm & (now["failed"] | u.user_lost),
        }


class Reasons(Block):
    """Causes for which the failsafe acts: a mask of `causes_and_actions.CAUSES`, 0 while disarmed.

    While it acts, the mask holds all causes since it began to act, up to the tick in which the motors stopped. In the
    state refused it holds the causes that prevented arming, in flying the warnings without an action (a low battery).
    """

    inputs = ports("state", "mask", "failed", "stuck_off", "user_lost", "command_lost")
    outputs = (Port("reason", "int32"),)
    states = (State("held", 0, "int32"), State("was", DISARMED, "int32"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        bits = [
            where(u[name], int32(BIT[cause]), int32(0))
            for name, cause in (
                ("failed", "user_failed"),
                ("user_lost", "user_failed"),
                ("stuck_off", "command_stuck"),
                ("command_lost", "command_lost"),
            )
        ]
        refused = u.state == int32(REFUSED)
        flying = u.state == int32(FLYING)
        outer = where(refused, u.mask, u.mask & where(flying, int32(_WARNINGS), int32(_ACTING)))
        now = reduce(or_, [outer, *bits])
        final = (refused | (u.state == int32(OFF))) & (u.state == x.was)
        held = where(u.state == x.was, x.held, where(u.state > int32(FLYING), x.held, int32(0)))
        return where(u.state == int32(DISARMED), int32(0), where(final, x.held, held | now))

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        flown = (u.state == int32(FLYING)) & ~(u.user_lost | u.command_lost)
        return {"held": where(flown, int32(0), self.output(u, x, p, t)), "was": u.state}


_WARNINGS = BIT["battery_low"]
_ACTING = reduce(or_, [BIT[cause.name] for cause in CAUSES if cause.action != NONE])
