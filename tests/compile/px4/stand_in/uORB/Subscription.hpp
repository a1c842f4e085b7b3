#pragma once
#include <stand_in.hpp>
#include <uORB/uORB.h>
#include <string.h>
namespace uORB
{
class Subscription
{
public:
    explicit Subscription(const orb_metadata *meta) : _meta(meta) {}
    bool advertised() const { return stand_in::topics[_meta->o_name].advertised; }
    bool updated() const { return advertised() && stand_in::topics[_meta->o_name].generation != _seen; }
    bool update(void *to) { return updated() && copy(to); }
    bool copy(void *to)
    {
        stand_in::Topic &topic = stand_in::topics[_meta->o_name];

        if (!topic.advertised || topic.generation == 0) {
            return false;
        }

        memcpy(to, topic.value.data(), topic.value.size());
        _seen = topic.generation;
        return true;
    }
protected:
    const orb_metadata *_meta;
    uint32_t _seen{0};
};
} // namespace uORB
