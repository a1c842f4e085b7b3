#pragma once
int px4_usleep(unsigned int us);
