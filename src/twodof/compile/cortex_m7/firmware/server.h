/* Between start-up, server and the host: frames of a kind and a number of bytes, little-endian words. */
#include <stdint.h>

enum { FRAME_DATA = 1, FRAME_END = 2, FRAME_REFUSED = 3, FRAME_FAULT = 4 };
enum { STOP_DONE = 0x20026, STOP_FAULT = 0x20023 }; /* semihosting's reasons to exit: the application did; a run-time error */

void serve(void) __attribute__((noreturn));
void send(uint32_t kind, const void *data, uint32_t bytes);
void stop(uint32_t reason) __attribute__((noreturn));
