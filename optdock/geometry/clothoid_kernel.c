/* Clothoid splines: `_table` and `_poses` of `clothoid.py` in C.
 *
 * Sums and products are evaluated in the order of the twins, with the sines and cosines of the C library; where NumPy
 * uses the same, results are equal to the last bit. Certificates depend on this file, as they do on its twin. */

#include <math.h>
#include <stdint.h>

enum { POINTS = 5 }; /* of the quadrature */

/* A break of a spline and the state there; `rate` is the curvature rate [1/m^2] up to the next break. */
typedef struct {
    double s, x, y, yaw, curvature, rate;
} Break;

/* Minimum and maximum that are NaN if the first value is. */
static double least(double a, double b) { return a < b || a != a ? a : b; }

static double most(double a, double b) { return a > b || a != a ? a : b; }

/* The integrals of the cosine and the sine of the quadratic heading over a step. quadrature: places in halves of the
 * step, from its begin, and weights. */
static void displacement(double step, const Break *from, const double *quadrature, double *along, double *across)
{
    double half = 0.5 * step, cosines = 0.0, sines = 0.0;
    for (int i = 0; i < POINTS; i++) {
        double u = half * quadrature[i], theta = from->yaw + u * (from->curvature + 0.5 * u * from->rate);
        double c = quadrature[POINTS + i] * cos(theta), s = quadrature[POINTS + i] * sin(theta);
        cosines = i == 0 ? c : cosines + c;
        sines = i == 0 ? s : sines + s;
    }
    *along = half * cosines;
    *across = half * sines;
}

/* Parts of a span between two knots, such that none turns by more than `turned`; `most_parts` + 1 if there are more. */
static double parts_of(double step, double before, double after, double turned, int64_t most_parts)
{
    double turn = step * (fabs(before) > fabs(after) ? fabs(before) : fabs(after));
    return ceil(least(most(turn / turned, 1.0), (double)most_parts + 1.0));
}

/* Breaks of a spline and the states there.
 *
 *   n           knots; knots, curvature: (n,) [m, 1/m]
 *   room        rows of the table
 *   most_parts  largest number of parts
 *   x, y, yaw   pose at s = 0; sign: +1 forward, -1 reverse; turned: most turn of a part [rad]
 *   quadrature  see `displacement`
 *   table       out, (room, 6), see `Break`
 *
 * Return the number of breaks, which may exceed `room`; the table is written only if it does not. Return -1 if there
 * are more than `most_parts` parts. */
int64_t optdock_clothoid_table(int64_t n, int64_t room, int64_t most_parts, double x, double y, double yaw, double sign,
                               double turned, const double *knots, const double *curvature, const double *quadrature,
                               double *table)
{
    Break *at = (Break *)table;
    int64_t count = 1;
    for (int64_t i = 0; i < n - 1; i++) {
        double parts = parts_of(knots[i + 1] - knots[i], curvature[i], curvature[i + 1], turned, most_parts);
        if (!(parts <= (double)(most_parts + 1 - count)))
            return -1;
        count += (int64_t)parts;
    }
    if (count > room)
        return count;
    for (int64_t i = 0; i < n - 1; i++) {
        double step = knots[i + 1] - knots[i], rise = (curvature[i + 1] - curvature[i]) / step;
        double parts = parts_of(step, curvature[i], curvature[i + 1], turned, most_parts);
        for (double rank = 0.0; rank < parts; rank += 1.0, at++) {
            at->s = knots[i] + step * rank / parts;
            at->curvature = rank == 0.0 ? curvature[i] : rise * (at->s - knots[i]) + curvature[i];
        }
    }
    at->s = knots[n - 1];
    at->curvature = curvature[n - 1];
    at->rate = 0.0;
    at = (Break *)table;
    double right = 0.0, up = 0.0, turn = 0.0;
    for (int64_t i = 0; i < count; i++, at++) {
        at->x = right + x;
        at->y = up + y;
        at->yaw = turn + yaw;
        if (i == count - 1)
            break;
        double step = at[1].s - at->s, along, across;
        at->rate = (at[1].curvature - at->curvature) / step;
        displacement(step, at, quadrature, &along, &across);
        turn = i == 0 ? 0.5 * step * (at->curvature + at[1].curvature)
                      : turn + 0.5 * step * (at->curvature + at[1].curvature);
        right = i == 0 ? sign * along : right + sign * along;
        up = i == 0 ? sign * across : up + sign * across;
    }
    return count;
}

/* Poses at arc lengths, clipped to the spline.
 *
 *   n, count    numbers of arc lengths and of breaks
 *   sign        +1 forward, -1 reverse
 *   s           (n,) [m]; table: (count, 6), see `Break`; quadrature: see `displacement`
 *   poses       out, (n, 3) */
int64_t optdock_clothoid_poses(int64_t n, int64_t count, double sign, const double *s, const double *table,
                               const double *quadrature, double *poses)
{
    const Break *breaks = (const Break *)table;
    for (int64_t i = 0; i < n; i++) {
        double at = least(most(s[i], 0.0), breaks[count - 1].s), along, across;
        int64_t low = 0, high = count - 2; /* the last break that is not behind, but not the end */
        while (low < high) {
            int64_t middle = (low + high + 1) / 2;
            if (at < breaks[middle].s)
                high = middle - 1;
            else
                low = middle;
        }
        const Break *from = breaks + low;
        double step = at - from->s;
        displacement(step, from, quadrature, &along, &across);
        poses[3 * i] = from->x + sign * along;
        poses[3 * i + 1] = from->y + sign * across;
        poses[3 * i + 2] = from->yaw + step * (from->curvature + 0.5 * step * from->rate);
    }
    return 0;
}
