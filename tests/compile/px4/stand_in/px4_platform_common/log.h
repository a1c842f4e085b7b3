#pragma once
void px4_say(const char *level, const char *format, ...) __attribute__((format(printf, 2, 3)));
#define PX4_INFO(...) px4_say("info", __VA_ARGS__)
#define PX4_WARN(...) px4_say("warning", __VA_ARGS__)
#define PX4_ERR(...) px4_say("error", __VA_ARGS__)
