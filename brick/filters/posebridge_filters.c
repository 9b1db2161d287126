/* See posebridge_filters.h. Letters: d distance, th heading, b track, P covariance, S innovation's variance, K gain. */
#include "posebridge_filters.h"

#include <math.h>

/* The same functions for both precisions: the call is in double, which a compiler for a float brick may replace by sinf and cosf. */
static pb_real pb_sin(pb_real angle) { return (pb_real)(sizeof(pb_real) == sizeof(float) ? sinf((float)angle) : sin((double)angle)); }
static pb_real pb_cos(pb_real angle) { return (pb_real)(sizeof(pb_real) == sizeof(float) ? cosf((float)angle) : cos((double)angle)); }

#define PB_DEGREE ((pb_real)0.017453292519943295)
#define PB_CM2 ((pb_real)1e-4) /* a square centimetre, m^2 */
#define PB_DEG2 (PB_DEGREE * PB_DEGREE)
#define PB_T ((pb_real)PB_INTERVAL_S)

enum { X, Y, H, V, W, S, C, G, B }; /* rows of the state */

static pb_real squared(pb_real value) { return value * value; }

/* A number that is not finite makes the sum so, too. */
static int finite_senses(const pb_reading *r)
{
    pb_real sum = 0;
    if (r->present & PB_ACCELERATIONS) sum += r->left_m_s2 + r->right_m_s2;
    if (r->present & PB_GYRO) sum += r->gyro_rad_s;
    return isfinite(sum);
}

static int finite_reading(const pb_reading *r)
{
    pb_real sum = r->dt_s + r->left_rad + r->right_rad;
    return isfinite(sum) && finite_senses(r) && r->dt_s > 0 && r->dt_s <= (pb_real)PB_LONGEST_STEP_S;
}

static int finite_state(const pb_state *s)
{
    return isfinite(s->x_m + s->y_m + s->heading_rad + s->forward_m_s + s->turn_rad_s);
}

/* Equation 13: the pose after a way d with a turn dth. */
static void move(pb_state *s, pb_real d, pb_real dth)
{
    pb_real middle = s->heading_rad + dth / 2;
    s->x_m += d * pb_cos(middle);
    s->y_m += d * pb_sin(middle);
    s->heading_rad += dth;
}

/* Equation 14, with the minus sign and the whole track that print has lost. */
static void body(const pb_robot *robot, pb_real left_rad, pb_real right_rad, pb_real *d, pb_real *dth)
{
    pb_real left_m = robot->left_radius_m * left_rad;
    pb_real right_m = robot->right_radius_m * right_rad;
    *d = (left_m + right_m) / 2;
    *dth = (right_m - left_m) / robot->track_m;
}

/* Equation 21: accelerations of the body from those at the wheels; nothing felt is none. */
static void feel(const pb_robot *robot, const pb_reading *r, pb_real *a, pb_real *alpha)
{
    *a = 0;
    *alpha = 0;
    if (r->present & PB_ACCELERATIONS) {
        *a = (r->left_m_s2 + r->right_m_s2) / 2;
        *alpha = (r->right_m_s2 - r->left_m_s2) / robot->track_m;
    }
}

static pb_real mean_radius(const pb_robot *robot) { return (robot->left_radius_m + robot->right_radius_m) / 2; }

/* ---- one filter per wheel ------------------------------------------------------------------------------------------------ */

const pb_wheel_matrices pb_wheel_printed = {{(pb_real)0.1, 0, 10}, {(pb_real)1.5, (pb_real)2.5}, 10};

void pb_wheel_kf_init(pb_wheel_kf *filter, const pb_wheel_matrices *matrices, const pb_state *start)
{
    int side;
    filter->matrices = *matrices;
    filter->state = *start;
    for (side = 0; side < 2; side++) {
        pb_wheel *wheel = &filter->wheel[side];
        wheel->phi = 0;
        wheel->rate = 0;
        wheel->p[0] = wheel->p[2] = matrices->p0;
        wheel->p[1] = 0;
        filter->counted[side] = 0;
    }
}

/* Equations 15 to 18, written out for F = [1 dt; 0 1] and C = [1 0]. */
static void wheel_step(pb_wheel *wheel, const pb_real q[3], pb_real r, pb_real dt, pb_real counted)
{
    pb_real share = dt / PB_T;
    pb_real p00, p01, p11, s, nu;

    wheel->phi += dt * wheel->rate;
    p00 = wheel->p[0] + 2 * dt * wheel->p[1] + dt * dt * wheel->p[2] + share * q[0];
    p01 = wheel->p[1] + dt * wheel->p[2] + share * q[1];
    p11 = wheel->p[2] + share * q[2];

    s = p00 + r;
    nu = counted - wheel->phi;
    wheel->phi += p00 / s * nu;
    wheel->rate += p01 / s * nu;
    wheel->p[0] = p00 * r / s;
    wheel->p[1] = p01 * r / s;
    wheel->p[2] = p11 - p01 * p01 / s;
}

int pb_wheel_kf_step(pb_wheel_kf *filter, const pb_robot *robot, const pb_reading *r)
{
    pb_wheel_kf next = *filter;
    pb_real d, dth;

    if (!finite_reading(r)) return 0;
    next.counted[0] += r->left_rad / PB_DEGREE;
    next.counted[1] += r->right_rad / PB_DEGREE;
    wheel_step(&next.wheel[0], next.matrices.q, next.matrices.r[0], r->dt_s, next.counted[0]);
    wheel_step(&next.wheel[1], next.matrices.q, next.matrices.r[1], r->dt_s, next.counted[1]);
    body(robot, (next.wheel[0].phi - filter->wheel[0].phi) * PB_DEGREE, (next.wheel[1].phi - filter->wheel[1].phi) * PB_DEGREE, &d, &dth);
    move(&next.state, d, dth);
    body(robot, next.wheel[0].rate * PB_DEGREE, next.wheel[1].rate * PB_DEGREE, &next.state.forward_m_s, &next.state.turn_rad_s);
    if (!finite_state(&next.state)) return 0;
    *filter = next;
    return 1;
}

/* ---- v and w ------------------------------------------------------------------------------------------------------------- */

pb_speed_matrices pb_speed_printed(void)
{
    pb_speed_matrices m;
    m.q[0] = (pb_real)2.2 * PB_CM2;
    m.q[1] = (pb_real)2.2 * PB_DEG2;
    m.r[0] = (pb_real)5.1 * PB_CM2;
    m.r[1] = (pb_real)1.938 * PB_DEG2;
    m.p0[0] = 10 * PB_CM2;
    m.p0[1] = 10 * PB_DEG2;
    return m;
}

pb_speed_matrices pb_speed_corrected(const pb_robot *robot, pb_real accelerometer_m_s2)
{
    pb_speed_matrices m;
    pb_real count = mean_radius(robot) * robot->tick_rad / PB_T;
    pb_real felt = accelerometer_m_s2 * PB_T;
    m.r[0] = m.p0[0] = squared(count) / 12;
    m.r[1] = m.p0[1] = squared(count / robot->track_m) / 3;
    m.q[0] = squared(felt) / 2;
    m.q[1] = 2 * squared(felt / robot->track_m);
    return m;
}

void pb_speed_kf_init(pb_speed_kf *filter, const pb_speed_matrices *matrices, const pb_state *start)
{
    filter->matrices = *matrices;
    filter->p[0] = matrices->p0[0];
    filter->p[1] = matrices->p0[1];
    filter->a_m_s2 = 0;
    filter->alpha_rad_s2 = 0;
    filter->state = *start;
}

/* Equations 15 to 18 for F = C = 1. */
static void scalar_step(pb_real *x, pb_real *p, pb_real change, pb_real q, pb_real r, pb_real seen)
{
    pb_real k;
    *x += change;
    *p += q;
    k = *p / (*p + r);
    *x += k * (seen - *x);
    *p *= 1 - k;
}

int pb_speed_kf_begin(pb_speed_kf *filter, const pb_robot *robot, const pb_reading *first)
{
    if (!finite_senses(first)) return 0;
    feel(robot, first, &filter->a_m_s2, &filter->alpha_rad_s2);
    return 1;
}

int pb_speed_kf_step(pb_speed_kf *filter, const pb_robot *robot, const pb_reading *r)
{
    pb_speed_kf next = *filter;
    pb_real share = r->dt_s / PB_T;
    pb_real d, dth;

    if (!finite_reading(r)) return 0;
    move(&next.state, next.state.forward_m_s * r->dt_s, next.state.turn_rad_s * r->dt_s);
    body(robot, r->left_rad, r->right_rad, &d, &dth);
    scalar_step(&next.state.forward_m_s, &next.p[0], next.a_m_s2 * r->dt_s, share * next.matrices.q[0], next.matrices.r[0], d / r->dt_s);
    scalar_step(&next.state.turn_rad_s, &next.p[1], next.alpha_rad_s2 * r->dt_s, share * next.matrices.q[1], next.matrices.r[1], dth / r->dt_s);
    feel(robot, r, &next.a_m_s2, &next.alpha_rad_s2);
    if (!finite_state(&next.state)) return 0;
    *filter = next;
    return 1;
}

/* ---- five states --------------------------------------------------------------------------------------------------------- */

static pb_ekf5_matrices ekf5_matrices(pb_real q_v, pb_real q_w)
{
    pb_ekf5_matrices m;
    m.q[X] = m.q[Y] = 2 * PB_CM2;
    m.q[H] = (pb_real)0.1 * PB_DEG2;
    m.q[V] = q_v * PB_CM2;
    m.q[W] = q_w * PB_DEG2;
    m.r[0] = (pb_real)5.1 * PB_CM2;
    m.r[1] = (pb_real)0.938 * PB_DEG2;
    m.r[2] = (pb_real)0.332 * PB_DEG2;
    return m;
}

pb_ekf5_matrices pb_ekf5_printed(void) { return ekf5_matrices(3, 1); }
pb_ekf5_matrices pb_ekf5_swapped(void) { return ekf5_matrices(1, 3); }

void pb_ekf5_init(pb_ekf5 *filter, const pb_ekf5_matrices *matrices, const pb_state *start, const pb_real sigma[2])
{
    int i, j;
    filter->matrices = *matrices;
    filter->gyro_bias_rad_s = 0;
    for (i = 0; i < 5; i++)
        for (j = 0; j < 5; j++) filter->p[i][j] = 0;
    filter->p[X][X] = filter->p[Y][Y] = squared(sigma[0]);
    filter->p[H][H] = squared(sigma[1]);
    filter->p[V][V] = (pb_real)0.05 * PB_CM2;
    filter->p[W][W] = (pb_real)0.05 * PB_DEG2;
    filter->a_m_s2 = 0;
    filter->alpha_rad_s2 = 0;
    filter->state = *start;
    filter->wheel_heading_rad = filter->gyro_heading_rad = start->heading_rad;
    filter->gyro_begun = 0;
}

static void both(pb_real p[5][5], int i, int j, pb_real value)
{
    p[i][j] = value;
    p[j][i] = value;
}

/* Equation 24 and P <- F P F' + Q. F differs from the identity in the rows of x, y and heading only; the letters are its entries. */
static void ekf5_predict(pb_ekf5 *f, pb_real t)
{
    pb_state *s = &f->state;
    pb_real(*p)[5] = f->p;
    const pb_real *q = f->matrices.q;
    pb_real share = t / PB_T;
    pb_real middle = s->heading_rad + t * s->turn_rad_s / 2;
    pb_real sine = pb_sin(middle), cosine = pb_cos(middle);
    pb_real a = -t * s->forward_m_s * sine, b = t * cosine, c = t * a / 2; /* x by heading, v, w */
    pb_real d = t * s->forward_m_s * cosine, e = t * sine, g = t * d / 2; /* y by heading, v, w */
    pb_real hh = p[H][H], vh = p[V][H], wh = p[W][H], vv = p[V][V], wv = p[W][V], ww = p[W][W];
    /* F P: rows x, y and heading; a name is row and column. */
    pb_real xh = p[H][X] + a * hh + b * vh + c * wh;
    pb_real xv = p[V][X] + a * vh + b * vv + c * wv;
    pb_real xw = p[W][X] + a * wh + b * wv + c * ww;
    pb_real xy = p[Y][X] + a * p[H][Y] + b * p[V][Y] + c * p[W][Y];
    pb_real xx = p[X][X] + a * p[H][X] + b * p[V][X] + c * p[W][X];
    pb_real yh = p[H][Y] + d * hh + e * vh + g * wh;
    pb_real yv = p[V][Y] + d * vh + e * vv + g * wv;
    pb_real yw = p[W][Y] + d * wh + e * wv + g * ww;
    pb_real yy = p[Y][Y] + d * p[H][Y] + e * p[V][Y] + g * p[W][Y];
    pb_real hv = vh + t * wv, hw = wh + t * ww;

    /* (F P) F' + Q. */
    p[X][X] = xx + a * xh + b * xv + c * xw + share * q[X];
    p[Y][Y] = yy + d * yh + e * yv + g * yw + share * q[Y];
    p[H][H] = hh + t * wh + t * hw + share * q[H];
    p[V][V] = vv + share * q[V];
    p[W][W] = ww + share * q[W];
    both(p, Y, X, xy + d * xh + e * xv + g * xw);
    both(p, H, X, xh + t * xw);
    both(p, V, X, xv);
    both(p, W, X, xw);
    both(p, H, Y, yh + t * yw);
    both(p, V, Y, yv);
    both(p, W, Y, yw);
    both(p, V, H, hv);
    both(p, W, H, hw);

    s->x_m += s->forward_m_s * b;
    s->y_m += s->forward_m_s * e;
    s->heading_rad += t * s->turn_rad_s;
    s->forward_m_s += t * f->a_m_s2;
    s->turn_rad_s += t * f->alpha_rad_s2;
}

/* One row of equation 25: what is seen is one state. No matrix to invert: the rows of R are independent. */
static void ekf5_use(pb_ekf5 *f, int row, pb_real seen, pb_real r)
{
    pb_state *st = &f->state;
    pb_real *x[5];
    pb_real column[5], s, nu;
    int i, j;

    x[X] = &st->x_m;
    x[Y] = &st->y_m;
    x[H] = &st->heading_rad;
    x[V] = &st->forward_m_s;
    x[W] = &st->turn_rad_s;
    for (i = 0; i < 5; i++) column[i] = f->p[i][row];
    s = column[row] + r;
    nu = seen - *x[row];
    for (i = 0; i < 5; i++) {
        *x[i] += column[i] / s * nu;
        for (j = 0; j <= i; j++) both(f->p, i, j, f->p[i][j] - column[i] / s * column[j]);
    }
}

/* The integral of the gyro begins at the filter's own heading. */
static void ekf5_begin_gyro(pb_ekf5 *f)
{
    f->gyro_begun = 1;
    f->gyro_heading_rad = f->state.heading_rad;
}

int pb_ekf5_begin(pb_ekf5 *filter, const pb_robot *robot, const pb_reading *first)
{
    if (!finite_senses(first)) return 0;
    feel(robot, first, &filter->a_m_s2, &filter->alpha_rad_s2);
    if (first->present & PB_GYRO) ekf5_begin_gyro(filter);
    return 1;
}

int pb_ekf5_step(pb_ekf5 *filter, const pb_robot *robot, const pb_reading *r)
{
    pb_ekf5 next = *filter;
    pb_real d, dth;

    if (!finite_reading(r)) return 0;
    ekf5_predict(&next, r->dt_s);
    body(robot, r->left_rad, r->right_rad, &d, &dth);
    next.wheel_heading_rad += dth;
    ekf5_use(&next, V, d / r->dt_s, next.matrices.r[0]);
    ekf5_use(&next, H, next.wheel_heading_rad, next.matrices.r[1]);
    feel(robot, r, &next.a_m_s2, &next.alpha_rad_s2);
    if (r->present & PB_GYRO) {
        if (next.gyro_begun) {
            next.gyro_heading_rad += (r->gyro_rad_s - next.gyro_bias_rad_s) * r->dt_s;
            ekf5_use(&next, H, next.gyro_heading_rad, next.matrices.r[2]);
        } else {
            ekf5_begin_gyro(&next);
        }
    }
    if (!finite_state(&next.state)) return 0;
    *filter = next;
    return 1;
}

/* ---- nine states --------------------------------------------------------------------------------------------------------- */

/* Variance of the integrated gyro beside its error state, (0.01 degrees)^2: it keeps S away from zero. */
#define PB_INTEGRAL_VARIANCE ((pb_real)3.046e-8)
/* Standard deviations of v and w before anything is known: a robot that is switched on stands. */
#define PB_START_FORWARD ((pb_real)0.1)
#define PB_START_TURN ((pb_real)1)

static pb_real path_rounding(const pb_robot *robot)
{
    return (squared(robot->left_radius_m * robot->tick_rad) + squared(robot->right_radius_m * robot->tick_rad)) / 48;
}

static pb_real heading_rounding(const pb_robot *robot)
{
    return 4 * path_rounding(robot) / squared(robot->track_m);
}

/* An integral that begins at the filter's own heading errs as that does, with the other sign. */
static void begin_heading(pb_ekf9 *f, int error, pb_real variance)
{
    int i;
    f->x[error] = 0;
    f->p[error][error] = 0;
    for (i = 0; i < 9; i++)
        if (i != error) f->p[i][error] = f->p[error][i] = 0;
    for (i = 0; i < 9; i++)
        if (i != error) f->p[i][error] = f->p[error][i] = -f->p[H][i];
    f->p[error][error] = f->p[H][H] + variance;
}

void pb_ekf9_init(pb_ekf9 *f, const pb_robot *robot, const pb_noise *noise, const pb_state *start, const pb_real sigma[2])
{
    int i, j;
    f->noise = *noise;
    for (i = 0; i < 9; i++) {
        f->x[i] = 0;
        for (j = 0; j < 9; j++) f->p[i][j] = 0;
    }
    f->x[X] = start->x_m;
    f->x[Y] = start->y_m;
    f->x[H] = start->heading_rad;
    f->x[B] = noise->bias_rad_s;
    f->p[X][X] = f->p[Y][Y] = squared(sigma[0]);
    f->p[H][H] = squared(sigma[1]);
    f->p[V][V] = squared(PB_START_FORWARD);
    f->p[W][W] = squared(PB_START_TURN);
    f->p[B][B] = squared(noise->bias_sigma_rad_s);
    f->p[S][S] = path_rounding(robot);
    f->counted_path_m = 0;
    f->wheel_heading_rad = f->gyro_heading_rad = start->heading_rad;
    begin_heading(f, C, heading_rounding(robot));
    begin_heading(f, G, 0);
    f->a_m_s2 = 0;
    f->alpha_rad_s2 = 0;
    f->gyro_begun = 0;
    f->state = *start;
}

/* P[i][j] and P[j][i] <- + value */
static void add(pb_real p[9][9], int i, int j, pb_real value)
{
    p[i][j] += value;
    if (i != j) p[j][i] += value;
}

/* A speed that walks at random, and the rows that move with it: q dt^3/3, q dt^2/2, q dt. */
static void walk(pb_real p[9][9], int speed, const int rows[3], const pb_real by[3], pb_real density, pb_real t)
{
    pb_real q = squared(density) * t;
    int i, j;
    for (i = 0; i < 3; i++) {
        if (rows[i] < 0) continue;
        add(p, rows[i], speed, by[i] * q * t / 2);
        for (j = 0; j <= i; j++)
            if (rows[j] >= 0) add(p, rows[i], rows[j], by[i] * by[j] * q * t * t / 3);
    }
    p[speed][speed] += q;
}

static void slip(pb_ekf9 *f, const pb_robot *robot, pb_real t)
{
    const pb_noise *n = &f->noise;
    pb_real forward = f->x[V] * t, turn = f->x[W] * t, b = robot->track_m;
    pb_real left = squared(n->wheel_m_sqrt_m) * (pb_real)fabs((double)(forward - turn * b / 2));
    pb_real right = squared(n->wheel_m_sqrt_m) * (pb_real)fabs((double)(forward + turn * b / 2));
    pb_real way = (pb_real)fabs((double)forward), angle = (pb_real)fabs((double)turn);
    f->p[S][S] += (left + right) / 4 + squared(n->travel_m_sqrt_m) * way;
    f->p[C][C] += (left + right) / (b * b) + squared(n->turn_rad_sqrt_rad) * angle + squared(n->heading_rad_sqrt_m) * way;
    add(f->p, S, C, (right - left) / (2 * b));
}

static void ekf9_predict(pb_ekf9 *f, const pb_robot *robot, pb_real t)
{
    static const int way_rows[3] = {X, Y, S}, turn_rows[3] = {H, -1, -1};
    pb_real(*p)[9] = f->p;
    pb_real *x = f->x;
    pb_real middle = x[H] + t * x[W] / 2;
    pb_real sine = pb_sin(middle), cosine = pb_cos(middle);
    pb_real way[3], about[3] = {1, 0, 0};
    pb_real a = -t * x[V] * sine, b = t * cosine, c = t * a / 2;
    pb_real d = t * x[V] * cosine, e = t * sine, g = t * d / 2;
    int i;

    /* P <- F P, then P <- P F'. Rows v, w and bias of F are those of the identity, and x and y come before the heading. */
    for (i = 0; i < 9; i++) {
        p[X][i] += a * p[H][i] + b * p[V][i] + c * p[W][i];
        p[Y][i] += d * p[H][i] + e * p[V][i] + g * p[W][i];
        p[H][i] += t * p[W][i];
        p[S][i] += t * p[V][i];
        p[G][i] += t * p[B][i];
    }
    for (i = 0; i < 9; i++) {
        p[i][X] += a * p[i][H] + b * p[i][V] + c * p[i][W];
        p[i][Y] += d * p[i][H] + e * p[i][V] + g * p[i][W];
        p[i][H] += t * p[i][W];
        p[i][S] += t * p[i][V];
        p[i][G] += t * p[i][B];
    }
    way[0] = cosine;
    way[1] = sine;
    way[2] = 1;
    walk(p, V, way_rows, way, f->noise.accel_m_s2, t);
    walk(p, W, turn_rows, about, f->noise.turn_accel_rad_s2, t);
    slip(f, robot, t);
    p[B][B] += squared(f->noise.bias_walk_rad_s_sqrt_s) * t;

    x[S] += x[V] * t;
    x[G] += x[B] * t;
    x[X] += x[V] * b;
    x[Y] += x[V] * e;
    x[H] += t * x[W];
    x[V] += t * f->a_m_s2;
    x[W] += t * f->alpha_rad_s2;
}

/* What is seen is the sum of two states; a second row below zero: one state alone. */
static void ekf9_use(pb_ekf9 *f, int row, int second, pb_real seen, pb_real r)
{
    pb_real column[9], s, nu = seen - f->x[row];
    int i, j;

    for (i = 0; i < 9; i++) column[i] = f->p[i][row] + (second < 0 ? 0 : f->p[i][second]);
    s = column[row] + r;
    if (second >= 0) {
        s += column[second];
        nu -= f->x[second];
    }
    for (i = 0; i < 9; i++) {
        f->x[i] += column[i] / s * nu;
        for (j = 0; j <= i; j++) {
            f->p[i][j] -= column[i] / s * column[j];
            f->p[j][i] = f->p[i][j];
        }
    }
}

static void ekf9_begin_gyro(pb_ekf9 *f)
{
    f->gyro_begun = 1;
    f->gyro_heading_rad = f->x[H];
    begin_heading(f, G, 0);
}

int pb_ekf9_begin(pb_ekf9 *filter, const pb_robot *robot, const pb_reading *first)
{
    if (!finite_senses(first)) return 0;
    feel(robot, first, &filter->a_m_s2, &filter->alpha_rad_s2);
    if (first->present & PB_GYRO) ekf9_begin_gyro(filter);
    return 1;
}

int pb_ekf9_step(pb_ekf9 *filter, const pb_robot *robot, const pb_reading *r)
{
    pb_ekf9 next = *filter;
    pb_real d, dth;

    if (!finite_reading(r)) return 0;
    ekf9_predict(&next, robot, r->dt_s);
    body(robot, r->left_rad, r->right_rad, &d, &dth);
    next.counted_path_m += d;
    next.wheel_heading_rad += dth;
    ekf9_use(&next, S, -1, next.counted_path_m, path_rounding(robot));
    ekf9_use(&next, H, C, next.wheel_heading_rad, heading_rounding(robot));
    feel(robot, r, &next.a_m_s2, &next.alpha_rad_s2);
    if (r->present & PB_GYRO) {
        if (next.gyro_begun) {
            const pb_noise *n = &next.noise;
            next.p[G][G] += (squared(n->gyro_rad_s) + squared(n->gyro_resolution_rad_s) / 12) * squared(r->dt_s);
            next.gyro_heading_rad += r->gyro_rad_s * r->dt_s;
            ekf9_use(&next, H, G, next.gyro_heading_rad, PB_INTEGRAL_VARIANCE);
        } else {
            ekf9_begin_gyro(&next);
        }
    }
    next.state.x_m = next.x[X];
    next.state.y_m = next.x[Y];
    next.state.heading_rad = next.x[H];
    next.state.forward_m_s = next.x[V];
    next.state.turn_rad_s = next.x[W];
    if (!finite_state(&next.state)) return 0;
    *filter = next;
    return 1;
}
