"""The C++ of a module's command: start, stop, status, replay."""

from __future__ import annotations

from twodof.compile.px4.names import ModuleNames
from twodof.compile.px4.topics import ModuleRole


def entry_text(names: ModuleNames, role: ModuleRole) -> str:
    """The functions behind the command, and its entry."""
    signs = sorted(role.signs.items())
    rivals = "\n".join(f'        {{ORB_ID({topic}), "{who} publishes {topic}"}},' for topic, who in signs)
    text = _REPLAY + _COMMAND.replace("RIVALS", rivals)
    return text.replace("CLASS", names.class_name).replace("MODULE", names.module)


_REPLAY = """int CLASS::replay(const char *input, const char *output)
{
    struct Sequence {
        MODULE_Controller controller;
        MODULE_Value values[MODULE_PARAMETERS];
        MODULE_Inputs in;
        MODULE_Outputs out;
        uint32_t in_words[MODULE_INPUT_WORDS + 1];
        uint32_t out_words[MODULE_OUTPUT_WORDS + 1];
    };

    FILE *const from = fopen(input, "rb");
    FILE *const to = from == nullptr ? nullptr : fopen(output, "wb");
    Sequence *const s = to == nullptr ? nullptr : new Sequence{};
    unsigned long rows = 0;
    bool written = true;

    if (s != nullptr) {
        MODULE_begin(&s->controller);

        for (int32_t i = 0; i < MODULE_PARAMETERS; i++) {
            if (!read_parameter(i, &s->values[i])) {
                s->values[i] = MODULE_parameters[i].standard;
                PX4_WARN("%s is out of bounds or missing: its default is used", MODULE_parameters[i].name);
            }
        }

        MODULE_change(&s->controller, s->values, true);
        MODULE_reset(&s->controller);

        while (written && fread(s->in_words, sizeof(uint32_t), MODULE_INPUT_WORDS, from) == MODULE_INPUT_WORDS) {
            MODULE_unpack(s->in_words, &s->in);
            MODULE_tick(&s->controller, &s->in, &s->out);
            MODULE_pack(&s->out, s->out_words);
            written = fwrite(s->out_words, sizeof(uint32_t), MODULE_OUTPUT_WORDS, to) == MODULE_OUTPUT_WORDS;
            rows++;
        }
    }

    const bool begun = s != nullptr;
    delete s;

    if (to != nullptr) {
        written = fclose(to) == 0 && written;
    }

    if (from != nullptr) {
        fclose(from);
    }

    if (!begun || !written) {
        PX4_ERR("cannot %s %s", from == nullptr ? "read" : "write", from == nullptr ? input : output);
        return -1;
    }

    PX4_INFO("%lu rows replayed", rows);
    return 0;
}

"""

_COMMAND = """static actuator_armed_s arming()
{
    uORB::Subscription subscription{ORB_ID(actuator_armed)};
    actuator_armed_s state{};
    subscription.copy(&state);
    return state;
}

/** Whether PX4 is disarmed: what a script asks before it stops the module whose place this one takes. */
static int disarmed()
{
    if (arming().armed) {
        mavlink_log_critical(&mavlink_log, "MODULE: not started while armed");
        return -1;
    }

    return 0;
}

/** Who else commands, or nullptr. */
static const char *rival()
{
    static const struct {
        const orb_metadata *topic;
        const char *who;
    } rivals[] = {
RIVALS
    };

    for (const auto &r : rivals) {
        if (orb_exists(r.topic, 0) == 0) {
            return r.who;
        }
    }

    return nullptr;
}

static int start_item()
{
    int result = 0;
    pthread_mutex_lock(&instance_lock);
    const char *const another = rival();

    if (CLASS::instance.load() != nullptr) {
        PX4_ERR("already running");
        result = -1;

    } else if (disarmed() != 0) {
        uORB::Subscription subscription{ORB_ID(vehicle_control_mode)};
        vehicle_control_mode_s mode{};
        subscription.copy(&mode);

        if (another == nullptr && CLASS::wanted(arming(), mode)) {
            CLASS::ask_to_disarm(); // nobody commands, and the motors keep what was commanded last
        }

        result = -1;

    } else if (another != nullptr) {
        PX4_ERR("not started: %s; stop it first", another);
        result = -1;

    } else {
        CLASS *const item = new CLASS();

        if (item == nullptr) {
            PX4_ERR("no memory");
            result = -1;

        } else if (!item->start()) {
            PX4_ERR("the gyro's topic cannot be listened to");
            delete item;
            result = -1;

        } else {
            CLASS::instance.store(item);
        }
    }

    pthread_mutex_unlock(&instance_lock);
    return result;
}

static int stop_item(bool forced)
{
    if (arming().armed && !forced) {
        PX4_ERR("not stopped while armed: disarm first, or `MODULE stop -f`, which disarms");
        return -1;
    }

    pthread_mutex_lock(&instance_lock);
    CLASS *const item = CLASS::instance.load();

    if (item != nullptr) {
        item->request_stop();
    }

    pthread_mutex_unlock(&instance_lock);

    for (int i = 0; i < 500 && CLASS::instance.load() != nullptr; i++) {
        px4_usleep(10000);
    }

    if (CLASS::instance.load() != nullptr) {
        PX4_ERR("it does not stop");
        return -1;
    }

    return 0;
}

static int print_status()
{
    pthread_mutex_lock(&instance_lock);
    const CLASS *const item = CLASS::instance.load();

    if (item != nullptr) {
        item->print_status();

    } else {
        PX4_INFO("not running");
    }

    pthread_mutex_unlock(&instance_lock);
    return item != nullptr ? 0 : -1;
}

extern "C" __EXPORT int MODULE_main(int argc, char *argv[])
{
    const char *const what = argc > 1 ? argv[1] : "";

    if (strcmp(what, "start") == 0) {
        return start_item();

    } else if (strcmp(what, "stop") == 0) {
        return stop_item(argc > 2 && strcmp(argv[2], "-f") == 0);

    } else if (strcmp(what, "disarmed") == 0) {
        return disarmed();

    } else if (strcmp(what, "status") == 0) {
        return print_status();

    } else if (strcmp(what, "replay") == 0 && argc == 4) {
        return CLASS::replay(argv[2], argv[3]);
    }

    PX4_INFO("usage: MODULE start | stop [-f] | disarmed | status | replay INPUT OUTPUT");
    return -1;
}
"""
