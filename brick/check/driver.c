/*
 * Answers the commands of brick/vectors by the C header: a line in, a line out. brick/rust/tests runs it.
 *
 *     gcc -std=c99 -I ../c driver.c -o driver && ./driver < commands
 */
#define PB_RECEIVE
#include "posebridge_brick.h"

#include <stdio.h>
#include <stdlib.h>

#define LONGEST_LINE 8192

static void print_byte(void *context, uint8_t byte)
{
    (void)context;
    printf("%02x", byte);
}

static char *word(void)
{
    char *found = strtok(NULL, " \n");
    if (!found) {
        fprintf(stderr, "a line is too short\n");
        exit(2);
    }
    return found;
}

static int64_t number(void)
{
    return strtoll(word(), NULL, 10);
}

static float number_of_bits(void)
{
    uint32_t bits = (uint32_t)strtoul(word(), NULL, 16);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint8_t hex_byte(const char *digits)
{
    char pair[3] = {digits[0], digits[1], 0};
    return (uint8_t)strtoul(pair, NULL, 16);
}

static void begin(pb_link *link)
{
    uint8_t sequence = (uint8_t)number(), system = (uint8_t)number(), component = (uint8_t)number();
    pb_begin(link, print_byte, NULL, system, component);
    link->header[PB_SEQUENCE] = sequence;
}

static void wheel_ticks(pb_link *link)
{
    pb_ticks ticks;
    ticks.time_us = (uint32_t)number();
    ticks.left = (int32_t)number();
    ticks.right = (int32_t)number();
    ticks.flags = (uint8_t)number();
    pb_send_ticks(link, &ticks);
}

static void inertial(pb_link *link)
{
    pb_inertial inertial;
    inertial.time_us = (uint32_t)number();
    inertial.turn_urad = (int32_t)number();
    inertial.turn_rate = (int16_t)number();
    inertial.accel_left = (int16_t)number();
    inertial.accel_right = (int16_t)number();
    inertial.valid = (uint8_t)number();
    pb_send_inertial(link, &inertial);
}

static void battery(pb_link *link)
{
    uint16_t millivolts = (uint16_t)number();
    pb_send_battery(link, millivolts, (int8_t)number());
}

static void description(pb_link *link)
{
    pb_description robot;
    const char *digits;
    size_t index;
    robot.left_wheel_radius_m = number_of_bits();
    robot.right_wheel_radius_m = number_of_bits();
    robot.track_width_m = number_of_bits();
    robot.ticks_per_turn = number_of_bits();
    robot.gyro_sigma_rad_per_s = number_of_bits();
    robot.gyro_resolution_rad_per_s = number_of_bits();
    digits = word();
    memset(robot.name, 0, sizeof robot.name);
    for (index = 0; digits[0] != '-' && index < strlen(digits) / 2 && index < sizeof robot.name; index++)
        robot.name[index] = (char)hex_byte(digits + 2 * index);
    pb_send_description(link, &robot);
}

static void gyro(pb_link *link)
{
    pb_gyro gyro;
    pb_inertial inertial;
    uint32_t now_us = (uint32_t)number();
    char *interval;
    memset(&gyro, 0, sizeof gyro);
    while ((interval = strtok(NULL, " \n")) != NULL) {
        now_us += (uint32_t)strtoul(interval, NULL, 10);
        pb_gyro_sample(&gyro, now_us, (int32_t)number());
    }
    if (pb_gyro_take(&gyro, &inertial))
        pb_send_inertial(link, &inertial);
}

static void print_float(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    printf(" %08lx", (unsigned long)bits);
}

static const char *separator;

static void print_pose(const pb_pose *pose)
{
    int index;
    printf("%spose %lu", separator, (unsigned long)pose->time_us);
    separator = " ";
    print_float(pose->x_m);
    print_float(pose->y_m);
    print_float(pose->heading_rad);
    print_float(pose->forward_speed_m_per_s);
    print_float(pose->turn_rate_rad_per_s);
    for (index = 0; index < 6; index++)
        print_float(pose->covariance[index]);
    printf(" %u %u %u %lu", pose->fix_age_ms, pose->reset_counter, pose->flags, (unsigned long)pose->epoch);
}

/* The first byte of an answer brings the word before it. */
static void print_answer(void *context, uint8_t byte)
{
    int *expected = context;
    if (*expected == 0)
        printf("%sanswer ", separator);
    separator = " ";
    *expected = 1;
    printf("%02x", byte);
}

static void receive(void)
{
    static pb_receiver receiver;
    static pb_pose pose;
    pb_link link;
    int has_begun = 0;
    uint32_t now_us = (uint32_t)number();
    uint8_t system = (uint8_t)number(), component = (uint8_t)number();
    const char *digits = word();
    memset(&receiver, 0, sizeof receiver);
    pb_begin(&link, print_answer, &has_begun, system, component);
    separator = "";
    for (; digits[0]; digits += 2, has_begun = 0)
        if (pb_receive(&link, &receiver, hex_byte(digits), now_us, &pose))
            print_pose(&pose);
    if (separator[0] == 0)
        printf("nothing");
}

int main(void)
{
    static char line[LONGEST_LINE];
    pb_link link;
    while (fgets(line, sizeof line, stdin)) {
        const char *command = strtok(line, " \n");
        if (!command)
            continue;
        if (strcmp(command, "milli") == 0) {
            printf("%ld\n", (long)pb_milli(number_of_bits()));
            continue;
        }
        if (strcmp(command, "receive") == 0) {
            receive();
        } else {
            begin(&link);
            if (strcmp(command, "heartbeat") == 0)
                pb_send_heartbeat(&link);
            else if (strcmp(command, "wheel_ticks") == 0)
                wheel_ticks(&link);
            else if (strcmp(command, "inertial") == 0)
                inertial(&link);
            else if (strcmp(command, "battery") == 0)
                battery(&link);
            else if (strcmp(command, "description") == 0)
                description(&link);
            else if (strcmp(command, "gyro") == 0)
                gyro(&link);
            else
                return 2;
        }
        printf("\n");
    }
    return 0;
}
