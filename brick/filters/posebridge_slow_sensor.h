/*
 * Two filters for one slow sensor: the thermometer of paper 2 (Markovsky) and the range sensor of paper 3 (Lab 7). Plain C99, no heap,
 * every product written out.
 *
 *   pb_thermometer   [u, x]: the final value, and what is left of the transient          the filter `dynamic` of the station
 *   pb_wall          [z, v]: distance to a wall and speed towards it, with a gate        the filter `range-kf` of the station
 *
 * Each step returns 0 and changes nothing when a number is not finite or the interval is not positive; else 1.
 *
 * Sources: docs/lab/thermometer.md and docs/lab/wall.md of this project, sections M1 and M2.
 */
#ifndef POSEBRIDGE_SLOW_SENSOR_H
#define POSEBRIDGE_SLOW_SENSOR_H

#ifndef PB_REAL
#define PB_REAL double
#endif
#ifndef PB_REAL_NAMED
#define PB_REAL_NAMED
typedef PB_REAL pb_real;
#endif

/* ---- thermometer: y = u + x, x' = e^(-dt/tau) x, u constant ---------------------------------------------------------------- */

/*
 * The covariance is kept as P = U D U' with U = [1 b; 0 1] and D = diag(d_u, d_x) (Bierman 1977). The prior is 1e10 times the noise:
 * P itself loses all digits of single precision at the first sample, its factors lose none.
 */
typedef struct {
    pb_real tau_s, variance_k2; /* time constant; variance of a sample */
    pb_real u_c, x_k; /* final value, degrees Celsius; transient, K */
    pb_real d_u, d_x, b;
    int begun;
} pb_thermometer;

/* 0 where tau or sigma is no positive number. */
int pb_thermometer_init(pb_thermometer *filter, pb_real tau_s, pb_real sigma_k);
/* A sample, dt_s after the one before; of the first sample dt_s is not used. */
int pb_thermometer_step(pb_thermometer *filter, pb_real dt_s, pb_real shown_c);
/* Variance of the final value, K^2. */
pb_real pb_thermometer_variance(const pb_thermometer *filter);

/* ---- wall: dz/dt = -v, dv/dt = (u - d v) / m ----------------------------------------------------------------------------- */

typedef struct {
    pb_real drag_s_m, mass_s2_m; /* d and m; d = 1 / v_ss */
    pb_real range_m, process_m; /* sigma_z of a reading, sigma_u per step: 0.02 and 0.05 in the paper */
    pb_real gate_m; /* GATE_MIN */
} pb_wall_model;

typedef struct {
    pb_wall_model model;
    pb_real z_m, v_m_s;
    pb_real p[3]; /* distance, distance with speed, speed */
    pb_real input; /* u that acts until the next step; 1 at PWM 80 */
    int begun, gated; /* gated: the gate has refused the last reading */
} pb_wall;

void pb_wall_init(pb_wall *filter, const pb_wall_model *model);
/* One period of the control loop. dt_s is what has really elapsed, input acts from here on, range_m may be NULL. */
int pb_wall_step(pb_wall *filter, pb_real dt_s, pb_real input, const pb_real *range_m);

#endif
