/*
 * The drive: psi(i) from the tables of map.h, u = R i + drop + omega J psi + d psi / dt, torque 3/2 p psi x i.
 * States: i_d, i_q (A) and the electrical angle (rad). No part of it knows FMI.
 */
#ifndef DRIVE_ID_MODEL_H
#define DRIVE_ID_MODEL_H

#include "map.h"
#include "variables.h"
#include <stdlib.h>
#include <string.h>

#define STATES 3
#define TOLERANCE 1e-6 /* of a current within a step of the solver inside, by i_max */
#define HALVINGS 8 /* of such a step, at most */
#define BEYOND 1.5 /* of i_max: farther than that without data, it is told */

typedef struct {
    double value[VARIABLES];
} Model;

static void model_reset(Model *m)
{
    memcpy(m->value, starts, sizeof starts);
}

/* psi (Wb) at i_d, i_q; beyond the tables it continues with the slopes at their edge. */
static void model_psi(double i_d, double i_q, double out[2])
{
    const double h = 1e-4 * DRIVE_ID_I_MAX;
    const double d = drive_id_clamp(drive_id_i_d, DRIVE_ID_ND, i_d), q = drive_id_clamp(drive_id_i_q, DRIVE_ID_NQ, i_q);
    out[0] = drive_id_psi_d_bicubic(d, q);
    out[1] = drive_id_psi_q_bicubic(d, q);
    if (i_d != d) {
        const double inner = i_d < d ? d + h : d - h, share = (i_d - d) / (d - inner);
        out[0] += share * (out[0] - drive_id_psi_d_bicubic(inner, q));
        out[1] += share * (out[1] - drive_id_psi_q_bicubic(inner, q));
    }
    if (i_q != q) {
        const double inner = i_q < q ? q + h : q - h, share = (i_q - q) / (q - inner);
        out[0] += share * (drive_id_psi_d_bicubic(d, q) - drive_id_psi_d_bicubic(d, inner));
        out[1] += share * (drive_id_psi_q_bicubic(d, q) - drive_id_psi_q_bicubic(d, inner));
    }
}

/* psi (Wb) and its derivatives by i_d and i_q (H): psi_d, psi_q, L_dd, L_dq, L_qd, L_qq. */
static void model_flux(const double *v, double out[6])
{
    const double i_d = v[I_D], i_q = v[I_Q], h = 1e-4 * DRIVE_ID_I_MAX;
    double low[2], high[2];
    model_psi(i_d, i_q, out);
    out[0] += drive_id_magnet(v[MAGNET_TEMPERATURE]);
    model_psi(i_d - h, i_q, low);
    model_psi(i_d + h, i_q, high);
    out[2] = (high[0] - low[0]) / (2 * h);
    out[4] = (high[1] - low[1]) / (2 * h);
    model_psi(i_d, i_q - h, low);
    model_psi(i_d, i_q + h, high);
    out[3] = (high[0] - low[0]) / (2 * h);
    out[5] = (high[1] - low[1]) / (2 * h);
}

/* What is wrong with the state, in a sentence; NULL: nothing. */
static const char *model_trouble(const Model *m)
{
    const double i_d = m->value[I_D], i_q = m->value[I_Q];
    if (!isfinite(i_d) || !isfinite(i_q)) {
        return "The currents diverged: check voltages, speed, temperatures and the step of the solver inside.";
    }
    if (i_d * i_d + i_q * i_q > BEYOND * BEYOND * DRIVE_ID_I_MAX * DRIVE_ID_I_MAX && !drive_id_inside(i_d, i_q)) {
        return "The current is beyond 1.5 i_max and the data: the map continues with its slopes, which were not measured.";
    }
    return NULL;
}

/* Compute outputs and derivatives from states, inputs and parameters. */
static void model_update(Model *m)
{
    double *v = m->value, f[6], phase[3], drop[3], u_d, u_q, det;
    const double root = 0.86602540378443865, c = cos(v[ANGLE]), s = sin(v[ANGLE]);
    const double r = drive_id_resistance(v[WINDING_TEMPERATURE]) * v[RESISTANCE] / DRIVE_ID_RESISTANCE;
    const double omega = DRIVE_ID_POLE_PAIRS * v[SPEED];
    const double alpha = c * v[I_D] - s * v[I_Q], beta = s * v[I_D] + c * v[I_Q];
    int k;
    phase[0] = alpha;
    phase[1] = -0.5 * alpha + root * beta;
    phase[2] = -0.5 * alpha - root * beta;
    for (k = 0; k < 3; k++) {
        v[I_A + k] = phase[k];
        drop[k] = v[U_A + k] - v[INVERTER] * drive_id_drop(phase[k]);
    }
    {
        const double a = (2 * drop[0] - drop[1] - drop[2]) / 3, b = (drop[1] - drop[2]) / (2 * root);
        u_d = c * a + s * b + v[U_D];
        u_q = c * b - s * a + v[U_Q];
    }
    model_flux(v, f);
    v[PSI_D] = f[0];
    v[PSI_Q] = f[1];
    v[TORQUE] = 1.5 * DRIVE_ID_POLE_PAIRS * (f[0] * v[I_Q] - f[1] * v[I_D]);
    v[INSIDE] = drive_id_inside(v[I_D], v[I_Q]);
    u_d += omega * f[1] - r * v[I_D];
    u_q -= omega * f[0] + r * v[I_Q];
    det = f[2] * f[5] - f[3] * f[4];
    v[DER_I_D] = (f[5] * u_d - f[3] * u_q) / det;
    v[DER_I_Q] = (f[2] * u_q - f[4] * u_d) / det;
    v[DER_ANGLE] = omega;
}

/* One step of Runge-Kutta's rule of fourth order over dt (s). */
static void model_rule(Model *m, double dt)
{
    double start[STATES], slope[4][STATES];
    static const double share[4] = {0, 0.5, 0.5, 1};
    int k, j;
    memcpy(start, m->value + I_D, sizeof start);
    for (k = 0; k < 4; k++) {
        for (j = 0; j < STATES && k > 0; j++) {
            m->value[I_D + j] = start[j] + share[k] * dt * slope[k - 1][j];
        }
        model_update(m);
        memcpy(slope[k], m->value + DER_I_D, sizeof start);
    }
    for (j = 0; j < STATES; j++) {
        m->value[I_D + j] = start[j] + dt / 6 * (slope[0][j] + 2 * slope[1][j] + 2 * slope[2][j] + slope[3][j]);
    }
}

/*
 * Two steps over dt (s) in all; while they differ from one by more than TOLERANCE, each half is divided likewise: a current
 * that leaves a bridge, or a drop that changes its sign, rises by many amperes within one step of a smooth machine.
 */
static void model_advance(Model *m, double dt, int halvings)
{
    double start[STATES], once[STATES], away;
    memcpy(start, m->value + I_D, sizeof start);
    model_rule(m, dt);
    memcpy(once, m->value + I_D, sizeof once);
    memcpy(m->value + I_D, start, sizeof start);
    model_rule(m, dt / 2);
    model_rule(m, dt / 2);
    away = fabs(m->value[I_D] - once[0]) + fabs(m->value[I_Q] - once[1]);
    if (halvings > 0 && away > TOLERANCE * DRIVE_ID_I_MAX) {
        memcpy(m->value + I_D, start, sizeof start);
        model_advance(m, dt / 2, halvings - 1);
        model_advance(m, dt / 2, halvings - 1);
    }
}

/* Advance by h (s), in equal steps of at most the parameter step, divided where the currents need it. */
static void model_step(Model *m, double h)
{
    const double count = ceil(h / m->value[STEP] - 1e-9);
    const int steps = count < 1 ? 1 : (count > 1e8 ? 100000000 : (int)count);
    int n;
    for (n = 0; n < steps; n++) {
        model_advance(m, h / steps, HALVINGS);
    }
    m->value[TIME] += h;
    model_update(m);
}

static int model_set(Model *m, unsigned vr, double x)
{
    if (vr == TIME || vr >= VARIABLES || !settable[vr]) {
        return 0;
    }
    m->value[vr] = x;
    return 1;
}

#endif
