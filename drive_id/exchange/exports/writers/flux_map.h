/*
 * Flux map of machine $name.
 * $source
 *
 * Peak values; d on the magnet axis, q leads it by 90 degrees electrical.
 *
 *   drive_id_psi_d(i_d, i_q), drive_id_psi_q(i_d, i_q)                  bilinear, continuous
 *   drive_id_psi_d_bicubic(i_d, i_q), drive_id_psi_q_bicubic(i_d, i_q)  bicubic, with continuous slopes
 *   drive_id_inside(i_d, i_q)                                           1 where the map rests on data
 *   drive_id_kp_d(i_d, i_q), drive_id_kp_q(i_d, i_q), DRIVE_ID_KI       gains of the current controllers, SI
 *   drive_id_kp_d_q15, drive_id_kp_q_q15, DRIVE_ID_KI_T_Q15             the same per unit: int16 times 2^-SHIFT
 *   drive_id_feedforward(i_d, i_q, omega, r, u_dq)                      R i + omega J psi: decoupling included
 *   drive_id_drop(i)                                                    voltage to add to a phase for its current
 *   drive_id_active_flux(i_d, i_q), DRIVE_ID_PLL_KP, DRIVE_ID_PLL_KI    for an observer of the angle
 *   drive_id_resistance(celsius), drive_id_magnet(celsius)              R, and change of psi_d, with temperature
 *
 * Currents beyond the axes are moved to their ends. Points without data hold a smooth continuation of the map, which was
 * not measured: drive_id_inside tells. The result is NaN for a current that is NaN only.
 *
 * For tables in double precision, define DRIVE_ID_DOUBLE before this header is included.
 */
#ifndef DRIVE_ID_FLUX_MAP_H
#define DRIVE_ID_FLUX_MAP_H

#include <math.h>
#include <stdint.h>

#ifdef DRIVE_ID_DOUBLE
typedef double drive_id_real;
#define DRIVE_ID_C(x) x
#define drive_id_sqrt sqrt
#else
typedef float drive_id_real;
#define DRIVE_ID_C(x) x##f
#define drive_id_sqrt sqrtf
#endif
#define DRIVE_ID_NAN ((drive_id_real)NAN)

$content

/* Move a current to the range of an axis; NaN stays NaN. */
static inline drive_id_real drive_id_clamp(const drive_id_real *axis, int n, drive_id_real x)
{
    return x < axis[0] ? axis[0] : (x > axis[n - 1] ? axis[n - 1] : x);
}

/* Index of the cell of an axis that holds x, 0 to n - 2. */
static inline int drive_id_cell(const drive_id_real *axis, int n, drive_id_real x)
{
    int low = 0, high = n - 1;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (x >= axis[middle]) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

/* Corners without weight do not count, so that a map may be read up to its rim. */
static inline drive_id_real drive_id_mix(drive_id_real a, drive_id_real b, drive_id_real t)
{
    return t == 0 ? a : (t == 1 ? b : a + t * (b - a));
}

static inline drive_id_real drive_id_bilinear(const drive_id_real *table, drive_id_real i_d, drive_id_real i_q)
{
    const drive_id_real x = drive_id_clamp(drive_id_i_d, DRIVE_ID_ND, i_d);
    const drive_id_real y = drive_id_clamp(drive_id_i_q, DRIVE_ID_NQ, i_q);
    const int d = drive_id_cell(drive_id_i_d, DRIVE_ID_ND, x), q = drive_id_cell(drive_id_i_q, DRIVE_ID_NQ, y);
    const drive_id_real t = (x - drive_id_i_d[d]) / (drive_id_i_d[d + 1] - drive_id_i_d[d]);
    const drive_id_real s = (y - drive_id_i_q[q]) / (drive_id_i_q[q + 1] - drive_id_i_q[q]);
    const drive_id_real *row = table + d * DRIVE_ID_NQ + q;
    if (x != x || y != y) {
        return DRIVE_ID_NAN;
    }
    return drive_id_mix(drive_id_mix(row[0], row[1], s), drive_id_mix(row[DRIVE_ID_NQ], row[DRIVE_ID_NQ + 1], s), t);
}

/*
 * Weights of points k - 1 to k + 2 for the cubic Hermite polynomial in cell k whose slopes at the points are those of
 * the parabolas through them and their neighbours; at the ends of the axis, of the parabola through the last three.
 */
static inline void drive_id_cubic(const drive_id_real *axis, int n, int k, drive_id_real x, drive_id_real w[4])
{
    const drive_id_real h = axis[k + 1] - axis[k], t = (x - axis[k]) / h, t2 = t * t, t3 = t2 * t;
    const drive_id_real m1 = t3 - 2 * t2 + t, m2 = t3 - t2; /* of the slopes times h */
    drive_id_real a[4] = {0, 0, 0, 0}, b[4] = {0, 0, 0, 0}; /* slopes times h at both ends of the cell */
    int j;
    if (k > 0) {
        const drive_id_real g = axis[k] - axis[k - 1];
        a[0] = -h * h / (g * (g + h));
        a[1] = (h - g) / g;
        a[2] = g / (g + h);
    }
    if (k < n - 2) {
        const drive_id_real g = axis[k + 2] - axis[k + 1];
        b[1] = -g / (g + h);
        b[2] = (g - h) / g;
        b[3] = h * h / (g * (g + h));
    }
    if (k == 0) {
        a[1] = -2 - b[1];
        a[2] = 2 - b[2];
        a[3] = -b[3];
    }
    if (k == n - 2) {
        b[0] = -a[0];
        b[1] = -2 - a[1];
        b[2] = 2 - a[2];
    }
    for (j = 0; j < 4; j++) {
        w[j] = m1 * a[j] + m2 * b[j];
    }
    w[1] += 2 * t3 - 3 * t2 + 1;
    w[2] += 3 * t2 - 2 * t3;
}

static inline drive_id_real drive_id_bicubic(const drive_id_real *table, drive_id_real i_d, drive_id_real i_q)
{
    const drive_id_real x = drive_id_clamp(drive_id_i_d, DRIVE_ID_ND, i_d);
    const drive_id_real y = drive_id_clamp(drive_id_i_q, DRIVE_ID_NQ, i_q);
    const int d = drive_id_cell(drive_id_i_d, DRIVE_ID_ND, x), q = drive_id_cell(drive_id_i_q, DRIVE_ID_NQ, y);
    drive_id_real along_d[4], along_q[4], sum = 0;
    int j, k;
    if (x != x || y != y) {
        return DRIVE_ID_NAN;
    }
    drive_id_cubic(drive_id_i_d, DRIVE_ID_ND, d, x, along_d);
    drive_id_cubic(drive_id_i_q, DRIVE_ID_NQ, q, y, along_q);
    for (j = 0; j < 4; j++) {
        drive_id_real line = 0;
        if (along_d[j] == 0) {
            continue;
        }
        for (k = 0; k < 4; k++) {
            if (along_q[k] != 0) {
                line += along_q[k] * table[(d - 1 + j) * DRIVE_ID_NQ + q - 1 + k];
            }
        }
        sum += along_d[j] * line;
    }
    return sum == sum ? sum : drive_id_bilinear(table, i_d, i_q);
}

static inline drive_id_real drive_id_psi_d(drive_id_real i_d, drive_id_real i_q)
{
    return drive_id_bilinear(drive_id_psi_d_table, i_d, i_q);
}

static inline drive_id_real drive_id_psi_q(drive_id_real i_d, drive_id_real i_q)
{
    return drive_id_bilinear(drive_id_psi_q_table, i_d, i_q);
}

static inline drive_id_real drive_id_psi_d_bicubic(drive_id_real i_d, drive_id_real i_q)
{
    return drive_id_bicubic(drive_id_psi_d_table, i_d, i_q);
}

static inline drive_id_real drive_id_psi_q_bicubic(drive_id_real i_d, drive_id_real i_q)
{
    return drive_id_bicubic(drive_id_psi_q_table, i_d, i_q);
}

/* Gains, V/A, from the inductances of the nearest monotone map: finite and positive everywhere, also without data. */
static inline drive_id_real drive_id_kp_d(drive_id_real i_d, drive_id_real i_q)
{
    return DRIVE_ID_BANDWIDTH * drive_id_bilinear(drive_id_l_dd_table, i_d, i_q);
}

static inline drive_id_real drive_id_kp_q(drive_id_real i_d, drive_id_real i_q)
{
    return DRIVE_ID_BANDWIDTH * drive_id_bilinear(drive_id_l_qq_table, i_d, i_q);
}

/* Stationary voltage, V, at electrical speed omega, rad/s, and resistance r, ohm; add the drop of each phase. */
static inline void drive_id_feedforward(drive_id_real i_d, drive_id_real i_q, drive_id_real omega, drive_id_real r,
                                        drive_id_real u_dq[2])
{
    u_dq[0] = r * i_d - omega * drive_id_psi_q(i_d, i_q);
    u_dq[1] = r * i_q + omega * drive_id_psi_d(i_d, i_q);
}

/* Drop of an inverter phase, V, at its current, A; constant beyond the table. */
static inline drive_id_real drive_id_drop(drive_id_real i)
{
    const drive_id_real x = drive_id_clamp(drive_id_drop_current, DRIVE_ID_NC, i);
    const int k = drive_id_cell(drive_id_drop_current, DRIVE_ID_NC, x);
    const drive_id_real t = (x - drive_id_drop_current[k]) / (drive_id_drop_current[k + 1] - drive_id_drop_current[k]);
    return x == x ? drive_id_mix(drive_id_drop_voltage[k], drive_id_drop_voltage[k + 1], t) : 0;
}

/* psi_d - L_q i_d with the apparent L_q, Wb: what a sensorless observer turns with; i_q must not be 0. */
static inline drive_id_real drive_id_active_flux(drive_id_real i_d, drive_id_real i_q)
{
    return drive_id_psi_d(i_d, i_q) - drive_id_psi_q(i_d, i_q) / i_q * i_d;
}

#ifdef DRIVE_ID_RESISTANCE
/* Resistance, ohm, of the winding at a temperature, degrees Celsius. */
static inline drive_id_real drive_id_resistance(drive_id_real celsius)
{
    return DRIVE_ID_RESISTANCE * (1 + DRIVE_ID_COPPER * (celsius - DRIVE_ID_RESISTANCE_CELSIUS));
}
#endif

/* Change of psi_d, Wb, with the temperature of the magnet, degrees Celsius; 0 where none was identified. */
static inline drive_id_real drive_id_magnet(drive_id_real celsius)
{
    return DRIVE_ID_MAGNET_SLOPE * (celsius - DRIVE_ID_MAGNET_CELSIUS);
}

/* Whether the map has data at a current within the cells of its mask. */
static inline int drive_id_known(drive_id_real i_d, drive_id_real i_q)
{
    int k;
    if (!(i_d >= drive_id_known_d[0] && i_d <= drive_id_known_d[DRIVE_ID_KD - 1] && i_q >= drive_id_known_q[0] &&
          i_q <= drive_id_known_q[DRIVE_ID_KQ - 1])) {
        return 0;
    }
    k = drive_id_cell(drive_id_known_d, DRIVE_ID_KD, i_d) * (DRIVE_ID_KQ - 1) +
        drive_id_cell(drive_id_known_q, DRIVE_ID_KQ, i_q);
    return drive_id_known_bits[k >> 3] >> (k & 7) & 1;
}

/*
 * 1 within the axes where the map rests on data, as "inside" of drive-id analyze; 0 elsewhere, and for NaN. Near i_max,
 * which an experiment just reaches, the current that is one cell nearer to zero decides.
 */
static inline int drive_id_inside(drive_id_real i_d, drive_id_real i_q)
{
    const drive_id_real size = drive_id_sqrt(i_d * i_d + i_q * i_q), most = DRIVE_ID_C(1.001) * DRIVE_ID_I_MAX;
    const drive_id_real slack = most - DRIVE_ID_I_MAX;
    if (!(i_d >= drive_id_i_d[0] - slack && i_d <= drive_id_i_d[DRIVE_ID_ND - 1] + slack &&
          i_q >= drive_id_i_q[0] - slack && i_q <= drive_id_i_q[DRIVE_ID_NQ - 1] + slack)) {
        return 0;
    }
    if (size > DRIVE_ID_I_MAX - DRIVE_ID_CELL && size <= most) {
        const drive_id_real share = size > DRIVE_ID_CELL ? 1 - DRIVE_ID_CELL / size : 0;
        return drive_id_known(share * i_d, share * i_q);
    }
    return drive_id_known(i_d, i_q);
}

#endif
