/*
 * A robot's program around the C header, with its board replaced by lines: tests/bricks/sdk.rs drives it against the station.
 *
 * In:  now_us left right rate_urad_per_s bytes      what the board shows, and what came over the link, hexadecimal, or -
 * Out: bytes x_mm y_mm heading_mrad flags           what the program sends, or -, and the estimate that it has
 *
 *     gcc -std=c99 -I ../c robot.c -o robot
 */
#define PB_RECEIVE
#include "posebridge_brick.h"

#include <stdio.h>
#include <stdlib.h>

#define LONGEST_LINE 65536
#define STEPS_PER_HEARTBEAT 50
#define STEPS_PER_DESCRIPTION 250

static pb_link robot;
static pb_receiver receiver;
static pb_gyro gyro;
static pb_pose pose;
static int sent;

static void out(void *context, uint8_t byte)
{
    (void)context;
    sent = 1;
    printf("%02x", byte);
}

static void receive(const char *digits, uint32_t now_us)
{
    for (; digits[0] && digits[0] != '-'; digits += 2) {
        char pair[3] = {digits[0], digits[1], 0};
        pb_receive(&robot, &receiver, (uint8_t)strtoul(pair, NULL, 16), now_us, &pose);
    }
}

static void step(long count, const pb_ticks *ticks, int32_t rate_urad_per_s)
{
    static const pb_description built = {0.0325f, 0.0325f, 0.15f, 1440.0f, 0.0009f, 0.0f, "robot in C"};
    pb_inertial inertial;
    pb_gyro_sample(&gyro, ticks->time_us, rate_urad_per_s);
    if (count % STEPS_PER_DESCRIPTION == 0)
        pb_send_description(&robot, &built);
    if (count % STEPS_PER_HEARTBEAT == 0)
        pb_send_heartbeat(&robot);
    pb_send_ticks(&robot, ticks);
    if (pb_gyro_take(&gyro, &inertial))
        pb_send_inertial(&robot, &inertial);
}

int main(void)
{
    static char line[LONGEST_LINE];
    long count;
    pb_begin(&robot, out, NULL, 1, 1);
    for (count = 0; fgets(line, sizeof line, stdin); count++) {
        pb_ticks ticks;
        int32_t rate_urad_per_s;
        char *next = line;
        ticks.time_us = (uint32_t)strtoul(next, &next, 10);
        ticks.left = (int32_t)strtol(next, &next, 10);
        ticks.right = (int32_t)strtol(next, &next, 10);
        ticks.flags = PB_BOTH;
        rate_urad_per_s = (int32_t)strtol(next, &next, 10);
        sent = 0;
        receive(strtok(next, " \n"), ticks.time_us);
        step(count, &ticks, rate_urad_per_s);
        printf("%s %ld %ld %ld %u\n", sent ? "" : "-", (long)pb_milli(pose.x_m), (long)pb_milli(pose.y_m),
            (long)pb_milli(pose.heading_rad), pose.flags);
        fflush(stdout);
    }
    return 0;
}
