#pragma once
#include <px4_platform_common/log.h>
#include <uORB/uORB.h>
// What the ground reads.
#define mavlink_log_critical(_pub, _text, ...) \
    do { \
        (void)(_pub); \
        px4_say("critical", _text, ##__VA_ARGS__); \
    } while(0);
