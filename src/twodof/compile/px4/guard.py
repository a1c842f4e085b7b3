"""The C++ that says what is wrong, puts parameters back, and asks PX4 to disarm where the motors stand still."""

from __future__ import annotations

from twodof.compile.px4.names import ModuleNames
from twodof.compile.px4.topics import ModuleRole


def guard_text(names: ModuleNames, role: ModuleRole) -> str:
    """The functions that take parameters, judge the commands that were given, and tell the pilot."""
    torque = f"\n    _torque_scale = values[{names.module}_TORQUE].real;" if role.commands == "torque" else ""
    text = _TEXT.replace("TORQUE_SCALE", torque)
    return text.replace("CLASS", names.class_name).replace("MODULE", names.module)


_TEXT = """void CLASS::tell(uint8_t what, const char *text, const char *more)
{
    const hrt_abstime now = hrt_absolute_time();

    if (what == _told && now < _told_at + TELL_AGAIN) {
        return;
    }

    _told = what;
    _told_at = now;
    mavlink_log_critical(&mavlink_log, "MODULE: %s%s", text, more);
}

void CLASS::ask_to_disarm()
{
    // To this vehicle alone: mavlink would send a command without an address to all that are connected.
    uORB::Subscription subscription{ORB_ID(vehicle_status)};
    vehicle_status_s status{};
    subscription.copy(&status);

    vehicle_command_s command{};
    command.command = vehicle_command_s::VEHICLE_CMD_COMPONENT_ARM_DISARM;
    command.param1 = 0.f;
    command.param2 = 21196.f; // in flight too
    command.target_system = status.system_id;
    command.target_component = status.component_id;
    command.source_system = status.system_id;
    command.source_component = status.component_id;
    command.timestamp = hrt_absolute_time();
    uORB::Publication<vehicle_command_s> publication{ORB_ID(vehicle_command)};
    publication.publish(command);
    mavlink_log_critical(&mavlink_log, "MODULE: asks PX4 to disarm");
}

void CLASS::judge(hrt_abstime now)
{
    if (_active || !wanted(_armed, _mode)) {
        _doubt_since = 0;

    } else if (_doubt_since == 0) {
        _doubt_since = now;
        tell(_faults & (STALE | NOT_FINITE), "motors off: ", (_faults & NOT_FINITE) ? "command not finite"
             : _silent ? "gyro silent" : "no sound measurement");

    } else if (now >= _doubt_since + DISARM_AFTER) {
        _doubt_since = now;
        ask_to_disarm();
    }
}

bool CLASS::read_parameter(int32_t place, MODULE_Value *value)
{
    const param_t handle = param_find(MODULE_parameters[place].name);
    const int failed = MODULE_parameters[place].type == 'f' ? param_get(handle, &value->real)
                       : param_get(handle, &value->integer);
    return !failed && MODULE_within(place, *value);
}

void CLASS::take_parameters(bool starting)
{
    static MODULE_Value values[MODULE_PARAMETERS];  // one item at a time takes them; too many for the queue's stack
    bool put_back = false;

    for (int32_t i = 0; i < MODULE_PARAMETERS; i++) {
        if (read_parameter(i, &values[i])) {
            continue;
        }

        // The others are taken all the same, and the ground reads what flies.
        values[i] = _flying[i];
        _refused_parameter = i;
        _refused = true;

        if (param_set_no_notification(param_find(MODULE_parameters[i].name), &_flying[i]) == 0) {
            put_back = true;
            mavlink_log_critical(&mavlink_log, "%s was out of bounds and is put back", MODULE_parameters[i].name);

        } else {
            mavlink_log_critical(&mavlink_log, "%s is missing in PX4", MODULE_parameters[i].name);
        }
    }

    if (put_back) {
        param_notify_changes();
    }

    if (!starting && values[MODULE_LIVE].integer == 0) {
        _flying[MODULE_LIVE] = values[MODULE_LIVE];
        return; // changes wait until it is 1 again
    }

    MODULE_change(&_controller, values, starting);

    for (int32_t i = 0; i < MODULE_PARAMETERS; i++) {
        if (starting || !MODULE_parameters[i].fixed) {
            _flying[i] = values[i];
        }
    }

    _parameter_revision++;TORQUE_SCALE
}
"""
