/* The pure pursuit of one gear: the function `_drive_of` of `initial_guess.py` in C.
 *
 * Operations are evaluated in the order of the twin, with the functions of the C library. A search for a path uses the
 * result as a first guess; the certificate does not. */

#include <math.h>
#include <stdint.h>

static const double PI = 3.14159265358979323846;

typedef struct {
    double x, y;
} Vector;

/* Points of the input and their arc lengths, pursued at equal steps, and the direction of the straight line beyond. */
typedef struct {
    const double *points, *away;
    int64_t points_count, inside, count; /* number of steps inside the input, and with the line beyond */
    double step;
    Vector beyond;
} Line;

static Vector point_at(const Line *line, int64_t i)
{
    int64_t low = 0, high = line->points_count - 1;
    const double *last = line->points + 2 * high;
    if (i >= line->inside) {
        double along = (double)(i - line->inside) * line->step;
        return (Vector){last[0] + along * line->beyond.x, last[1] + along * line->beyond.y};
    }
    double s = (double)i * line->step;
    if (!(s < line->away[high]))
        return (Vector){last[0], last[1]};
    while (high - low > 1) {
        int64_t middle = (low + high) / 2;
        if (s < line->away[middle])
            high = middle;
        else
            low = middle;
    }
    const double *p = line->points + 2 * low, width = line->away[low + 1] - line->away[low];
    double along = s - line->away[low];
    return (Vector){(p[2] - p[0]) / width * along + p[0], (p[3] - p[1]) / width * along + p[1]};
}

/* The index of the next local minimum of the distance from `place`, starting at `nearest`. */
static int64_t advanced(const Line *line, int64_t nearest, Vector place)
{
    Vector p = point_at(line, nearest);
    double best = hypot(p.x - place.x, p.y - place.y);
    for (; nearest + 1 < line->count; nearest++) {
        p = point_at(line, nearest + 1);
        double following = hypot(p.x - place.x, p.y - place.y);
        if (following > best)
            break;
        best = following;
    }
    return nearest;
}

static double bounded(double value, double lower, double upper)
{
    value = lower > value ? lower : value;
    return upper < value ? upper : value;
}

/* Drive one gear by pure pursuit.
 *
 *   points_count, inside, beyond   numbers of points, and of steps inside the input and on the line beyond it
 *   ahead, most                    lookahead distance and largest length of the drive in steps
 *   cells       number of intervals
 *   sign        gear
 *   angle       direction of the line beyond the input [rad]
 *   limit, rate   largest curvature [1/m] and its largest change per step [1/m]
 *   step        [m]
 *   points      (points_count, 2) [m]
 *   away        their arc lengths, (points_count,) [m]
 *   pose        in: start, out: last pose, (3,)
 *   headings    out, yaws at the middles of the intervals, (cells,) [rad]
 *   driven      work, (most + 1,)
 *
 * Return the number of steps driven. */
int64_t optdock_pursue(int64_t points_count, int64_t inside, int64_t beyond, int64_t ahead, int64_t most, int64_t cells,
                       double sign, double angle, double limit, double rate, double step, const double *points,
                       const double *away, double *pose, double *headings, double *driven)
{
    Line line = {points, away, points_count, inside, inside + beyond, step, {cos(angle), sin(angle)}};
    double yaw = pose[2], kappa = 0.0, back = sign > 0.0 ? 0.0 : PI;
    Vector place = {pose[0], pose[1]};
    int64_t count = 0, nearest = 0, end = inside > 1 ? inside : 1;
    driven[0] = yaw;
    for (; count < most; count++) {
        nearest = advanced(&line, nearest, place);
        if (nearest >= end && count > 3)
            break;
        Vector target = point_at(&line, nearest + ahead < line.count ? nearest + ahead : line.count - 1);
        double dx = target.x - place.x, dy = target.y - place.y, c = cos(yaw + back), s = sin(yaw + back);
        double along = dx * c + dy * s, across = dy * c - dx * s, distance = hypot(dx, dy);
        distance = 1e-6 > distance ? 1e-6 : distance;
        double wanted = along > 0.0 ? 2.0 * across / (distance * distance) : copysign(limit, across);
        kappa = bounded(bounded(wanted, kappa - rate, kappa + rate), -limit, limit);
        double middle = yaw + 0.5 * kappa * step;
        place = (Vector){place.x + sign * step * cos(middle), place.y + sign * step * sin(middle)};
        yaw += kappa * step;
        driven[count + 1] = yaw;
    }
    for (int64_t k = 0; k < cells; k++) {
        double at = ((double)k + 0.5) / (double)cells * (double)count;
        int64_t i = (int64_t)at;
        headings[k] = i < count ? (driven[i + 1] - driven[i]) * (at - (double)i) + driven[i] : driven[count];
    }
    pose[0] = place.x;
    pose[1] = place.y;
    pose[2] = yaw;
    return count;
}
