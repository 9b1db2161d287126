/*
 * One filter, one step at a time: check_in are the numbers of a row, check_out what the filter makes of them.
 *
 * -DFILTER=1 .. 8 chooses the filter, see the names below; without it there is none, which is what sizes are measured against. On a PC the
 * program reads rows from standard input. On a brick it waits in check_ready: the simulator fills check_in and looks at check_out.
 */
#include <math.h>

#include "posebridge_filters.h"
#include "posebridge_indirect.h"
#include "posebridge_slow_sensor.h"

#define WHEEL 1
#define SPEED 2
#define EKF5 3
#define EKF9 4
#define INDIRECT 5
#define INDIRECT_FEEDBACK 6
#define THERMOMETER 7
#define WALL 8

#ifndef FILTER
#define FILTER 0
#endif

volatile pb_real check_in[7];
volatile pb_real check_out[5];

#if FILTER == WHEEL
static pb_wheel_kf filter;
#elif FILTER == SPEED
static pb_speed_kf filter;
#elif FILTER == EKF5
static pb_ekf5 filter;
#elif FILTER == EKF9
static pb_ekf9 filter;
#elif FILTER == INDIRECT || FILTER == INDIRECT_FEEDBACK
static pb_indirect filter;
#elif FILTER == THERMOMETER
static pb_thermometer filter;
#elif FILTER == WALL
static pb_wall filter;
#endif

static int begun;

#if FILTER >= WHEEL && FILTER <= INDIRECT_FEEDBACK
static const pb_robot robot = {(pb_real)0.0281, (pb_real)0.0279, (pb_real)0.1115, (pb_real)0.01745329252};

/* Slip, gyro, bias, walks of the speeds. */
#define NOISE {(pb_real)0.0008, (pb_real)0.001, (pb_real)0.004, (pb_real)0.003, (pb_real)0.01047, (pb_real)0.01745, (pb_real)0.002, (pb_real)0.003, (pb_real)0.0001745, 1, 6}

static int init(const pb_reading *first)
{
    static const pb_state start = {(pb_real)0.2, (pb_real)-0.1, (pb_real)0.3, 0, 0};
    static const pb_real sigma[2] = {(pb_real)0.01, (pb_real)0.02};
#if FILTER == WHEEL
    (void)sigma;
    (void)first;
    pb_wheel_kf_init(&filter, &pb_wheel_printed, &start);
    return 1;
#elif FILTER == SPEED
    pb_speed_matrices matrices = pb_speed_corrected(&robot, (pb_real)0.05);
    (void)sigma;
    pb_speed_kf_init(&filter, &matrices, &start);
    return pb_speed_kf_begin(&filter, &robot, first);
#elif FILTER == EKF5
    pb_ekf5_matrices matrices = pb_ekf5_printed();
    pb_ekf5_init(&filter, &matrices, &start, sigma);
    filter.gyro_bias_rad_s = (pb_real)0.002;
    return pb_ekf5_begin(&filter, &robot, first);
#elif FILTER == EKF9
    static const pb_noise noise = NOISE;
    pb_ekf9_init(&filter, &robot, &noise, &start, sigma);
    return pb_ekf9_begin(&filter, &robot, first);
#else
    static const pb_indirect_settings settings = {NOISE, (pb_real)0.05, (pb_real)0.005, (pb_real)0.002, (pb_real)0.03, FILTER == INDIRECT_FEEDBACK};
    pb_indirect_init(&filter, &robot, &settings, &start, sigma);
    return pb_indirect_begin(&filter, &robot, first);
#endif
}

static int step(void)
{
    pb_reading r = {check_in[0], check_in[1], check_in[2], check_in[3], check_in[4], check_in[5], 0};
    r.present = (unsigned)check_in[6];
    if (!begun) return init(&r);
#if FILTER == WHEEL
    return pb_wheel_kf_step(&filter, &robot, &r);
#elif FILTER == SPEED
    return pb_speed_kf_step(&filter, &robot, &r);
#elif FILTER == EKF5
    return pb_ekf5_step(&filter, &robot, &r);
#elif FILTER == EKF9
    return pb_ekf9_step(&filter, &robot, &r);
#else
    return pb_indirect_step(&filter, &robot, &r);
#endif
}

static void publish(void)
{
    check_out[0] = filter.state.x_m;
    check_out[1] = filter.state.y_m;
    check_out[2] = filter.state.heading_rad;
    check_out[3] = filter.state.forward_m_s;
    check_out[4] = filter.state.turn_rad_s;
}
#elif FILTER == THERMOMETER
static int step(void)
{
    if (!begun && !pb_thermometer_init(&filter, 20, (pb_real)0.03)) return 0;
    return pb_thermometer_step(&filter, check_in[0], check_in[1]);
}

static void publish(void)
{
    check_out[0] = filter.u_c;
    check_out[1] = filter.x_k;
    check_out[2] = pb_thermometer_variance(&filter);
}
#elif FILTER == WALL
static int step(void)
{
    static const pb_wall_model model = {(pb_real)0.81633, (pb_real)0.35346, (pb_real)0.02, (pb_real)0.05, (pb_real)0.1};
    pb_real range = check_in[3];
    if (!begun) pb_wall_init(&filter, &model);
    return pb_wall_step(&filter, check_in[0], check_in[1], check_in[2] > 0 ? &range : 0);
}

static void publish(void)
{
    check_out[0] = filter.z_m;
    check_out[1] = filter.v_m_s;
    check_out[2] = filter.p[0];
    check_out[3] = filter.gated;
}
#else
static int step(void) { return 1; }
static void publish(void) {}
#endif

#ifdef ON_BRICK
/* Places that the simulator waits for. They differ, so that no linker makes one of them. */
volatile unsigned char check_place;
__attribute__((noinline)) void check_ready(void) { check_place = 1; }
__attribute__((noinline)) void check_before(void) { check_place = 2; }
__attribute__((noinline)) void check_after(void) { check_place = 3; }

int main(void)
{
    for (;;) {
        int used;
        check_ready();
        check_before();
        used = step();
        check_after();
        begun = 1;
        if (used) publish();
    }
}
#else
#include <stdio.h>

int main(void)
{
    double in[7];
    while (scanf("%lf %lf %lf %lf %lf %lf %lf", &in[0], &in[1], &in[2], &in[3], &in[4], &in[5], &in[6]) == 7) {
        int i, used;
        for (i = 0; i < 7; i++) check_in[i] = (pb_real)in[i];
        used = step();
        begun = 1;
        if (!used) return 2;
        publish();
        for (i = 0; i < 5; i++) printf("%.17g%c", (double)check_out[i], i < 4 ? ' ' : '\n');
    }
    return 0;
}
#endif
