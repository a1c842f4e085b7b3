#include "stand_in.hpp"

#include <drivers/drv_hrt.h>
#include <lib/parameters/param.h>
#include <px4_platform_common/log.h>
#include <px4_platform_common/px4_work_queue/ScheduledWorkItem.hpp>
#include <px4_platform_common/time.h>
#include <uORB/uORB.h>

#include <cstdarg>
#include <cstdio>
#include <cstring>

namespace stand_in
{
uint64_t now = 1000000;
bool lockable = true;
bool obedient = false;
std::map<std::string, Topic> topics;
std::map<std::string, Parameter> parameters;
std::vector<std::string> parameter_order;
std::vector<px4::WorkItem *> ready;
std::map<px4::WorkItem *, uint64_t> delayed;
std::vector<std::string> said;

static void disarm()
{
    Topic &t = topics["actuator_armed"];
    t.value.assign(t.value.size(), 0);
    t.generation++;
}

void publish(const char *topic, const void *value, size_t size)
{
    Topic &t = topics[topic];
    // Without the flag no subscriber finds anything.
    printf("%s%s ", t.advertised ? "" : "lost ", topic);

    for (size_t i = 0; i < size; i++) {
        printf("%02x", static_cast<unsigned>(static_cast<const uint8_t *>(value)[i]));
    }

    printf("\n");
    fflush(stdout);
    const uint8_t *bytes = static_cast<const uint8_t *>(value);
    t.value.assign(bytes, bytes + size);
    t.generation++;

    for (px4::WorkItem *item : t.listeners) {
        ready.push_back(item);
    }

    if (obedient && std::string("vehicle_command") == topic) {
        disarm();
    }
}

void withdraw(const char *topic)
{
    topics[topic].advertised = false;
    printf("withdrawn %s %llu\n", topic, static_cast<unsigned long long>(now));
    fflush(stdout);
}

void work()
{
    std::vector<px4::WorkItem *> late;

    for (const auto &entry : delayed) {
        if (entry.second <= now) {
            late.push_back(entry.first);
        }
    }

    for (px4::WorkItem *item : late) {
        delayed.erase(item);
        ready.push_back(item);
    }

    while (!ready.empty()) {
        px4::WorkItem *const item = ready.front();
        ready.erase(ready.begin());
        item->Run();
    }
}
} // namespace stand_in

hrt_abstime hrt_absolute_time()
{
    return stand_in::now;
}

int px4_usleep(unsigned int us)
{
    stand_in::now += us;
    stand_in::work(); // another thread would
    return 0;
}

param_t param_find(const char *name)
{
    for (size_t i = 0; i < stand_in::parameter_order.size(); i++) {
        if (stand_in::parameter_order[i] == name) {
            stand_in::parameters[name].used = true;
            return static_cast<param_t>(i);
        }
    }

    return PARAM_INVALID;
}

static const stand_in::Parameter *parameter(param_t param, bool integer)
{
    if (param >= stand_in::parameter_order.size()) {
        return nullptr;
    }

    const stand_in::Parameter &p = stand_in::parameters[stand_in::parameter_order[param]];
    return p.integer == integer ? &p : nullptr;
}

int param_set_no_notification(param_t param, const void *value)
{
    if (param >= stand_in::parameter_order.size()) {
        return -1;
    }

    stand_in::Parameter &p = stand_in::parameters[stand_in::parameter_order[param]];
    p.integer ? memcpy(&p.whole, value, sizeof p.whole) : memcpy(&p.real, value, sizeof p.real);
    return 0;
}

void param_notify_changes()
{
    stand_in::topics["parameter_update"].advertised = true;
    stand_in::publish("parameter_update", &stand_in::now, sizeof stand_in::now);
}

orb_advert_t orb_advertise(const orb_metadata *meta, const void *)
{
    stand_in::topics[meta->o_name].advertised = true;
    return &stand_in::topics[meta->o_name];
}

int orb_exists(const orb_metadata *meta, int)
{
    return stand_in::topics[meta->o_name].advertised ? 0 : -1;
}

int param_get(param_t param, float *value)
{
    const stand_in::Parameter *const p = parameter(param, false);

    if (p != nullptr) {
        *value = p->real;
    }

    return p != nullptr ? 0 : -1;
}

int param_get(param_t param, int32_t *value)
{
    const stand_in::Parameter *const p = parameter(param, true);

    if (p != nullptr) {
        *value = p->whole;
    }

    return p != nullptr ? 0 : -1;
}

void px4_say(const char *level, const char *format, ...)
{
    char text[200];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    stand_in::said.push_back(std::string(level) + " " + text);
}

namespace px4
{
WorkItem::~WorkItem()
{
    stand_in::delayed.erase(this);
}

void WorkItem::ScheduleNow()
{
    stand_in::ready.push_back(this);
}

void ScheduledWorkItem::ScheduleDelayed(uint32_t delay_us)
{
    stand_in::delayed[this] = stand_in::now + delay_us;
}

void ScheduledWorkItem::ScheduleClear()
{
    stand_in::delayed.erase(this);
}
} // namespace px4
