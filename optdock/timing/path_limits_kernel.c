/* Limits along a clothoid spline: the function `_clothoid_table` of `path_limits.py` in C.
 *
 * Sums and products are evaluated in the order of the twin, so the results are equal to the last bit. A limit on the
 * lateral jerk needs cube roots, whose last bits depend on the library; the twin alone evaluates it. A search for a
 * motion uses this file; the certificate does not. */

#include <math.h>
#include <stdint.h>

/* Knots of the spline and their curvatures, (count,) each. */
typedef struct {
    const double *knots, *curvature;
    int64_t count;
} Spline;

/* Limits of the drive, infinite without a bound, or their reciprocals, with the slowness at the largest speed. */
typedef struct {
    double slowest, per_yaw_rate, per_lateral_acceleration, max_wheel_speed, track_width;
    double max_steering_rate, wheelbase, per_yaw_acceleration;
} Drive;

/* Columns of the table, by nodes (n,) or cells (n - 1,); see `PathLimits`. */
typedef struct {
    double *s, *left, *slope, *curvature, *rate_right, *slowness_left, *slowness_right, *steepest, *slowest;
} Columns;

static double most(double a, double b) { return a > b || a != a ? a : b; }

/* Index of the piece of the spline at s, searched from an earlier one. */
static int64_t piece_at(Spline of, double s, int64_t from)
{
    while (from + 2 < of.count && of.knots[from + 1] <= s)
        from++;
    return from;
}

static double rate_of(Spline of, int64_t piece)
{
    return (of.curvature[piece + 1] - of.curvature[piece]) / (of.knots[piece + 1] - of.knots[piece]);
}

/* Set the nodes s: the knots and the start of the zone, with equal steps between them; see `_nodes`. places: work,
 * (count + 1,). Return their number, or -1 if there are more than `room`. */
static int64_t set_nodes(Spline of, double spacing, double zone_start, int64_t room, double *places, double *s)
{
    double length = of.knots[of.count - 1], gap = 1e-12 * (length > 1.0 ? length : 1.0), before = of.knots[0];
    int64_t at = of.count, kept = 1, n = 0;
    while (at > 1 && of.knots[at - 1] > zone_start)
        at--;
    places[0] = before;
    for (int64_t i = 1; i <= of.count; i++) {
        double place = i < at ? of.knots[i] : i == at ? zone_start : of.knots[i - 1];
        if (place - before > gap)
            places[kept++] = place;
        before = place;
    }
    places[kept - 1] = length;
    for (int64_t i = 0; i + 1 < kept; i++) {
        double step = places[i + 1] - places[i], parts = ceil(step / spacing - 1e-9);
        parts = parts > 1.0 ? parts : 1.0;
        if (!(parts < (double)(room - n)))
            return -1;
        for (double rank = 0.0; rank < parts; rank += 1.0)
            s[n++] = places[i] + step * rank / parts;
    }
    s[n++] = length;
    return n;
}

/* The node that is nearest to a place. */
static double nearest_node(int64_t n, const double *s, double place)
{
    double found = s[0];
    for (int64_t i = 1; i < n; i++)
        if (fabs(s[i] - place) < fabs(found - place))
            found = s[i];
    return found;
}

/* Reciprocal of the lowest speed cap without the steering cap; see `SpeedCaps.slowness`. */
static double slowness_at(Drive drive, double curvature)
{
    double bend = fabs(curvature), found = most(drive.slowest, bend * drive.per_yaw_rate);
    if (drive.per_lateral_acceleration > 0.0)
        found = most(found, sqrt(bend * drive.per_lateral_acceleration));
    if (drive.max_wheel_speed < INFINITY)
        found = most(found, (1.0 + 0.5 * drive.track_width * bend) / drive.max_wheel_speed);
    return found;
}

/* A slowness at least that of the steering cap; see `SpeedCaps.steering_slowness`. */
static double with_steering(Drive drive, double slowness, double curvature, double rate)
{
    if (!(drive.max_steering_rate < INFINITY))
        return slowness;
    double tangent = drive.wheelbase * curvature;
    return most(slowness, drive.wheelbase * fabs(rate) / (1.0 + tangent * tangent) / drive.max_steering_rate);
}

/* Curvature at the nodes. */
static void set_curvature(Spline of, int64_t n, const double *s, double *curvature)
{
    int64_t piece = 0;
    double rate = rate_of(of, 0);
    for (int64_t i = 0; i < n - 1; i++) {
        int64_t next = piece_at(of, s[i], piece);
        rate = next > piece ? rate_of(of, next) : rate;
        piece = next;
        double along = s[i] - of.knots[piece];
        curvature[i] = along == 0.0 ? of.curvature[piece] : rate * along + of.curvature[piece];
    }
    curvature[n - 1] = of.curvature[of.count - 1];
}

/* Set the limits of all cells between the nodes; zone_start: a node, or the length without a zone. Return the time
 * along the maximum velocity curve. */
static double set_cells(Spline of, Drive drive, int64_t n, double zone_start, double zone_speed, Columns out)
{
    int64_t cells = n - 1, piece = 0;
    double time = 0.0, rate = rate_of(of, 0), in_zone = 1.0 / zone_speed, before = slowness_at(drive, out.curvature[0]);
    for (int64_t i = 0; i < cells; i++) {
        double first = out.curvature[i], last = out.curvature[i + 1], step = out.s[i + 1] - out.s[i];
        int64_t here = piece_at(of, out.s[i], piece), there = piece_at(of, out.s[i + 1] - 1e-7 * step, here);
        rate = here > piece ? rate_of(of, here) : rate;
        piece = here;
        int crosses = first * last < 0.0; /* the steering rate of a cell is largest at zero curvature */
        double next = there > here ? rate_of(of, there) : rate, after = slowness_at(drive, last);
        double left = with_steering(drive, before, crosses ? 0.0 : first, rate);
        double right = with_steering(drive, after, crosses ? 0.0 : last, next);
        double slow = out.s[i] >= zone_start ? in_zone : 0.0, begins[3] = {first, rate, most(left, slow)};
        double ends[3] = {last, next, most(right, slow)};
        for (int64_t j = 0; j < 3; j++) {
            out.left[j * cells + i] = begins[j];
            out.slope[j * cells + i] = (ends[j] - begins[j]) / step;
        }
        out.rate_right[i] = next;
        out.slowness_left[i] = left;
        out.slowness_right[i] = right;
        out.steepest[i] = most(fabs(rate), fabs(next));
        out.slowest[i] = most(begins[2], ends[2]);
        double turning = drive.per_yaw_acceleration > 0.0 ? sqrt(out.steepest[i] * drive.per_yaw_acceleration) : 0.0;
        time += step * most(out.slowest[i], turning);
        before = after;
    }
    return time;
}

/* Compute the limits along a clothoid spline with count >= 2 knots.
 *
 *   sizes      knots, most nodes
 *   numbers    largest distance of nodes [m], start of the zone in [0, length] [m], speed in it [m/s], limits of the
 *              drive
 *   knots      (count,), and their curvature (count,)
 *   table      out, see `PathLimits`, of 13 most + count - 8 numbers, of which the last are work
 *
 * Return the number of nodes, or -1 if there are too many or a size is wrong. */
int64_t optdock_path_limits(int64_t count, int64_t room, double spacing, double zone_start, double zone_speed,
                            double max_speed, double max_yaw_rate, double max_lateral_acceleration,
                            double max_wheel_speed, double track_width, double max_steering_rate, double wheelbase,
                            double max_yaw_acceleration, const double *knots, const double *curvature, double *table)
{
    if (count < 2 || room < 2)
        return -1;
    Spline of = {knots, curvature, count};
    Drive drive = {1.0 / max_speed, 1.0 / max_yaw_rate, 1.0 / max_lateral_acceleration, max_wheel_speed,
                   track_width,     max_steering_rate,  wheelbase,                      1.0 / max_yaw_acceleration};
    int64_t n = set_nodes(of, spacing, zone_start, room, table + 13 * room - 9, table), cells = n - 1;
    if (n < 0)
        return -1;
    double *left = table + n, *bend = left + 6 * cells, *next = bend + n, *end = next + 5 * cells;
    Columns out = {table,        left,             left + 3 * cells, bend, next, next + cells,
                   next + 2 * cells, next + 3 * cells, next + 4 * cells};
    set_curvature(of, n, table, bend);
    end[0] = nearest_node(n, table, zone_start);
    end[1] = set_cells(of, drive, n, end[0], zone_speed, out);
    return n;
}
