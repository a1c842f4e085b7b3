#pragma once
struct orb_metadata {
    const char *o_name;
};
#define ORB_ID(name) &orb_##name
