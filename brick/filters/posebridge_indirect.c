/* See posebridge_indirect.h. Equation numbers: docs/lab/indirect.md. */
#include "posebridge_indirect.h"

#include <math.h>

#ifdef PB_INDIRECT_SMALL
enum { X, Y, H, TB, PW, CW, BW };
#else
enum { X, Y, H, S, M, DR, TB, PS, CV, BV, PW, CW, BW, G, BG };
#endif

/* Rest of an accelerometer's bias after it was zeroed: a hundredth of g. */
#define PB_ACCELEROMETER_BIAS ((pb_real)0.1)
/* Standard deviations of the speeds from which the accelerometers' integrals begin: a count in 50 ms. */
#define PB_BEGIN_SPEED ((pb_real)0.02)
#define PB_BEGIN_TURN ((pb_real)0.2)
#define PB_LARGEST_SCALE ((pb_real)0.5)
#define PB_LEAST_ROUNDING ((pb_real)1e-10)

static pb_real pb_sin(pb_real angle) { return (pb_real)(sizeof(pb_real) == sizeof(float) ? sinf((float)angle) : sin((double)angle)); }
static pb_real pb_cos(pb_real angle) { return (pb_real)(sizeof(pb_real) == sizeof(float) ? cosf((float)angle) : cos((double)angle)); }
static pb_real pb_sqrt(pb_real value) { return (pb_real)(sizeof(pb_real) == sizeof(float) ? sqrtf((float)value) : sqrt((double)value)); }
static pb_real pb_abs(pb_real value) { return value < 0 ? -value : value; }
static pb_real squared(pb_real value) { return value * value; }
static pb_real clamped(pb_real value, pb_real least, pb_real most) { return value < least ? least : value > most ? most : value; }

/* Entry of the symmetric P. */
static pb_real *at(pb_indirect *f, int i, int j)
{
    int row = i >= j ? i : j, column = i >= j ? j : i;
    return &f->p[row * (row + 1) / 2 + column];
}

static pb_real angle_rounding(const pb_robot *robot)
{
    pb_real count = (robot->left_radius_m + robot->right_radius_m) / 2 * robot->tick_rad;
    pb_real variance = squared(count / robot->track_m) / 6;
    return variance > PB_LEAST_ROUNDING ? variance : PB_LEAST_ROUNDING;
}

static void clear_row(pb_indirect *f, int row, pb_real variance)
{
    int i;
    f->e[row] = 0;
    for (i = 0; i < PB_INDIRECT_ROWS; i++) *at(f, row, i) = 0;
    *at(f, row, row) = variance;
}

/* An integral that begins at the path errs as the path does, with the other sign. */
static void begin_row(pb_indirect *f, int row, int path, pb_real rounding)
{
    int i;
    clear_row(f, row, 0);
    f->e[row] = -f->e[path];
    for (i = 0; i < PB_INDIRECT_ROWS; i++)
        if (i != row) *at(f, row, i) = -*at(f, path, i);
    *at(f, row, row) = *at(f, path, path) + rounding;
}

/* e_i += k e_j, and with it P: one entry of F beside its diagonal. */
static void add_row(pb_indirect *f, int i, int j, pb_real k)
{
    int m;
    pb_real square = k * (2 * *at(f, i, j) + k * *at(f, j, j));
    f->e[i] += k * f->e[j];
    for (m = 0; m < PB_INDIRECT_ROWS; m++)
        if (m != i) *at(f, i, m) += k * *at(f, j, m);
    *at(f, i, i) += square;
}

void pb_indirect_init(pb_indirect *f, const pb_robot *robot, const pb_indirect_settings *settings, const pb_state *start, const pb_real sigma[2])
{
    int i;
    f->settings = *settings;
    for (i = 0; i < PB_INDIRECT_ROWS; i++) clear_row(f, i, 0);
    f->x_m = start->x_m;
    f->y_m = start->y_m;
    f->angle_rad = f->settled_rad = start->heading_rad;
    f->distance_m = 0;
    f->scales[0] = f->scales[1] = f->scales[2] = 0;
    f->accelerometers.tracked = f->accelerometers.heard = f->gyro.tracked = f->gyro.heard = 0;
    f->accelerometers.squared_s2 = f->gyro.squared_s2 = f->accelerometers.since_s = f->gyro.since_s = 0;
    f->felt_m = f->felt_m_s = f->felt_rad = f->felt_rad_s = f->gyro_rad = 0;
    *at(f, X, X) = *at(f, Y, Y) = squared(sigma[0]);
    *at(f, H, H) = squared(sigma[1]);
    *at(f, TB, TB) = squared(settings->track_scale);
    *at(f, BW, BW) = 2 * squared(PB_ACCELEROMETER_BIAS / robot->track_m);
#ifndef PB_INDIRECT_SMALL
    *at(f, M, M) = squared(settings->radius_scale);
    *at(f, DR, DR) = squared(settings->radius_difference);
    *at(f, BV, BV) = squared(PB_ACCELEROMETER_BIAS) / 2;
    f->e[BG] = settings->noise.bias_rad_s;
    *at(f, BG, BG) = squared(settings->noise.bias_sigma_rad_s);
#endif
    f->state = *start;
    f->state.forward_m_s = f->state.turn_rad_s = 0;
}

/* (M10) and its noise: an integral of a sum with a bias, over dt. White noise of a sample comes in by its squared interval. */
static void integrate_twice(pb_indirect *f, int first, pb_real dt, pb_real variance)
{
    add_row(f, first, first + 1, dt);
    add_row(f, first, first + 2, dt * dt / 2);
    add_row(f, first + 1, first + 2, dt);
    *at(f, first, first) += variance * dt * dt / 3;
    *at(f, first, first + 1) += variance * dt / 2;
    *at(f, first + 1, first + 1) += variance;
}

/* (M8), (M9): the path moves, its error and P with it. Returns distance and turn of the path. */
static void advance(pb_indirect *f, const pb_robot *robot, const pb_reading *r, pb_real *d, pb_real *dth)
{
    const pb_noise *n = &f->settings.noise;
    pb_real b = robot->track_m, track = b * (1 + f->scales[2]);
    pb_real left = robot->left_radius_m * r->left_rad * (1 + f->scales[0] - f->scales[1] / 2);
    pb_real right = robot->right_radius_m * r->right_rad * (1 + f->scales[0] + f->scales[1] / 2);
    pb_real turn = (right - left) / track, way = (left + right) / 2;
    pb_real middle = f->angle_rad + turn / 2, half = turn / 2, square = half * half;
    /* c = sin(half)/half and dc/d(turn), by series: the next terms are below 1e-11 for a turn of half a radian. */
    pb_real c = 1 - square / 6 * (1 - square / 20 * (1 - square / 42)), c_turn = -half / 6 * (1 - square / 10 * (1 - square / 28 * (1 - square / 54)));
    pb_real sine = pb_sin(middle), cosine = pb_cos(middle);
    pb_real x_d = c * cosine, y_d = c * sine, x_h = -way * y_d, y_h = way * x_d;
    pb_real x_t = c_turn * way * cosine + x_h / 2, y_t = c_turn * way * sine + y_h / 2;
    pb_real play = pb_sqrt(6 * angle_rounding(robot)), settled = f->settled_rad, t[3];
    pb_real left_var, right_var, way_var, turn_var, both_var, white;

    /* The dead band of one count: a derivative that follows the counts' jitter is correlated with the innovation. */
    f->settled_rad = clamped(settled, f->angle_rad + turn - play, f->angle_rad + turn + play);
    t[0] = f->settled_rad - settled;
    t[1] = (robot->left_radius_m * r->left_rad + robot->right_radius_m * r->right_rad) / (2 * track);
    t[2] = -t[0] / (1 + f->scales[2]);

    /* F: x and y before the heading, which is one of their sources. */
    add_row(f, X, H, x_h);
    add_row(f, Y, H, y_h);
    add_row(f, X, TB, x_t * t[2]);
    add_row(f, Y, TB, y_t * t[2]);
    add_row(f, H, TB, t[2]);
#ifndef PB_INDIRECT_SMALL
    {
        pb_real by_m = t[1] * track, by_dr = t[0] * track / 4;
        add_row(f, X, M, x_d * by_m + x_t * t[0]);
        add_row(f, Y, M, y_d * by_m + y_t * t[0]);
        add_row(f, H, M, t[0]);
        add_row(f, S, M, by_m);
        add_row(f, X, DR, x_d * by_dr + x_t * t[1]);
        add_row(f, Y, DR, y_d * by_dr + y_t * t[1]);
        add_row(f, H, DR, t[1]);
        add_row(f, S, DR, by_dr);
    }
#endif

    /* Gamma Q Gamma': slip. */
    left_var = squared(n->wheel_m_sqrt_m) * pb_abs(left);
    right_var = squared(n->wheel_m_sqrt_m) * pb_abs(right);
    way_var = (left_var + right_var) / 4 + squared(n->travel_m_sqrt_m) * pb_abs(way);
    turn_var = (left_var + right_var) / (b * b) + squared(n->turn_rad_sqrt_rad) * pb_abs((right - left) / b) + squared(n->heading_rad_sqrt_m) * pb_abs(way);
    both_var = (right_var - left_var) / (2 * b);
    *at(f, X, X) += x_d * x_d * way_var + x_t * x_t * turn_var + 2 * x_d * x_t * both_var;
    *at(f, Y, Y) += y_d * y_d * way_var + y_t * y_t * turn_var + 2 * y_d * y_t * both_var;
    *at(f, X, Y) += x_d * y_d * way_var + x_t * y_t * turn_var + (x_d * y_t + x_t * y_d) * both_var;
    *at(f, X, H) += x_t * turn_var + x_d * both_var;
    *at(f, Y, H) += y_t * turn_var + y_d * both_var;
    *at(f, H, H) += turn_var;
    white = squared(f->settings.accelerometer_m_s2) * f->accelerometers.squared_s2;
    integrate_twice(f, PW, r->dt_s, 2 * white / (b * b));
#ifndef PB_INDIRECT_SMALL
    *at(f, X, S) += x_d * way_var + x_t * both_var;
    *at(f, Y, S) += y_d * way_var + y_t * both_var;
    *at(f, H, S) += both_var;
    *at(f, S, S) += way_var;
    integrate_twice(f, PS, r->dt_s, white / 2);
    add_row(f, G, BG, r->dt_s);
    *at(f, G, G) += (squared(n->gyro_rad_s) + squared(n->gyro_resolution_rad_s) / 12) * f->gyro.squared_s2;
    *at(f, BG, BG) += squared(n->bias_walk_rad_s_sqrt_s) * r->dt_s;
#endif
    f->accelerometers.squared_s2 = f->gyro.squared_s2 = 0;

    f->x_m += way * x_d;
    f->y_m += way * y_d;
    f->angle_rad += turn;
    f->distance_m += way;
    *d = way;
    *dth = turn;
}

/* (M11), (M4), (M5): dz = error of the path + error of the integral + rounding. */
static void use(pb_indirect *f, int path, int integral, pb_real dz, pb_real rounding)
{
    pb_real column[PB_INDIRECT_ROWS], s, nu = dz - f->e[path] - f->e[integral];
    int i, j;
    for (i = 0; i < PB_INDIRECT_ROWS; i++) column[i] = *at(f, i, path) + *at(f, i, integral);
    s = column[path] + column[integral] + rounding;
    for (i = 0; i < PB_INDIRECT_ROWS; i++) {
        pb_real k = column[i] / s;
        f->e[i] += k * nu;
        for (j = 0; j <= i; j++) *at(f, i, j) -= k * column[j];
    }
}

/* (3): the errors of path and geometry move into them. */
static void feed_back(pb_indirect *f)
{
    if (!f->settings.feedback) return;
    f->x_m += f->e[X];
    f->y_m += f->e[Y];
    f->angle_rad += f->e[H];
    f->settled_rad += f->e[H];
    f->scales[2] = clamped(f->scales[2] + f->e[TB], -PB_LARGEST_SCALE, PB_LARGEST_SCALE);
    f->e[X] = f->e[Y] = f->e[H] = f->e[TB] = 0;
#ifndef PB_INDIRECT_SMALL
    f->distance_m += f->e[S];
    f->scales[0] = clamped(f->scales[0] + f->e[M], -PB_LARGEST_SCALE, PB_LARGEST_SCALE);
    f->scales[1] = clamped(f->scales[1] + f->e[DR], -PB_LARGEST_SCALE, PB_LARGEST_SCALE);
    f->e[S] = f->e[M] = f->e[DR] = 0;
#endif
}

/* The interval that a sample ends; 0 for the first one. */
static pb_real sampled(pb_integral *integral)
{
    pb_real dt = integral->heard ? integral->since_s : 0;
    integral->heard = 1;
    integral->since_s = 0;
    integral->squared_s2 += dt * dt;
    return dt;
}

/* After a silence an integral is not followed any more: its errors would grow without bound. */
static void pass_time(pb_integral *integral, pb_real dt)
{
    integral->since_s += dt;
    if (integral->since_s > (pb_real)PB_LONGEST_STEP_S) integral->heard = 0;
    if (!integral->heard) {
        integral->tracked = 0;
        integral->squared_s2 = 0;
    }
}

static void feel(pb_indirect *f, const pb_robot *robot, const pb_reading *r, pb_real way_m_s, pb_real turn_rad_s)
{
    pb_real dt = sampled(&f->accelerometers), rounding = angle_rounding(robot);
    pb_real alpha = (r->right_m_s2 - r->left_m_s2) / robot->track_m;
#ifndef PB_INDIRECT_SMALL
    pb_real a = (r->left_m_s2 + r->right_m_s2) / 2, along = rounding * squared(robot->track_m) / 4;
    f->felt_m += f->felt_m_s * dt + a * dt * dt / 2;
    f->felt_m_s += a * dt;
#endif
    f->felt_rad += f->felt_rad_s * dt + alpha * dt * dt / 2;
    f->felt_rad_s += alpha * dt;
    if (f->accelerometers.tracked) {
        use(f, H, PW, f->felt_rad - f->angle_rad, rounding);
#ifndef PB_INDIRECT_SMALL
        use(f, S, PS, f->felt_m - f->distance_m, along);
#endif
    } else {
        f->accelerometers.tracked = 1;
        f->felt_rad = f->angle_rad;
        f->felt_rad_s = turn_rad_s;
        begin_row(f, PW, H, rounding);
        clear_row(f, CW, squared(PB_BEGIN_TURN));
#ifndef PB_INDIRECT_SMALL
        f->felt_m = f->distance_m;
        f->felt_m_s = way_m_s;
        begin_row(f, PS, S, along);
        clear_row(f, CV, squared(PB_BEGIN_SPEED));
#endif
    }
    (void)way_m_s;
    feed_back(f);
}

#ifndef PB_INDIRECT_SMALL
static void sense_turn(pb_indirect *f, const pb_robot *robot, pb_real rate)
{
    pb_real dt = sampled(&f->gyro), rounding = angle_rounding(robot);
    f->gyro_rad += rate * dt;
    if (f->gyro.tracked) {
        use(f, H, G, f->gyro_rad - f->angle_rad, rounding);
    } else {
        f->gyro.tracked = 1;
        f->gyro_rad = f->angle_rad;
        begin_row(f, G, H, rounding);
    }
    feed_back(f);
}
#endif

/* The estimate: the path and its errors. The second pointer is there because avr-gcc 5.4 computes a wrong address from one. */
static void add_errors(const pb_indirect *f, pb_state *state)
{
    state->x_m = f->x_m + f->e[X];
    state->y_m = f->y_m + f->e[Y];
    state->heading_rad = f->angle_rad + f->e[H];
}

static void use_senses(pb_indirect *f, const pb_robot *robot, const pb_reading *r, pb_real way_m_s, pb_real turn_rad_s)
{
    if (r->present & PB_ACCELERATIONS) feel(f, robot, r, way_m_s, turn_rad_s);
#ifndef PB_INDIRECT_SMALL
    if (r->present & PB_GYRO) sense_turn(f, robot, r->gyro_rad_s);
#endif
    add_errors(f, &f->state);
}

static void drop_silent(pb_indirect *f)
{
    if (!f->accelerometers.tracked) {
        clear_row(f, PW, 0);
        clear_row(f, CW, 0);
#ifndef PB_INDIRECT_SMALL
        clear_row(f, PS, 0);
        clear_row(f, CV, 0);
#endif
    }
#ifndef PB_INDIRECT_SMALL
    if (!f->gyro.tracked) clear_row(f, G, 0);
#endif
}

static int finite_senses(const pb_reading *r)
{
    pb_real sum = 0;
    if (r->present & PB_ACCELERATIONS) sum += r->left_m_s2 + r->right_m_s2;
    if (r->present & PB_GYRO) sum += r->gyro_rad_s;
    return isfinite(sum);
}

int pb_indirect_begin(pb_indirect *filter, const pb_robot *robot, const pb_reading *first)
{
    if (!finite_senses(first)) return 0;
    use_senses(filter, robot, first, 0, 0);
    return 1;
}

int pb_indirect_step(pb_indirect *filter, const pb_robot *robot, const pb_reading *r)
{
    pb_real d, dth;
    /* A finite reading of a sane robot leaves everything finite: P is not copied to be able to go back. */
    if (!isfinite(r->dt_s + r->left_rad + r->right_rad) || !finite_senses(r)) return 0;
    if (r->dt_s <= 0 || r->dt_s > (pb_real)PB_LONGEST_STEP_S || pb_abs(r->left_rad) + pb_abs(r->right_rad) > 100) return 0;
    advance(filter, robot, r, &d, &dth);
    filter->state.forward_m_s = d / r->dt_s;
    filter->state.turn_rad_s = dth / r->dt_s;
    pass_time(&filter->accelerometers, r->dt_s);
    pass_time(&filter->gyro, r->dt_s);
    drop_silent(filter);
    use_senses(filter, robot, r, filter->state.forward_m_s, filter->state.turn_rad_s);
    return 1;
}
