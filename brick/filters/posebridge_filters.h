/*
 * The filters of paper 1 (Valera et al.) for a brick: plain C99, no heap, no matrix library, every product written out.
 *
 * What is what:
 *   pb_wheel_kf     one Kalman filter per wheel, then odometry              equations 13 to 19
 *   pb_speed_kf     a filter for v and w driven by the accelerations        equations 13, 14, 20 to 23
 *   pb_ekf5         x, y, heading, v, w with two integrated headings        equations 24 to 26
 *   pb_ekf9         the last one with the errors of its integrals as states: what is wrong in it, put right
 *
 * Units are SI and radians; the wheels' filter works in degrees, as in print. Left is counter-clockwise. Headings count on over full turns.
 * A step takes what the sensors say since the step before. The first reading of all is the base: there the begin function takes what is
 * felt, and the step functions go on from there. Each returns 0 and changes nothing when a number is not finite, when the
 * interval is not between 0 and PB_LONGEST_STEP_S, or when the result would not be finite; else 1.
 *
 * Compile with -DPB_REAL=float for a brick without double precision.
 *
 * Sources: docs/lab/square.md of this project, sections M1 to M5.
 */
#ifndef POSEBRIDGE_FILTERS_H
#define POSEBRIDGE_FILTERS_H

#ifndef PB_REAL
#define PB_REAL double
#endif
#ifndef PB_REAL_NAMED
#define PB_REAL_NAMED
typedef PB_REAL pb_real;
#endif

/* The paper's interval, s: every Q is that of one such interval and grows with the interval that was. */
#define PB_INTERVAL_S 0.05
/* A longer interval is a gap, in which nothing is known of the way: begin anew with the init function. */
#define PB_LONGEST_STEP_S 0.3

/* Bits of pb_reading.present. */
#define PB_ACCELERATIONS 1u
#define PB_GYRO 2u

/* The robot. */
typedef struct {
    pb_real left_radius_m, right_radius_m;
    pb_real track_m; /* distance between the wheels: the paper's r is half of it */
    pb_real tick_rad; /* wheel rotation of one count */
} pb_robot;

/* What the sensors say at the end of an interval. */
typedef struct {
    pb_real dt_s;
    pb_real left_rad, right_rad; /* rotation of the wheels since the step before */
    pb_real left_m_s2, right_m_s2; /* forward acceleration at the wheels, bias removed; it counts from here on */
    pb_real gyro_rad_s; /* mean turn rate over the interval, bias and all */
    unsigned present; /* which of the last three are there; without accelerations they are 0 */
} pb_reading;

/* Where the robot is and how it moves. */
typedef struct {
    pb_real x_m, y_m, heading_rad, forward_m_s, turn_rad_s;
} pb_state;

/* ---- one filter per wheel ------------------------------------------------------------------------------------------------ */

/* Matrices in degrees: Q (angle, angle with rate, rate), R of the left and the right counter, P0. */
typedef struct {
    pb_real q[3], r[2], p0;
} pb_wheel_matrices;

typedef struct {
    pb_real phi, rate; /* degrees, degrees/s */
    pb_real p[3]; /* angle, angle with rate, rate */
} pb_wheel;

typedef struct {
    pb_wheel_matrices matrices;
    pb_wheel wheel[2]; /* left, right */
    pb_real counted[2]; /* degrees since the start */
    pb_state state;
} pb_wheel_kf;

extern const pb_wheel_matrices pb_wheel_printed; /* equation 19 */
void pb_wheel_kf_init(pb_wheel_kf *filter, const pb_wheel_matrices *matrices, const pb_state *start);
int pb_wheel_kf_step(pb_wheel_kf *filter, const pb_robot *robot, const pb_reading *reading);

/* ---- v and w ------------------------------------------------------------------------------------------------------------- */

/* Diagonals for v, (m/s)^2, and w, (rad/s)^2. */
typedef struct {
    pb_real q[2], r[2], p0[2];
} pb_speed_matrices;

typedef struct {
    pb_speed_matrices matrices;
    pb_real p[2];
    pb_real a_m_s2, alpha_rad_s2; /* felt at the end of the step before */
    pb_state state;
} pb_speed_kf;

pb_speed_matrices pb_speed_printed(void); /* equation 23, from centimetres and degrees */
/* From the robot: rounding of two counts, and accelerometers with this noise. */
pb_speed_matrices pb_speed_corrected(const pb_robot *robot, pb_real accelerometer_m_s2);
void pb_speed_kf_init(pb_speed_kf *filter, const pb_speed_matrices *matrices, const pb_state *start);
int pb_speed_kf_begin(pb_speed_kf *filter, const pb_robot *robot, const pb_reading *first);
int pb_speed_kf_step(pb_speed_kf *filter, const pb_robot *robot, const pb_reading *reading);

/* ---- five states --------------------------------------------------------------------------------------------------------- */

/* Diagonals, SI: Q of x, y, heading, v, w; R of v_enc, th_enc, th_gyro. */
typedef struct {
    pb_real q[5], r[3];
} pb_ekf5_matrices;

typedef struct {
    pb_ekf5_matrices matrices;
    pb_real gyro_bias_rad_s; /* subtracted from every reading */
    pb_real p[5][5];
    pb_real a_m_s2, alpha_rad_s2;
    pb_real wheel_heading_rad, gyro_heading_rad;
    int gyro_begun;
    pb_state state;
} pb_ekf5;

pb_ekf5_matrices pb_ekf5_printed(void); /* equations 25 and 26: q_v = 3, q_w = 1 */
pb_ekf5_matrices pb_ekf5_swapped(void); /* equation 24: q_v = 1, q_w = 3 */
/* The start is known to these standard deviations, m and rad. */
void pb_ekf5_init(pb_ekf5 *filter, const pb_ekf5_matrices *matrices, const pb_state *start, const pb_real sigma[2]);
int pb_ekf5_begin(pb_ekf5 *filter, const pb_robot *robot, const pb_reading *first);
int pb_ekf5_step(pb_ekf5 *filter, const pb_robot *robot, const pb_reading *reading);

/* ---- nine states --------------------------------------------------------------------------------------------------------- */

/* What is noisy; SI, see config/default.toml of this project for numbers. */
typedef struct {
    pb_real wheel_m_sqrt_m, travel_m_sqrt_m, turn_rad_sqrt_rad, heading_rad_sqrt_m; /* slip */
    pb_real gyro_rad_s, gyro_resolution_rad_s;
    pb_real bias_rad_s, bias_sigma_rad_s, bias_walk_rad_s_sqrt_s;
    pb_real accel_m_s2, turn_accel_rad_s2; /* how v and w walk, per root second */
} pb_noise;

/* Rows: x, y, heading, v, w, path of the counters, error of their heading, error of the gyro's heading, bias of the gyro. */
typedef struct {
    pb_noise noise;
    pb_real x[9], p[9][9];
    pb_real counted_path_m, wheel_heading_rad, gyro_heading_rad;
    pb_real a_m_s2, alpha_rad_s2;
    int gyro_begun;
    pb_state state;
} pb_ekf9;

void pb_ekf9_init(pb_ekf9 *filter, const pb_robot *robot, const pb_noise *noise, const pb_state *start, const pb_real sigma[2]);
int pb_ekf9_begin(pb_ekf9 *filter, const pb_robot *robot, const pb_reading *first);
int pb_ekf9_step(pb_ekf9 *filter, const pb_robot *robot, const pb_reading *reading);

#endif
