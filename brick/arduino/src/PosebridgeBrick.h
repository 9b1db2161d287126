// Arduino's name for the brick SDK. pack.py lays posebridge_brick.h beside this file; there is one such header, in brick/c.
#ifndef POSEBRIDGE_BRICK_ARDUINO_H
#define POSEBRIDGE_BRICK_ARDUINO_H

#include <Arduino.h>

#define PB_RECEIVE
#include "posebridge_brick.h"

// A sink for any Arduino stream: pb_begin(&robot, pb_print, &Serial, 1, 1).
static inline void pb_print(void *stream, uint8_t byte)
{
    static_cast<Print *>(stream)->write(byte);
}

#endif
