#pragma once
#include <stdint.h>
typedef uint16_t param_t;
#define PARAM_INVALID ((uint16_t)0xffff)
param_t param_find(const char *name);
// Of PX4's types only these two hold what a parameter is; another pointer does not compile, as in PX4.
int param_get(param_t param, float *value);
int param_get(param_t param, int32_t *value);
int param_set_no_notification(param_t param, const void *value);
// Publishes parameter_update.
void param_notify_changes();
