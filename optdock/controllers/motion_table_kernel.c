/* A trajectory at a few times: the function `evaluated` of `motion_table.py` in C.
 *
 * Sines and cosines are those of the C library, so the results are equal to those of the twin up to rounding. Control
 * cycles use them; neither search nor proof does. */

#include <math.h>
#include <stdint.h>

enum { PHASE = 5, CELL = 7, NODES = 5, COLUMNS = 10 };

/* The last of `count` rows, in columns of increasing first element, whose first element is at most `value`; or the
 * first row. */
static const double *row_at(const double *rows, int64_t count, int64_t columns, double value)
{
    int64_t low = 0, high = count;
    while (high - low > 1) {
        int64_t middle = low + (high - low) / 2;
        if (rows[middle * columns] <= value)
            low = middle;
        else
            high = middle;
    }
    return rows + low * columns;
}

static double clipped(double value, double most)
{
    value = value < 0.0 ? 0.0 : value;
    return value > most ? most : value;
}

/* Evaluate the motion at `n` times.
 *
 *   n, phases, cells   sizes
 *   duration, length   ends of the time law [s] and of the path [m]
 *   table              (5 phases + 7 cells + 10,), see the twin
 *   times              (n,)
 *   out                out, (n, 10)
 *
 * Return n, or -1 without a phase or a cell. */
int64_t optdock_motion_table(int64_t n, int64_t phases, int64_t cells, double duration, double length,
                             const double *table, const double *times, double *out)
{
    const double *path = table + PHASE * phases, *places = path + CELL * cells, *weights = places + NODES;
    if (phases < 1 || cells < 1)
        return -1;
    for (int64_t i = 0; i < n; i++) {
        double time = clipped(times[i], duration), *row = out + COLUMNS * i;
        const double *phase = row_at(table, phases, PHASE, time);
        double t = time - phase[0], gain = t * phase[4];
        double s = clipped(phase[1] + t * (phase[2] + t * (0.5 * phase[3] + gain / 6.0)), length);
        double v = phase[2] + t * (phase[3] + 0.5 * gain), a = phase[3] + gain;
        const double *cell = row_at(path, cells, CELL, s);
        double step = s - cell[0], half = 0.5 * step, along = 0.0, across = 0.0;
        double kappa = cell[4], rate = cell[5], gear = cell[6], curvature = kappa + step * rate;
        for (int64_t k = 0; k < NODES; k++) {
            double u = half * places[k], theta = cell[3] + u * (kappa + 0.5 * u * rate);
            along += weights[k] * cos(theta);
            across += weights[k] * sin(theta);
        }
        row[0] = s;
        row[1] = cell[1] + gear * (half * along);
        row[2] = cell[2] + gear * (half * across);
        row[3] = cell[3] + step * (kappa + 0.5 * step * rate);
        row[4] = gear * v;
        row[5] = gear * a;
        row[6] = v * curvature;
        row[7] = a * curvature + v * v * rate;
        row[8] = gear;
        row[9] = curvature;
    }
    return n;
}
