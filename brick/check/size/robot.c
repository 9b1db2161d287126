/*
 * Everything that the header offers to a robot, for its size on an ATmega328P. brick/check.sh compiles it twice: as it is, which only
 * transmits, and with -DPB_RECEIVE.
 *
 * Sensors and serial port are volatile bytes, so that nothing is computed away and no driver is counted.
 */
#include "posebridge_brick.h"

extern volatile uint8_t uart;
extern volatile int32_t sensors[4];

static pb_link robot;
static pb_gyro gyro;
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
    pb_description description = {0.0325f, 0.0325f, 0.15f, 1440.0f, 0.005f, 0.0f, "size"};
    pb_inertial inertial;
    pb_begin(&robot, out, 0, 1, 1);
    for (;;) {
        pb_ticks ticks = {(uint32_t)sensors[0], sensors[1], sensors[2], PB_BOTH};
        pb_gyro_sample(&gyro, ticks.time_us, sensors[3]);
        pb_send_ticks(&robot, &ticks);
        if (pb_gyro_take(&gyro, &inertial))
            pb_send_inertial(&robot, &inertial);
        pb_send_heartbeat(&robot);
        pb_send_description(&robot, &description);
#ifdef PB_RECEIVE
        if (pb_receive(&robot, &receiver, uart, ticks.time_us, &pose))
            sensors[0] = pb_milli(pose.x_m);
#endif
    }
}
