/* First guesses of the smoother: the pure pursuit of one gear and the least squares of tracking, the functions
 * `_drive_of`, `tracked_path` and `linearized_tracking` of `initial_guess.py` in C.
 *
 * Operations are evaluated in the order of the twins, with the functions of the C library. A search for a path uses the
 * results as its beginning; the certificate does not. */

#include <math.h>
#include <stdint.h>

int64_t optdock_roll_out(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals, const double *packed,
                         const int64_t *divisions, const double *given, double *out, double *work);
int64_t optdock_sensitivity(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals, const double *packed,
                            const int64_t *divisions, const double *z, const double *moved, double *out, double *work);

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

/* ---- Tracking (S22) ---- */

/* A node of the input: position, normal, and weights of the squared distances across and along the input. */
typedef struct {
    double x, y, normal_x, normal_y, weights[2];
} Node;

/* The axis across the input (0) or along it (1). */
static Vector axis_of(const Node *node, int axis)
{
    return axis == 0 ? (Vector){node->normal_x, node->normal_y} : (Vector){-node->normal_y, node->normal_x};
}

/* Compute a path and its merit.
 *
 *   gears, knots, nodes, intervals, basis, divisions   see `optdock_roll_out`
 *   smoothness, goal      weights of the squared curvature rate and of the error at the goal
 *   reference   see `Node`, (nodes, 6)
 *   stiffness   (knots, knots), see `Basis`
 *   given       curvatures and lengths (knots + gears,), start pose (3,), signs (gears,)
 *   target      pose, (3,)
 *   out         out, roll-out (4 nodes + 6 intervals,) and merit
 *   work        (knots,) */
int64_t optdock_track(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals, double smoothness, double goal,
                      const double *basis, const int64_t *divisions, const double *reference, const double *stiffness,
                      const double *given, const double *target, double *out, double *work)
{
    const double *z = given, *poses = out;
    optdock_roll_out(gears, knots, nodes, intervals, basis, divisions, given, out, work);
    const Node *input = (const Node *)reference;
    double squares[2] = {0.0, 0.0}, slopes = 0.0, missed = 0.0;
    for (int axis = 0; axis < 2; axis++) {
        for (int64_t k = 0; k < nodes; k++) {
            Vector along = axis_of(input + k, axis);
            double residual = along.x * (poses[3 * k] - input[k].x) + along.y * (poses[3 * k + 1] - input[k].y);
            squares[axis] += input[k].weights[axis] * (residual * residual);
        }
    }
    for (int64_t m = 0, i = 0; m < gears; m++) {
        for (int64_t end = i + divisions[2 * m]; i <= end; i++) {
            double slope = 0.0;
            for (int64_t j = 0; j < knots; j++)
                slope += stiffness[i * knots + j] * z[j];
            slopes += z[i] * slope / z[knots + m];
        }
    }
    for (int i = 0; i < 3; i++)
        missed += fabs(poses[3 * (nodes - 1) + i] - target[i]);
    out[4 * nodes + 6 * intervals] = squares[0] + squares[1] + smoothness * slopes + goal * missed;
    return 0;
}

/* Write the gradient and the Gauss-Newton Hessian of the merit without the error at the goal.
 *
 *   nodes ... stiffness   as above
 *   z            curvatures and lengths, (size,) = (knots + gears,)
 *   poses        (nodes, 3)
 *   by_x, by_y   derivatives of the positions, (nodes, size)
 *   out          out, gradient (size,) and Hessian (size, size)
 *   work         of the size of `out`, and (size,) */
static void write_model(int64_t nodes, int64_t knots, int64_t gears, double smoothness, const double *reference,
                        const int64_t *divisions, const double *stiffness, const double *z, const double *poses,
                        const double *by_x, const double *by_y, double *out, double *work)
{
    const Node *input = (const Node *)reference;
    int64_t size = knots + gears;
    double *gradient = out, *hessian = out + size, *sum = work, *squares = sum + size, *moved = squares + size * size;
    for (int64_t i = 0; i < size + size * size; i++)
        out[i] = 0.0;
    for (int64_t i = 0; i < knots; i++) {
        for (int64_t m = 0, j = 0; m < gears; m++) {
            for (int64_t end = j + divisions[2 * m]; j <= end; j++) {
                double bend = smoothness / z[knots + m] * stiffness[i * knots + j];
                gradient[i] += bend * z[j];
                hessian[i * size + j] = 2.0 * bend;
            }
        }
        gradient[i] *= 2.0;
    }
    for (int axis = 0; axis < 2; axis++) {
        for (int64_t i = 0; i < size + size * size; i++)
            work[i] = 0.0;
        for (int64_t k = 0; k < nodes; k++) {
            const double *x = by_x + k * size, *y = by_y + k * size;
            Vector along = axis_of(input + k, axis);
            double residual = along.x * (poses[3 * k] - input[k].x) + along.y * (poses[3 * k + 1] - input[k].y);
            double weight = input[k].weights[axis], weighted = weight * residual;
            for (int64_t i = 0; i < size; i++) {
                moved[i] = along.x * x[i] + along.y * y[i];
                sum[i] += weighted * moved[i];
                if (moved[i] == 0.0) /* of all variables that act later on the path */
                    continue;
                for (int64_t j = 0; j <= i; j++)
                    squares[i * size + j] += weight * (moved[i] * moved[j]);
            }
        }
        for (int64_t i = 0; i < size; i++) {
            gradient[i] += 2.0 * sum[i];
            for (int64_t j = 0; j < size; j++)
                hessian[i * size + j] += 2.0 * (j <= i ? squares[i * size + j] : squares[j * size + i]);
        }
    }
}

/* Linearize at a path, without clearance.
 *
 *   gears ... stiffness   as above
 *   trusted     number of nodes whose headings the trust region bounds, and these nodes, (trusted,)
 *   z           curvatures and lengths, (size,) = (knots + gears,)
 *   rollout     of z, see `Rollout.packed`
 *   out         out, see `Linearization.values`
 *   work        (3, nodes, size), then the larger of 4 size and size (size + 2) */
int64_t optdock_track_linearized(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals, int64_t trusted,
                                 double smoothness, const double *basis, const int64_t *divisions,
                                 const double *reference, const double *stiffness, const int64_t *trusted_nodes,
                                 const double *z, const double *rollout, const double *target, double *out,
                                 double *work)
{
    int64_t size = knots + gears, square = size * size, last = nodes - 1;
    double *error = out + size, *gradient = error + 3, *motion = gradient + size + square;
    double *jacobian = motion + square, *headings = jacobian + 3 * size, *next = work + 3 * nodes * size;
    optdock_sensitivity(gears, knots, nodes, intervals, basis, divisions, z, rollout + 4 * nodes + 2 * intervals, work,
                        next);
    write_model(nodes, knots, gears, smoothness, reference, divisions, stiffness, z, rollout, work,
                work + nodes * size, gradient, next);
    for (int64_t i = 0; i < 3; i++)
        error[i] = rollout[3 * last + i] - target[i];
    for (int64_t j = 0; j < size; j++) {
        out[j] = z[j];
        for (int64_t i = 0; i < size; i++)
            motion[i * size + j] = i == j;
        for (int64_t i = 0; i < 3; i++)
            jacobian[i * size + j] = work[(i * nodes + last) * size + j];
        for (int64_t i = 0; i < trusted; i++)
            headings[i * size + j] = work[(2 * nodes + trusted_nodes[i]) * size + j];
    }
    return 0;
}
