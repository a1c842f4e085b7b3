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
        if (_handle != nullptr) {
            stand_in::withdraw(_meta->o_name);
        }
    }
    bool advertised() const { return _handle != nullptr; }
    bool advertise()
    {
        if (!advertised()) {
            _handle = orb_advertise(_meta, nullptr);
        }

        return advertised();
    }
    bool publish(const T &value)
    {
        advertise();
        stand_in::publish(_meta->o_name, &value, sizeof value);
        return true;
    }
private:
    const orb_metadata *_meta;
    orb_advert_t _handle{nullptr};
};
} // namespace uORB
