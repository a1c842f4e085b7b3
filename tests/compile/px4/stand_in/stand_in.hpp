// What stands behind the stand-ins of PX4's headers: a clock, topics, parameters and one work queue, all in this process.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <vector>

namespace px4
{
class WorkItem;
}

namespace stand_in
{
struct Topic {
    std::vector<uint8_t> value;
    uint32_t generation{0};
    bool advertised{false};  // one flag for all who publish it, as in uORBDeviceNode
    std::vector<px4::WorkItem *> listeners;
};

struct Parameter {
    bool integer;
    float real;
    int32_t whole;
    bool used;
};

extern uint64_t now;
extern bool lockable;  // whether a gyro's topic can be listened to
extern bool obedient;  // whether each vehicle_command disarms
extern std::map<std::string, Topic> topics;
extern std::map<std::string, Parameter> parameters;
extern std::vector<std::string> parameter_order;
extern std::vector<px4::WorkItem *> ready;
extern std::map<px4::WorkItem *, uint64_t> delayed;
extern std::vector<std::string> said;

void publish(const char *topic, const void *value, size_t size);
// A publication of a topic ends, which clears the flag of all: who has not read the last value by then never does.
void withdraw(const char *topic);
// Runs what is ready, and what was delayed until now.
void work();
} // namespace stand_in
