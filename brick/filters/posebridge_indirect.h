/*
 * The indirect filter of paper 4 for a brick: the wheels alone give a path, a Kalman filter follows only its error. Plain C99, no heap.
 *
 * Rows, as in docs/lab/indirect.md, section M2:
 *   all 15      e_x e_y e_th e_s | m dr tb | p_s c_v b_v | p_w c_w b_w | g b_g       the filters `indirect`, `indirect-feedback`
 *   small, 7    e_x e_y e_th     |      tb |             | p_w c_w b_w |             -DPB_INDIRECT_SMALL
 *
 * The small form leaves out what two accelerometers hardly see (radii, distance) and the gyro, which the paper does not have. P takes 112
 * bytes of single precision in place of 480.
 */
#ifndef POSEBRIDGE_INDIRECT_H
#define POSEBRIDGE_INDIRECT_H

#include "posebridge_filters.h"

#ifdef PB_INDIRECT_SMALL
#define PB_INDIRECT_ROWS 7
#else
#define PB_INDIRECT_ROWS 15
#endif

typedef struct {
    pb_noise noise; /* slip, gyro */
    pb_real accelerometer_m_s2; /* noise of a sample */
    pb_real radius_scale, radius_difference, track_scale; /* standard deviations of the geometry's relative errors */
    int feedback; /* 0: feed-forward, as the paper's equations are; 1: the errors move into the path */
} pb_indirect_settings;

/* An integral beside the path. */
typedef struct {
    int tracked; /* whether its rows are followed */
    int heard; /* whether there was a sample within the last 0.3 s */
    pb_real since_s; /* since its last sample */
    pb_real squared_s2; /* squared sampling intervals since the last step of the path */
} pb_integral;

typedef struct {
    pb_indirect_settings settings;
    pb_real e[PB_INDIRECT_ROWS];
    pb_real p[PB_INDIRECT_ROWS * (PB_INDIRECT_ROWS + 1) / 2]; /* lower triangle of P, row by row */
    pb_real x_m, y_m, angle_rad, distance_m, settled_rad; /* the path; its angle without the jitter of the counts */
    pb_real scales[3]; /* errors of the geometry that feedback has moved into the path */
    pb_integral accelerometers, gyro;
    pb_real felt_m, felt_m_s, felt_rad, felt_rad_s; /* by accelerometers */
    pb_real gyro_rad;
    pb_state state; /* path and errors: the estimate */
} pb_indirect;

void pb_indirect_init(pb_indirect *filter, const pb_robot *robot, const pb_indirect_settings *settings, const pb_state *start, const pb_real sigma[2]);
/* The first reading: base of the counters, beginning of the integrals. */
int pb_indirect_begin(pb_indirect *filter, const pb_robot *robot, const pb_reading *first);
int pb_indirect_step(pb_indirect *filter, const pb_robot *robot, const pb_reading *reading);

#endif
