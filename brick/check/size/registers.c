/* The bytes that robot.c calls sensors and serial port; their size is not that of the header and is left out of the sum. */
#include <stdint.h>

volatile uint8_t uart;
volatile int32_t sensors[4];
