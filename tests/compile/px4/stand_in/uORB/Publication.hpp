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
    ~Publication()
    {
        if (_advertised) {
            stand_in::withdraw(_meta->o_name);
        }
    }
    bool publish(const T &value)
    {
        _advertised = true;
        stand_in::publish(_meta->o_name, &value, sizeof value);
        return true;
    }
private:
    const orb_metadata *_meta;
    bool _advertised{false};
};
} // namespace uORB
