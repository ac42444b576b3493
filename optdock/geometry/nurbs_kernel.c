/* Points and directions of B-splines: `_poses_at` of `nurbs.py` in C.
 *
 * Sums and products are evaluated in the order of the twin, which also uses the arc tangent of the C library, so the
 * results are equal to the last bit. Only guesses depend on this file; the certificate has code of its own. */

#include <math.h>
#include <stdint.h>

/* The point of a planar B-spline with n control points at u by repeated linear interpolation ([DeBoor1978] ch. X,
 * algorithm 8). work: (degree + 1, 2); found: out, (2,). */
static void point_at(double u, int64_t n, int64_t degree, const double *knots, const double *points, double *work,
                     double *found)
{
    int64_t span = degree;
    while (span < n - 1 && knots[span + 1] <= u)
        span++;
    for (int64_t k = 0; k < 2 * (degree + 1); k++)
        work[k] = points[2 * (span - degree) + k];
    for (int64_t r = 1; r <= degree; r++) {
        for (int64_t j = 0; j <= degree - r; j++) {
            const double *left = knots + span + r - degree + j, *right = left + degree + 1 - r;
            double share = (u - *left) / (*right - *left);
            for (int64_t k = 0; k < 2; k++)
                work[2 * j + k] = (1.0 - share) * work[2 * j + k] + share * work[2 * (j + 1) + k];
        }
    }
    found[0] = work[0];
    found[1] = work[1];
}

/* Points of a planar B-spline, and the directions of its first derivative, which is a B-spline as well ([Piegl1997]
 * eq. 3.3), in (-pi, pi]; NaN where it is zero.
 *
 *   m, n, degree   numbers of parameters and of control points, n > degree >= 1
 *   u              (m,), parameters, clipped to [0, 1]
 *   knots          (n + degree + 1,), ascending
 *   points         (n, 2), control points [m]
 *   work           (n + degree, 2)
 *   poses          out, (m, 3) [m, m, rad]
 *   stays          out, (m,), rows of the poses without a direction
 *
 * Return the number of poses without a direction. */
int64_t optdock_spline_poses(int64_t m, int64_t n, int64_t degree, const double *u, const double *knots,
                             const double *points, double *work, double *poses, int64_t *stays)
{
    double *others = work + 2 * (degree + 1), slope[2]; /* control points of the derivative */
    int64_t count = 0;
    for (int64_t k = 0; k < 2 * (n - 1); k++)
        others[k] = (double)degree * (points[k + 2] - points[k]) / (knots[k / 2 + degree + 1] - knots[k / 2 + 1]);
    for (int64_t i = 0; i < m; i++) {
        double at = u[i] < 0.0 ? 0.0 : u[i] > 1.0 ? 1.0 : u[i];
        point_at(at, n, degree, knots, points, work, poses + 3 * i);
        point_at(at, n - 1, degree - 1, knots + 1, others, work, slope);
        double yaw = slope[0] == 0.0 && slope[1] == 0.0 ? NAN : atan2(slope[1], slope[0]);
        poses[3 * i + 2] = yaw == -3.141592653589793 ? 3.141592653589793 : yaw;
        if (yaw != yaw)
            stays[count++] = i;
    }
    return count;
}
