"""What flies: the user's controllers, the values of their parameters and of all others, and how clients are told."""

from typing import Any

from twodof.fcu.control.controllers import ControllerIdentity, Controllers, controller_identity
from twodof.fcu.control.loop import FlightController
from twodof.fcu.parameters.parameter_store import ParametersChanged, ParameterStore


class ActiveConfiguration:
    """Builds the flight code from `controllers`, and keeps its parameters at the values of `store`.

    `remarks` says in words what could not be taken over. `fresh` begins without uploads, and with all defaults.
    """

    def __init__(self, controllers: Controllers, store: ParameterStore, fresh: bool = False) -> None:
        """Raises as `Controllers.build`, and DiagramError where uploads cannot be forgotten."""
        if fresh:
            controllers.forget()
        self.code, damage = controllers.build()
        self._store = store
        tuned = store.carry(self.code.user_parameters)
        if fresh:
            tuned = ()
            store.reset()
        self._values = store.flying() | store.user_values()
        self.code.set_parameters(self._values)
        self.remarks = [text for text in (damage, *store.remarks, *tuned, *self._hidden()) if text]
        self._named = (self.code, controller_identity(self.code))
        self._counted = (-1, 0)  # a revision of the store, and how many parameters differ from their defaults in it

    def attach(self, controller: FlightController) -> None:
        """Has each change of the store fly in `controller`, before its next tick."""
        self._controller = controller
        self._store.bus.subscribe(ParametersChanged, self._fly_changes)

    def fly_replaced(self) -> list[str]:
        """Another flight code flies by now: lists its users' parameters. Returns what clients must know of that."""
        self.code = self._controller.code
        remarks = self._store.carry(self.code.user_parameters)
        own = self._store.user_values()
        self._values = self._store.flying() | own
        self._controller.set_parameters(own)
        return [*remarks, *self._hidden()]

    @property
    def identity(self) -> ControllerIdentity:
        """Which controller flies, and how many parameters differ from their defaults."""
        code = self._controller.code
        if self._named[0] is not code:
            self._named = (code, controller_identity(code))
        if self._counted[0] != self._store.revision:  # a client may have TWODOF_RIG sent in every control period
            self._counted = (self._store.revision, len(self._store.changed()))
        return self._named[1]._replace(changed=self._counted[1])

    def _fly_changes(self, _: ParametersChanged) -> None:
        values: dict[str, Any] = self._store.flying() | self._store.user_values()
        changed = {name: value for name, value in values.items() if value != self._values[name]}
        self._values = values
        if changed:
            self._controller.set_parameters(changed)

    def _hidden(self) -> list[str]:
        """Which of the users' parameters are not shown."""
        return [one.remark for one in self.code.user_parameters if one.remark]
