#pragma once
#define PX4_ISFINITE(x) __builtin_isfinite(x)
