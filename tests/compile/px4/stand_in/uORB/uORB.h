#pragma once
struct orb_metadata {
    const char *o_name;
};
typedef void *orb_advert_t;
#define ORB_ID(name) &orb_##name
// Sets the one flag that all publishers of a topic share.
orb_advert_t orb_advertise(const orb_metadata *meta, const void *data);
// 0 if the flag is set.
int orb_exists(const orb_metadata *meta, int instance);
