/* Points and derivatives of B-splines: `_spline_at` of `nurbs.py` in C.
 *
 * Sums and products are evaluated in the order of the twin, so the results are equal to the last bit. Only guesses
 * depend on this file; the certificate has code of its own. */

#include <math.h>
#include <stdint.h>

/* Points of a planar B-spline by repeated linear interpolation ([DeBoor1978] ch. X, algorithm 8); see `optdock_spline`.
 * work: (degree + 1, 2). */
static void set_points(int64_t m, int64_t n, int64_t degree, const double *u, const double *knots, const double *points,
                       double *work, double *found)
{
    for (int64_t i = 0; i < m; i++) {
        int64_t span = degree;
        while (span < n - 1 && knots[span + 1] <= u[i])
            span++;
        for (int64_t k = 0; k < 2 * (degree + 1); k++)
            work[k] = points[2 * (span - degree) + k];
        for (int64_t r = 1; r <= degree; r++) {
            for (int64_t j = 0; j <= degree - r; j++) {
                const double *left = knots + span + r - degree + j, *right = left + degree + 1 - r;
                double share = (u[i] - *left) / (*right - *left);
                for (int64_t k = 0; k < 2; k++)
                    work[2 * j + k] = (1.0 - share) * work[2 * j + k] + share * work[2 * (j + 1) + k];
            }
        }
        found[2 * i] = work[0];
        found[2 * i + 1] = work[1];
    }
}

/* Points of a planar B-spline and its first derivatives, which are a B-spline as well ([Piegl1997] eq. 3.3).
 *
 *   m, n, degree   numbers of parameters and of control points, n > degree
 *   u              (m,), parameters
 *   knots          (n + degree + 1,), ascending
 *   points         (n, 2), control points [m]
 *   work           (n + degree, 2)
 *   found, slopes  out, (m, 2) [m] */
int64_t optdock_spline(int64_t m, int64_t n, int64_t degree, const double *u, const double *knots, const double *points,
                       double *work, double *found, double *slopes)
{
    double *others = work + 2 * (degree + 1); /* control points of the derivative */
    set_points(m, n, degree, u, knots, points, work, found);
    for (int64_t k = 0; k < 2 * (n - 1) && degree > 0; k++)
        others[k] = (double)degree * (points[k + 2] - points[k]) / (knots[k / 2 + degree + 1] - knots[k / 2 + 1]);
    if (degree > 0)
        set_points(m, n - 1, degree - 1, u, knots + 1, others, work, slopes);
    for (int64_t k = 0; k < 2 * m && degree == 0; k++)
        slopes[k] = 0.0;
    return 0;
}
