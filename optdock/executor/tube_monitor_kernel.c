/* Lower bound of the distance of a pose outside of the tube: the function `least_excess` of `tube_monitor.py` in C. */

#include <math.h>
#include <stdint.h>

enum { PARTS = 8 }; /* of an interval that may be inside the tube */

/* Lower bound of the displacement from the poses between two sampled ones, from the share `low` to the share `high`,
 * where position and yaw are linear. */
static double displacement(const double *begin, const double *end, double low, double high, const double *pose,
                           double radius)
{
    double dx = end[0] - begin[0], dy = end[1] - begin[1], off_x = pose[0] - begin[0], off_y = pose[1] - begin[1];
    double square = dx * dx + dy * dy, share = square > 0.0 ? (off_x * dx + off_y * dy) / square : 0.0;
    share = share < low ? low : share > high ? high : share;
    off_x -= share * dx;
    off_y -= share * dy;
    double yaw = begin[2] - pose[2], turn = end[2] - begin[2];
    double first = sin(0.5 * (yaw + low * turn)), second = sin(0.5 * (yaw + high * turn));
    double turned = first * second > 0.0 ? fmin(fabs(first), fabs(second)) : 0.0;
    return sqrt(off_x * off_x + off_y * off_y) + 2.0 * radius * turned;
}

/* The least excess over n intervals of the path.
 *
 *   x, y, yaw, radius   the pose, and the radius of the footprint [m]
 *   samples             (n + 1, 4): x, y, yaw of sampled poses; of the interval that begins there, the bound of the
 *                       tube's width and of the displacement from linear motion [m]
 *   out                 out, (1,) [m]
 *
 * Return n. */
int64_t optdock_least_excess(int64_t n, double x, double y, double yaw, double radius, const double *samples,
                             double *out)
{
    double least = INFINITY, pose[3] = {x, y, yaw};
    for (int64_t i = 0; i < n; i++) {
        const double *begin = samples + 4 * i, *end = begin + 4;
        double excess = displacement(begin, end, 0.0, 1.0, pose, radius) - begin[3];
        if (excess <= 0.0) {
            excess = INFINITY;
            for (int p = 0; p < PARTS; p++)
                excess = fmin(excess, displacement(begin, end, p / (double)PARTS, (p + 1) / (double)PARTS, pose, radius));
            excess -= begin[3];
        }
        if (!(excess >= least))
            least = excess;
    }
    out[0] = least;
    return n;
}
