#pragma once
// Macros of PX4's headers that a user's names could meet.
#define OK 0
#define ERROR -1
#define __EXPORT __attribute__((visibility("default")))
