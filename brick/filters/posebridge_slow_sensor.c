/* See posebridge_slow_sensor.h. Letters: P covariance, S innovation's variance, K gain, nu innovation. */
#include "posebridge_slow_sensor.h"

#include <math.h>
#include <stddef.h>

static pb_real pb_exp(pb_real x) { return (pb_real)(sizeof(pb_real) == sizeof(float) ? expf((float)x) : exp((double)x)); }

static pb_real squared(pb_real value) { return value * value; }

/* ---- thermometer --------------------------------------------------------------------------------------------------------- */

/* Standard deviations of the prior, in those of a sample. */
#define PB_PRIOR_SIGMAS ((pb_real)1e5)
/* Variance of the transient, in that of a sample, below which it is over: its factors would leave the range of single precision. */
#define PB_TRANSIENT_OVER ((pb_real)1e-20)

int pb_thermometer_init(pb_thermometer *filter, pb_real tau_s, pb_real sigma_k)
{
    filter->begun = 0;
    filter->tau_s = tau_s;
    filter->variance_k2 = squared(sigma_k);
    return tau_s > 0 && sigma_k > 0 && isfinite(tau_s + sigma_k);
}

int pb_thermometer_step(pb_thermometer *filter, pb_real dt_s, pb_real shown_c)
{
    pb_real decay, f, v_x, s_u, s, gain_u, nu;

    if (!isfinite(shown_c)) return 0;
    if (!filter->begun) {
        filter->u_c = shown_c;
        filter->x_k = 0;
        filter->d_u = filter->d_x = squared(PB_PRIOR_SIGMAS) * filter->variance_k2;
        filter->b = 0;
        filter->begun = 1;
    } else {
        if (!isfinite(dt_s) || dt_s <= 0) return 0;
        decay = pb_exp(-dt_s / filter->tau_s);
        filter->x_k *= decay;
        filter->d_x *= squared(decay);
        if (filter->d_x > PB_TRANSIENT_OVER * filter->variance_k2) {
            filter->b /= decay;
        } else {
            filter->d_x = filter->b = 0;
        }
    }
    /* Bierman's update for H = [1 1]. */
    f = filter->b + 1;
    v_x = filter->d_x * f;
    s_u = filter->variance_k2 + filter->d_u;
    s = s_u + v_x * f;
    gain_u = (filter->d_u + v_x * filter->b) / s;
    nu = shown_c - filter->u_c - filter->x_k;
    filter->u_c += gain_u * nu;
    filter->x_k += v_x / s * nu;
    filter->b -= f * filter->d_u / s_u;
    filter->d_u *= filter->variance_k2 / s_u;
    filter->d_x *= s_u / s;
    return 1;
}

pb_real pb_thermometer_variance(const pb_thermometer *filter)
{
    return filter->d_u + squared(filter->b) * filter->d_x;
}

/* ---- wall ---------------------------------------------------------------------------------------------------------------- */

/* Longer steps than this, or than one time constant of the motors, are exact: Euler's rule begins to oscillate there. */
#define PB_LONGEST_EULER_S ((pb_real)0.1)

void pb_wall_init(pb_wall *filter, const pb_wall_model *model)
{
    filter->model = *model;
    filter->begun = 0;
    filter->gated = 0;
    filter->input = 0;
}

/* x <- A x + B u with A = [1 -g; 0 e], and P <- A P A' + Sigma_u. */
static void wall_predict(pb_wall *f, pb_real dt)
{
    const pb_wall_model *m = &f->model;
    pb_real rate = m->drag_s_m / m->mass_s2_m;
    pb_real g = dt, e = 1 - rate * dt, moved = 0, gained = dt / m->mass_s2_m;
    pb_real q = squared(m->process_m);

    if (dt > PB_LONGEST_EULER_S || rate * dt > 1) {
        e = pb_exp(-rate * dt);
        g = (1 - e) / rate;
        moved = -(dt - g) / m->drag_s_m;
        gained = (1 - e) / m->drag_s_m;
    }
    f->z_m += moved * f->input - g * f->v_m_s;
    f->v_m_s = e * f->v_m_s + gained * f->input;
    f->p[0] += g * (g * f->p[2] - 2 * f->p[1]) + q;
    f->p[1] = e * (f->p[1] - g * f->p[2]);
    f->p[2] = e * e * f->p[2] + q;
}

/* nu^2 > max(GATE_MIN^2, 9 S): refused. */
static void wall_use(pb_wall *f, pb_real range)
{
    pb_real s = f->p[0] + squared(f->model.range_m);
    pb_real nu = range - f->z_m;
    pb_real k_z = f->p[0] / s, k_v = f->p[1] / s;

    f->gated = squared(nu) > 9 * s && squared(nu) > squared(f->model.gate_m);
    if (f->gated) return;
    f->z_m += k_z * nu;
    f->v_m_s += k_v * nu;
    f->p[2] -= k_v * f->p[1];
    f->p[1] *= 1 - k_z;
    f->p[0] *= 1 - k_z;
}

int pb_wall_step(pb_wall *filter, pb_real dt_s, pb_real input, const pb_real *range_m)
{
    if (!isfinite(input) || (range_m != NULL && !isfinite(*range_m))) return 0;
    if (filter->begun) {
        if (!isfinite(dt_s) || dt_s <= 0) return 0;
        wall_predict(filter, dt_s);
        filter->gated = 0;
        if (range_m != NULL) wall_use(filter, *range_m);
    } else if (range_m != NULL) {
        filter->z_m = *range_m;
        filter->v_m_s = 0;
        filter->p[0] = filter->p[2] = squared(filter->model.process_m);
        filter->p[1] = 0;
        filter->begun = 1;
    }
    filter->input = input;
    return 1;
}
