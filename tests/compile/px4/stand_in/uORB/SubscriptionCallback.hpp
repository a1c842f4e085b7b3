#pragma once
#include <px4_platform_common/px4_work_queue/ScheduledWorkItem.hpp>
#include <uORB/Subscription.hpp>
#include <algorithm>
namespace uORB
{
class SubscriptionCallbackWorkItem : public Subscription
{
public:
    SubscriptionCallbackWorkItem(px4::WorkItem *item, const orb_metadata *meta) : Subscription(meta), _item(item) {}
    ~SubscriptionCallbackWorkItem() { unregisterCallback(); }
    bool registerCallback()
    {
        if (stand_in::lockable) {
            stand_in::topics[_meta->o_name].listeners.push_back(_item);
        }

        return stand_in::lockable;
    }
    void unregisterCallback()
    {
        auto &all = stand_in::topics[_meta->o_name].listeners;
        all.erase(std::remove(all.begin(), all.end(), _item), all.end());
    }
private:
    px4::WorkItem *_item;
};
} // namespace uORB
