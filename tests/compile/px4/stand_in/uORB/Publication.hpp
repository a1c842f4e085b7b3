#pragma once
#include <stand_in.hpp>
#include <uORB/uORB.h>
namespace uORB
{
template<typename T>
class Publication
{
public:
    explicit Publication(const orb_metadata *meta) : _meta(meta) {}
    bool publish(const T &value)
    {
        stand_in::publish(_meta->o_name, &value, sizeof value);
        return true;
    }
private:
    const orb_metadata *_meta;
};
} // namespace uORB
