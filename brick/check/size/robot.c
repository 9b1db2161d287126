/*
 * Everything that the header offers to a robot, for its size on an ATmega328P. brick/check.sh compiles it twice: as it is, which only
 * transmits, and with -DPB_RECEIVE.
 *
 * Sensors and serial port are volatile bytes, so that nothing is computed away and no driver is counted.
 */
#include "posebridge_brick.h"

#include <avr/pgmspace.h>

extern volatile uint8_t uart;
extern volatile int32_t sensors[4];

/* An AVR copies constants to RAM unless it is told not to. */
static const pb_description built PROGMEM = {0.0325f, 0.0325f, 0.15f, 1440.0f, 0.005f, 0.0f, "size"};
static pb_link robot;
#ifdef WITH_GYRO_SUM
static pb_gyro gyro;
#endif
#ifdef PB_RECEIVE
static pb_receiver receiver;
static pb_pose pose;
#endif

static void out(void *context, uint8_t byte)
{
    (void)context;
    uart = byte;
}

int main(void)
{
    pb_description description;
    pb_inertial inertial;
    pb_begin(&robot, out, 0, 1, 1);
    for (;;) {
        pb_ticks ticks = {(uint32_t)sensors[0], sensors[1], sensors[2], PB_BOTH};
#ifdef WITH_GYRO_SUM
        pb_gyro_sample(&gyro, ticks.time_us, sensors[3]);
        if (pb_gyro_take(&gyro, &inertial))
            pb_send_inertial(&robot, &inertial);
#else
        inertial.time_us = ticks.time_us;
        inertial.turn_rate = (int16_t)sensors[3];
        inertial.valid = PB_RATE_VALID;
        pb_send_inertial(&robot, &inertial);
#endif
        pb_send_ticks(&robot, &ticks);
        pb_send_heartbeat(&robot);
        memcpy_P(&description, &built, sizeof description);
        pb_send_description(&robot, &description);
#ifdef PB_RECEIVE
        if (pb_receive(&robot, &receiver, uart, ticks.time_us, &pose))
            sensors[0] = pose.reset_counter;
#endif
    }
}
