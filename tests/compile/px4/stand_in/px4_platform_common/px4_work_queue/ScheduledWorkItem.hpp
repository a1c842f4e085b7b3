#pragma once
#include <stdint.h>
namespace px4
{
struct wq_config_t {
    const char *name;
};
namespace wq_configurations
{
static constexpr wq_config_t rate_ctrl{"wq:rate_ctrl"};
}
class WorkItem
{
public:
    WorkItem() = default;
    virtual ~WorkItem();
    void ScheduleNow();
    virtual void Run() = 0;
};
class ScheduledWorkItem : public WorkItem
{
public:
    void ScheduleDelayed(uint32_t delay_us);
    void ScheduleClear();
protected:
    ScheduledWorkItem(const char *name, const wq_config_t &config) { (void)name; (void)config; }
    virtual ~ScheduledWorkItem() override = default;
};
} // namespace px4
