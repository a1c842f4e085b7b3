#pragma once
#include <stdint.h>
typedef uint16_t param_t;
#define PARAM_INVALID ((uint16_t)0xffff)
param_t param_find(const char *name);
int param_get(param_t param, void *value);
