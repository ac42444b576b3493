/* Lower bound of the distance of a pose outside of the tube: the function `least_excess` of `tube_monitor.py` in C. */

#include <math.h>
#include <stdint.h>

/* The least excess over n intervals of the path.
 *
 *   x, y, yaw, radius   the pose, and the radius of the footprint [m]
 *   samples             (n + 1, 5): x, y, yaw of sampled poses; of the interval that begins there, the bound of its
 *                       distance from the straight line to the next pose, and of the width of the tube [m]
 *   out                 out, (1,) [m]
 *
 * Return n. */
int64_t optdock_least_excess(int64_t n, double x, double y, double yaw, double radius, const double *samples,
                             double *out)
{
    double least = INFINITY;
    for (int64_t i = 0; i < n; i++) {
        const double *begin = samples + 5 * i, *end = begin + 5;
        double dx = end[0] - begin[0], dy = end[1] - begin[1], off_x = x - begin[0], off_y = y - begin[1];
        double square = dx * dx + dy * dy, share = square > 0.0 ? (off_x * dx + off_y * dy) / square : 0.0;
        share = share < 0.0 ? 0.0 : share > 1.0 ? 1.0 : share;
        off_x -= share * dx;
        off_y -= share * dy;
        double first = sin(0.5 * (begin[2] - yaw)), second = sin(0.5 * (end[2] - yaw));
        double turned = first * second > 0.0 ? fmin(fabs(first), fabs(second)) : 0.0;
        double excess = sqrt(off_x * off_x + off_y * off_y) + 2.0 * radius * turned - begin[3] - begin[4];
        if (!(excess >= least))
            least = excess;
    }
    out[0] = least;
    return n;
}
