/* The reference program: the function `prepared` of `reference_program.py` in C, with profile, arcs and knots.
 *
 * The profile is (T5), arcs and knots are (T6), the maps of the spline (T7), and the constraints (T8) of
 * docs/theory/timing.md; the initial guess is the profile, averaged over time. Sums and products are evaluated in the order
 * of the twin, so the results are equal to the last bit. A search for a motion uses them; the certificate does not. */

#include <math.h>
#include <stdint.h>

enum { MOST_LIMITS = 2 }; /* turning limits */

/* In `interior_point_kernel.c`. */
int64_t optdock_interior_point(int64_t m, int64_t linear, int64_t curved, int64_t before, int64_t iterations,
                               double least_share, double gap, double residual, double to_boundary,
                               double largest_decrease, double long_step, double long_share, double middle_step,
                               double middle_share, double short_share, double smallest_slack, double first_gap,
                               const double *program, double *state, double *room);

/* Numbers of nodes, turning limits, jumps, and most cells. */
typedef struct {
    int64_t nodes, limits, jumps, room;
} Counts;

/* Bounds along the segment, by nodes (nodes,) or cells (nodes - 1,); see `PathLimits` and `ReferenceBounds`. */
typedef struct {
    const double *s, *left, *slope; /* places; curvature, rate and slowness at the left end of cells, and slopes: (3, .) */
    const double *curvature, *speed_squared, *ceiling, *steepest, *turning; /* turning: (limits, nodes - 1) */
    const double *rate_left, *rate_right, *slowness_left, *slowness_right;
    const int64_t *jumps;
} Bounds;

typedef struct {
    double s, v, a;
} State;

typedef struct {
    double acceleration, deceleration, full_jerk, jerk; /* jerk: with the margin of the reference */
    double step, zone_start;                            /* zone_start: infinite without a zone */
    double is_steered, first_cap;                       /* v^2 of the cap of the first cell */
    double orders[MOST_LIMITS], bounds[MOST_LIMITS];
} Case;

/* Constants of the twin, in its order. */
typedef struct {
    double slowest, arc_drive, arc_speed, arc_length, slow, hold, least_rest;
    double knot_jump, crowded, least_step, least_cells;
    double cruise_density, cruise_level, cruise_yaw, cruise_sample, cruise_reach;
    double guess_sample, guess_share, guess_blend, drive_share;
} Tuning;

/* (nodes,) each: v^2, pseudo time, and the pseudo time slowed down where the speed is constant. */
typedef struct {
    double *squared, *time, *clock;
} Profile;

static double least(double a, double b) { return a < b || a != a ? a : b; }

static double most(double a, double b) { return a > b || a != a ? a : b; }

/* Number of ascending values below x, or at most x. */
static int64_t number_below(const double *values, int64_t count, double x, int includes_equal)
{
    int64_t low = 0;
    while (low < count) {
        int64_t middle = low + (count - low) / 2;
        if (values[middle] < x || (includes_equal && values[middle] == x))
            low = middle + 1;
        else
            count = middle;
    }
    return low;
}

/* Interpolate (xp, fp), both (count,), as NumPy does. from: in and out, index from which the cell of x is searched. */
static double interpolated(double x, const double *xp, const double *fp, int64_t count, int64_t *from)
{
    if (x != x)
        return x;
    if (x > xp[count - 1])
        return fp[count - 1];
    if (x < xp[0])
        return fp[0];
    int64_t low = *from;
    while (low > 0 && !(x >= xp[low]))
        low--;
    while (low + 1 < count && x >= xp[low + 1])
        low++;
    *from = low;
    if (low == count - 1 || xp[low] == x)
        return fp[low];
    double slope = (fp[low + 1] - fp[low]) / (xp[low + 1] - xp[low]);
    double value = slope * (x - xp[low]) + fp[low];
    if (value != value) {
        value = slope * (x - xp[low + 1]) + fp[low + 1];
        if (value != value && fp[low] == fp[low + 1])
            value = fp[low];
    }
    return value;
}

static State after(double t, State from, double jerk)
{
    double gain = t * jerk;
    return (State){from.s + t * (from.v + t * (0.5 * from.a + gain / 6.0)), from.v + t * (from.a + 0.5 * gain),
                   from.a + gain};
}

/* The fastest speeds within acceleration limits; see `forward_backward_pass`. */
static void set_profile(Counts n, const Bounds *of, const Case *set, const Tuning *tuned, double v, Profile *out)
{
    double *x = out->squared, rise = 2.0 * set->acceleration, fall = 2.0 * set->deceleration, low = 0.0;
    for (int64_t i = 0; i < n.nodes; i++) {
        double own = least(i < n.nodes - 1 ? of->ceiling[i] : 0.0, i > 0 ? of->ceiling[i - 1] : v * v);
        own -= rise * of->s[i];
        low = i == 0 ? own : least(low, own);
        x[i] = low + rise * of->s[i];
    }
    for (int64_t i = n.nodes - 1; i >= 0; i--) {
        double own = x[i] + fall * of->s[i];
        low = i == n.nodes - 1 ? own : least(low, own);
        x[i] = most(low - fall * of->s[i], 0.0);
    }
    double before = sqrt(x[0]);
    out->time[0] = 0.0;
    for (int64_t i = 1; i < n.nodes; i++) {
        double speed = sqrt(x[i]), step = of->s[i] - of->s[i - 1];
        out->time[i] = out->time[i - 1] + 2.0 * step / most(before + speed, tuned->slowest);
        before = speed;
    }
}

/* Smallest speed at which the turning limits are reached at a rate, or `speed`. */
static double fastest(Counts n, const Case *set, double rate, double speed)
{
    for (int64_t l = 0; l < n.limits && rate > 0.0; l++) {
        double quotient = set->bounds[l] / rate;
        double limited = set->orders[l] == 1.0 ? sqrt(quotient) : pow(quotient, 1.0 / 3.0);
        speed = limited < speed ? limited : speed;
    }
    return speed;
}

/* Largest acceleration that the turning limits permit to an arc from speed v at |curvature| `bend`. */
static double arc_acceleration(Counts n, const Case *set, double v, double bend, double share)
{
    double found = INFINITY;
    for (int64_t l = 0; l < n.limits && bend > 0.0; l++) {
        double limited = share * set->bounds[l] / bend;
        if (set->orders[l] != 1.0) {
            double half = 0.5 * share * set->bounds[l], gained = pow(half * set->jerk / bend, 1.0 / 3.0);
            limited = v > 0.0 ? half / (2.0 * v * bend) : INFINITY;
            limited = gained < limited ? gained : limited;
        }
        found = limited < found ? limited : found;
    }
    return found;
}

/* End acceleration of an arc; see `_end_acceleration`. */
static double end_acceleration(Counts n, const Bounds *of, const Case *set, const Tuning *tuned, double drive, State from,
                               int is_at_end)
{
    double length = of->s[n.nodes - 1], jerk = set->jerk, top = tuned->arc_drive * drive;
    top = from.a > top ? from.a : top;
    double reach = after((top - from.a) / jerk, (State){0.0, from.v, from.a}, jerk).s;
    reach = 1e-9 > reach ? 1e-9 : reach;
    int64_t begin = 0, end = n.nodes;
    if (is_at_end) {
        begin = number_below(of->s, n.nodes, length - reach, 0) - 1;
        begin = begin < 0 ? 0 : begin;
    } else {
        end = number_below(of->s, n.nodes, reach, 0) + 1;
        end = end > n.nodes ? n.nodes : end;
    }
    double bend = 0.0, rate = 0.0, squared = INFINITY;
    for (int64_t i = begin; i < end; i++) {
        bend = most(bend, fabs(of->curvature[i]));
        if (i < n.nodes - 1) {
            rate = most(rate, of->steepest[i]);
            squared = least(squared, of->speed_squared[i]);
        }
    }
    double gained = jerk * (tuned->arc_speed * fastest(n, set, rate, sqrt(squared)) - from.v) + 0.5 * from.a * from.a;
    double limits[3] = {top, arc_acceleration(n, set, from.v, bend, tuned->arc_drive),
                        pow(6.0 * tuned->arc_length * length * jerk * jerk, 1.0 / 3.0)};
    double found = sqrt(gained > 0.0 ? gained : 0.0);
    for (int64_t i = 0; i < 3; i++)
        found = limits[i] < found ? limits[i] : found;
    return found;
}

/* Duration of the stop arc; last: out, the state at which it begins. */
static double stop_arc(Counts n, const Bounds *of, const Case *set, const Tuning *tuned, State *last)
{
    double jerk = set->jerk, a = end_acceleration(n, of, set, tuned, set->deceleration, (State){0.0, 0.0, 0.0}, 1);
    double time = a / jerk;
    *last = (State){of->s[n.nodes - 1] - jerk * pow(time, 3.0) / 6.0, 0.5 * jerk * time * time, -a};
    return time;
}

/* Duration of the launch arc, 0 if there is none; first: in, the start, and out, the state after the arc. */
static double launch_arc(Counts n, const Bounds *of, const Case *set, const Tuning *tuned, State *first, double *jerk)
{
    State start = *first;
    double a = end_acceleration(n, of, set, tuned, set->acceleration, start, 0), time;
    if (start.v * start.v >= tuned->slow * tuned->slow * set->first_cap)
        return 0.0;
    if (start.a < a) {
        time = (a - start.a) / set->jerk;
        *jerk = set->jerk;
    } else if (start.v < 0.5 * start.a * tuned->hold) {
        time = tuned->hold;
        *jerk = 0.0;
    } else {
        return 0.0;
    }
    *first = after(time, start, *jerk);
    return time;
}

/* Value of a turning limit's quantity at constant speed. */
static double at_constant_speed(double order, double squared, double rate)
{
    return rate * (order == 1.0 ? squared : squared * sqrt(squared));
}

/* Slow down the pseudo time; see `_cruise_clock`. x, spread: work, (samples,); size: work, (nodes,). */
static void set_clock(Counts n, const Bounds *of, const Case *set, const Tuning *tuned, int64_t samples, Profile *out,
                      double *x, double *spread, double *size)
{
    int64_t reach = (int64_t)tuned->cruise_reach;
    double total = out->time[n.nodes - 1], step = total / (double)(samples - 1), before = 0.0;
    int64_t at = 0;
    for (int64_t i = 0; i < samples; i++)
        x[i] = interpolated(i < samples - 1 ? (double)i * step : total, out->time, out->squared, n.nodes, &at);
    for (int64_t l = 0; l < n.limits; l++) {
        for (int64_t i = 1; i < n.nodes; i++)
            size[i] = at_constant_speed(set->orders[l], out->squared[i], of->steepest[i - 1]);
        at = 0;
        for (int64_t i = 0; i < samples; i++) {
            double t = i < samples - 1 ? (double)i * step : total;
            if (interpolated(t, out->time + 1, size + 1, n.nodes - 1, &at) > tuned->cruise_yaw * set->bounds[l])
                x[i] = 0.0;
        }
    }
    for (int64_t i = 0; i < samples; i++) {
        double low = x[i], high = x[i];
        for (int64_t k = i - reach; k <= i + reach; k++) {
            double value = k >= 0 && k < samples ? x[k] : 0.0;
            low = least(low, value);
            high = most(high, value);
        }
        double density = low > tuned->cruise_level * high ? tuned->cruise_density : 1.0;
        double t = i < samples - 1 ? (double)i * step : total, last = (double)(i - 1) * step;
        spread[i] = i == 0 ? 0.0 : spread[i - 1] + 0.5 * (before + density) * (t - last);
        before = density;
    }
    for (int64_t i = 0; i < samples; i++)
        x[i] = i < samples - 1 ? (double)i * step : total;
    at = 0;
    for (int64_t i = 0; i < n.nodes; i++)
        out->clock[i] = interpolated(out->time[i], x, spread, samples, &at);
}

/* Size of the jump at a node; see `_jump_sizes`. */
static double jump_size(Counts n, const Bounds *of, const Case *set, double squared, int64_t node)
{
    double size = 0.0;
    for (int64_t l = 0; l < n.limits; l++)
        size = most(size, at_constant_speed(set->orders[l], squared, fabs(of->rate_left[node] - of->rate_right[node - 1])) /
                              set->bounds[l]);
    if (set->is_steered != 0.0)
        size = most(size, sqrt(squared) * fabs(of->slowness_left[node] - of->slowness_right[node - 1]));
    return size;
}

/* Insert a value into ascending ones at an index. */
static void insert(double *values, int64_t count, int64_t at, double value)
{
    for (int64_t i = count; i > at; i--)
        values[i] = values[i - 1];
    values[at] = value;
}

/* Large jumps, ascending; out: nodes and places, (jumps,) each. */
static int64_t large_jumps(Counts n, const Bounds *of, const Case *set, const Tuning *tuned, const Profile *profile,
                           int64_t *nodes, double *places)
{
    int64_t count = 0;
    for (int64_t j = 0; j < n.jumps; j++) {
        int64_t node = of->jumps[j];
        if (jump_size(n, of, set, profile->squared[node], node) > tuned->knot_jump) {
            nodes[count] = node;
            places[count++] = of->s[node];
        }
    }
    return count;
}

/* The required knots, ascending; see `_breaks`. order: work, (jumps,); sizes: work, (jumps,); taken: work and breaks:
 * out, (jumps + 4,). Return their number. */
static int64_t set_breaks(Counts n, const Bounds *of, const Case *set, const Tuning *tuned, const Profile *profile,
                          State first, State last, const int64_t *jumps, int64_t count, int64_t *order, double *sizes,
                          double *taken, double *breaks)
{
    double gap = tuned->least_step * set->step;
    int64_t found = 0, used = 0, from = 0;
    double fixed[3] = {first.s, last.s, set->zone_start};
    for (int64_t i = 0; i < (first.s + 1e-9 < fixed[2] && fixed[2] < last.s - 1e-9 ? 3 : 2); i++, used++) {
        double time = interpolated(fixed[i], of->s, profile->time, n.nodes, &from);
        insert(taken, used, number_below(taken, used, time, 1), time);
        insert(breaks, used, number_below(breaks, used, fixed[i], 1), fixed[i]);
    }
    for (int64_t j = 0; j < count; j++) { /* by size, descending */
        int64_t node = jumps[j], at = found;
        if (!(of->s[node] > first.s && of->s[node] < last.s))
            continue;
        double size = jump_size(n, of, set, profile->squared[node], node);
        for (; at > 0 && sizes[at - 1] < size; at--) {
            sizes[at] = sizes[at - 1];
            order[at] = order[at - 1];
        }
        sizes[at] = size;
        order[at] = node;
        found++;
    }
    if ((double)found * gap > tuned->crowded * profile->time[n.nodes - 1])
        found = 0;
    for (int64_t j = 0; j < found; j++) {
        double time = profile->time[order[j]], place = of->s[order[j]];
        int64_t at = number_below(taken, used, time, 1);
        at = at < 1 ? 1 : at > used - 1 ? used - 1 : at;
        if (taken[at] - time > gap && time - taken[at - 1] > gap) {
            insert(taken, used, at, time);
            insert(breaks, used, number_below(breaks, used, place, 1), place);
            used++;
        }
    }
    if (first.a < 0.0) {
        double nearest = first.s - 0.4 * first.v * first.v / first.a;
        int64_t next = number_below(breaks, used, first.s, 1);
        if (next < used && nearest < breaks[next]) {
            insert(breaks, used, number_below(breaks, used, nearest, 1), nearest);
            used++;
        }
    }
    return used;
}

/* Knots with steps of equal time between the breaks; times, parts: work, (count,). Return the number of cells, of which
 * all are set if there is room. */
static int64_t set_knots(Counts n, const Bounds *of, const Case *set, const Tuning *tuned, const Profile *profile,
                         const double *breaks, int64_t count, double *times, double *parts, double *knots)
{
    int64_t longest = 0, cells = 0, from = 0;
    double all = 0.0;
    for (int64_t i = 0; i < count; i++)
        times[i] = interpolated(breaks[i], of->s, profile->clock, n.nodes, &from);
    for (int64_t i = 0; i < count - 1; i++) {
        double number = rint((times[i + 1] - times[i]) / set->step);
        parts[i] = number > 1.0 ? number : 1.0;
        all += parts[i];
        if (times[i + 1] - times[i] > times[longest + 1] - times[longest])
            longest = i;
    }
    if (all < tuned->least_cells)
        parts[longest] += tuned->least_cells - all;
    all = all < tuned->least_cells ? tuned->least_cells : all;
    if (all > (double)n.room)
        return all < 1e15 ? (int64_t)all : (int64_t)1e15;
    for (int64_t i = 0; i < count - 1; i++) {
        double span = times[i + 1] - times[i];
        for (double rank = 0.0; rank < parts[i]; rank += 1.0)
            knots[cells++] = rank == 0.0 ? breaks[i]
                                         : interpolated(times[i] + span * rank / parts[i], profile->clock, of->s,
                                                        n.nodes, &from);
    }
    knots[cells] = breaks[count - 1];
    return cells;
}

static int64_t cell_at(Counts n, const Bounds *of, double s)
{
    int64_t cell = number_below(of->s, n.nodes, s, 1) - 1;
    return cell < 0 ? 0 : cell > n.nodes - 2 ? n.nodes - 2 : cell;
}

/* Curvature (j = 0) or its rate (j = 1) at a place. */
static double curve_at(Counts n, const Bounds *of, int64_t j, double s)
{
    int64_t cell = cell_at(n, of, s), at = j * (n.nodes - 1) + cell;
    return of->left[at] + of->slope[at] * (s - of->s[cell]);
}

static double least_between(const double *values, int64_t first, int64_t last)
{
    double found = values[first];
    for (int64_t i = first + 1; i <= last; i++)
        found = least(found, values[i]);
    return found;
}

/* Largest and least rate over the cells of the limits between two places. */
static void spread_rates(Counts n, const Bounds *of, double begin, double end, double *largest, double *smallest)
{
    int64_t first = cell_at(n, of, begin), last = cell_at(n, of, end);
    *largest = most(of->rate_left[first], of->rate_right[first]);
    *smallest = least(of->rate_left[first], of->rate_right[first]);
    for (int64_t i = first + 1; i <= last; i++) {
        *largest = most(*largest, most(of->rate_left[i], of->rate_right[i]));
        *smallest = least(*smallest, least(of->rate_left[i], of->rate_right[i]));
    }
}

/* Whether a cell between two knots hides a jump: see `_hidden_jumps`. */
static int hides(const double *knots, int64_t count, int64_t cell, const double *places, int64_t jumps)
{
    for (int64_t j = number_below(places, jumps, knots[cell], 0); j < jumps && places[j] < knots[cell + 1]; j++) {
        int64_t nearest = number_below(knots, count, places[j] - 1e-9, 0);
        if (fabs(knots[nearest < count ? nearest : count - 1] - places[j]) > 1e-9)
            return 1;
    }
    return 0;
}

/* Rows of the knots: places, bound, curvature, largest and least rate, time, and turning limits, (m + 1,) each; rows of
 * the cells: steps, curvature, and largest and least rate at the centres, (m,) each. The places are given. */
static void set_limits(Counts n, const Bounds *of, const Profile *profile, const double *places, int64_t jumps, int64_t m,
                       double *knots, double *cells)
{
    int64_t k = m + 1, last = 0, from = 0;
    for (int64_t i = 0; i < k; i++) {
        double s = knots[i], right = curve_at(n, of, 1, s), left = curve_at(n, of, 1, s - 1e-9);
        double centre = i < m ? 0.5 * (s + knots[i + 1]) : s;
        int64_t begin = i == 0 ? cell_at(n, of, s) : last;
        last = i < m ? cell_at(n, of, centre) : n.nodes - 2;
        knots[k + i] = least_between(of->speed_squared, begin, last);
        knots[2 * k + i] = curve_at(n, of, 0, s);
        knots[3 * k + i] = most(left, right);
        knots[4 * k + i] = least(left, right);
        knots[5 * k + i] = interpolated(s, of->s, profile->time, n.nodes, &from);
        for (int64_t l = 0; l < n.limits; l++)
            knots[(6 + l) * k + i] = least_between(of->turning + l * (n.nodes - 1), begin, last);
        if (i < m) {
            cells[i] = knots[i + 1] - s;
            cells[m + i] = curve_at(n, of, 0, centre);
            cells[2 * m + i] = cells[3 * m + i] = curve_at(n, of, 1, centre);
        }
    }
    for (int64_t i = 0, before = 0; i < k && jumps > 0; i++) { /* extremes over the half cells around */
        int is_hidden = i < m && hides(knots, k, i, places, jumps);
        double quarter = i < m ? 0.25 * (knots[i + 1] - knots[i]) : 0.0;
        if (is_hidden || before)
            spread_rates(n, of, i == 0 ? knots[0] : knots[i] - 0.25 * (knots[i] - knots[i - 1]),
                         i < m ? knots[i] + quarter : knots[i] - 1e-9, knots + 3 * k + i, knots + 4 * k + i);
        if (is_hidden)
            spread_rates(n, of, knots[i] + quarter, knots[i + 1] - quarter, cells + 2 * m + i, cells + 3 * m + i);
        before = is_hidden;
    }
}

/* Numbers of cells, turning limits, those of order 2, nodes of the profile, samples of the filter, and its half width
 * in samples. */
typedef struct {
    int64_t m, limits, curved, nodes, times, half;
} Sizes;

typedef struct {
    const double *steps;                 /* (m,) */
    const double *bound, *curvature;     /* (m + 1,), at the knots */
    const double *rate;                  /* (2, m + 1), largest and least */
    const double *time;                  /* (m + 1,) */
    const double *turning;               /* (limits, m + 1) */
    const double *centres, *centre_rate; /* curvature (m,) and rates (2, m) at the centres */
} Grid;

/* Numbers; states of the ends are v, v^2 and a. */
typedef struct {
    double acceleration, deceleration, jerk, price, total, share, blend;
    double first_v, first_squared, first_a, last_v, last_squared, last_a;
    double orders[MOST_LIMITS];
} Settings;

/* Stencils (3, m) of the spline; see the class `Spline`. */
typedef struct {
    double *value, *slope, *centre_value, *centre_slope, *curve;
} Spline;

/* Places of the output, (3, m) every stencil. */
typedef struct {
    double *linear, *curved, *places, *right_share, *bands;
    int64_t rows, curved_rows, place_rows;
} Program;

/* Guess of v^2 at the knots; mean, values (times,) and sums (times + 2 half + 1,): work. */
static void initial_guess(Sizes n, const Grid *grid, const Settings *set, const double *profile, double *guess,
                          double *mean, double *sums)
{
    const double *squared = profile, *clock = profile + n.nodes;
    int64_t width = 2 * n.half + 1;
    double *times = sums + n.times + width, sum = 0.0;
    int64_t node = 0, period = 0;
    for (int64_t i = 0; i < n.times; i++)
        times[i] = set->total / (double)(n.times - 1) * (double)i;
    times[n.times - 1] = set->total;
    for (int64_t i = 0; i < n.times + width; i++) {
        int64_t k = i - n.half - 1;
        sum += k >= 0 && k < n.times ? interpolated(times[k], clock, squared, n.nodes, &node) : 0.0;
        sums[i] = sum;
    }
    for (int64_t i = 0; i < n.times; i++)
        mean[i] = (sums[i + width] - sums[i]) / (double)width;
    for (int64_t i = 0; i <= n.m; i++) {
        double x = set->share * interpolated(grid->time[i], times, mean, n.times, &period);
        double since = grid->time[i] - grid->time[0], until = grid->time[n.m] - grid->time[i];
        if (set->first_v > 0.0) {
            double share = least(1.0, since / set->blend);
            x = (1.0 - share) * set->first_squared + share * x;
        }
        double launch = most(set->first_v + since * (set->first_a + 0.5 * set->jerk * since),
                             0.1 * set->first_v + 1e-4);
        double stop = set->last_v + until * (-set->last_a + 0.5 * set->jerk * until);
        double lower = least(launch, stop);
        guess[i] = least(x, lower * lower);
    }
}

/* (T7) as stencils, and the weights of c_{i+1} at the knots. */
static void make_spline(int64_t m, const double *steps, double *right_share, const Spline *out)
{
    double before = 0.0, before_both = 0.0;
    for (int64_t i = 0; i <= m; i++) {
        double left = steps[i == 0 ? 0 : i - 1], both = left + steps[i == m ? m - 1 : i];
        double right = left / both;
        right_share[i] = right;
        if (i > 0) {
            int64_t k = i - 1;
            double h = steps[k], eighth = h * h / 8.0;
            double values[3] = {1.0 - before, before, 0.0}, slopes[3] = {-1.0 / before_both, 1.0 / before_both, 0.0};
            double next[3] = {0.0, 1.0 - right, right}, rises[3] = {0.0, -1.0 / both, 1.0 / both};
            for (int64_t j = 0; j < 3; j++) {
                int64_t at = j * m + k;
                out->value[at] = next[j];
                out->slope[at] = rises[j];
                out->curve[at] = 2.0 * (rises[j] - slopes[j]) / h;
                out->centre_value[at] = 0.5 * (values[j] + next[j]) - out->curve[at] * eighth;
                out->centre_slope[at] = 0.5 * (slopes[j] + rises[j]);
            }
        }
        before = right;
        before_both = both;
    }
}

/* Row r of stencils (3, rows, m). */
static double *row_of(double *stencils, int64_t rows, int64_t m, int64_t r, int64_t j)
{
    return stencils + (j * rows + r) * m;
}

/* Both signs of a turning limit as rows r and r + 1: bend is n times the curvature (m,), rate (2, stride). */
static void turning_rows(int64_t m, const double *value, const double *slope, double order, const double *curvature,
                         const double *rate, int64_t stride, const double *bounds, double *stencils, int64_t rows,
                         int64_t r)
{
    for (int64_t j = 0; j < 3; j++) {
        double *up = row_of(stencils, rows, m, r, j), *down = row_of(stencils, rows, m, r + 1, j);
        for (int64_t i = 0; i < m; i++) {
            double turn = order * curvature[i] * slope[j * m + i], x = value[j * m + i];
            up[i] = (turn + rate[i] * x) / bounds[i];
            down[i] = -(turn + rate[stride + i] * x) / bounds[i];
        }
    }
}

/* Set the last cell of a row to zero, because the state of the last knot is given. */
static void clear_last(double *stencils, int64_t rows, int64_t m, int64_t r)
{
    for (int64_t j = 0; j < 3; j++)
        row_of(stencils, rows, m, r, j)[m - 1] = 0.0;
}

static void copy_row(int64_t m, const double *stencil, double *stencils, int64_t rows, int64_t r, double sign,
                     double divisor)
{
    for (int64_t j = 0; j < 3; j++)
        for (int64_t i = 0; i < m; i++)
            row_of(stencils, rows, m, r, j)[i] = sign * stencil[j * m + i] / divisor;
}

/* Rows of the speed, the accelerations and the jerk. */
static void plain_rows(int64_t m, const Grid *grid, const Settings *set, const Spline *spline, Program *out)
{
    for (int64_t j = 0; j < 3; j++)
        for (int64_t i = 0; i < m; i++)
            row_of(out->linear, out->rows, m, 0, j)[i] = spline->value[j * m + i] / grid->bound[i + 1];
    copy_row(m, spline->slope, out->linear, out->rows, 1, 1.0, set->acceleration);
    copy_row(m, spline->slope, out->linear, out->rows, 2, -1.0, set->deceleration);
    for (int64_t r = 0; r < 3; r++)
        clear_last(out->linear, out->rows, m, r);
    copy_row(m, spline->curve, out->curved, out->curved_rows, 0, 1.0, 2.0 * set->jerk);
    copy_row(m, spline->curve, out->curved, out->curved_rows, 1, -1.0, 2.0 * set->jerk);
}

/* Rows of the turning limits: of order 1 linear, of order 2 with the speed, first at the knots and then at the centres.
 * middle: work, (m,). */
static void limit_rows(Sizes n, const Grid *grid, const Settings *set, const Spline *spline, Program *out,
                       double *middle)
{
    int64_t m = n.m, counts[2] = {2 * (n.limits - n.curved), 2 * n.curved}, next[2] = {3, 2};
    for (int64_t l = 0; l < n.limits; l++) {
        int64_t kind = set->orders[l] == 1.0 ? 0 : 1, rows = kind == 0 ? out->rows : out->curved_rows;
        double *stencils = kind == 0 ? out->linear : out->curved;
        const double *bounds = grid->turning + l * (m + 1);
        turning_rows(m, spline->value, spline->slope, set->orders[l], grid->curvature + 1, grid->rate + 1, m + 1,
                     bounds + 1, stencils, rows, next[kind]);
        clear_last(stencils, rows, m, next[kind]);
        clear_last(stencils, rows, m, next[kind] + 1);
        for (int64_t i = 0; i < m; i++)
            middle[i] = 0.5 * (bounds[i] + bounds[i + 1]);
        turning_rows(m, spline->centre_value, spline->centre_slope, set->orders[l], grid->centres, grid->centre_rate,
                     m, middle, stencils, rows, next[kind] + counts[kind]);
        next[kind] += 2;
    }
    for (int64_t r = 0; r < out->place_rows; r++)
        copy_row(m, r < counts[1] ? spline->value : spline->centre_value, out->places, out->place_rows, r, 1.0, 1.0);
}

/* Bands of Q; row: work, (4, m - 1). */
static void price_jerk(int64_t m, const Settings *set, const double *guess, const double *curve, double *bands,
                       double *row)
{
    for (int64_t i = 0; i < m - 1; i++) {
        double weight = sqrt(0.5 * set->price * guess[i + 1]) / (4.0 * set->jerk);
        const double *left = curve + i, *right = curve + i + 1;
        row[i] = weight * (0.0 - left[0]);
        row[m - 1 + i] = weight * (right[0] - left[m]);
        row[2 * (m - 1) + i] = weight * (right[m] - left[2 * m]);
        row[3 * (m - 1) + i] = weight * (right[2 * m] - 0.0);
    }
    for (int64_t i = 0; i < 4 * (m + 2); i++)
        bands[i] = 0.0;
    for (int64_t offset = 0; offset < 4; offset++)
        for (int64_t i = 0; i < 4 - offset; i++)
            for (int64_t k = 0; k < m - 1; k++)
                bands[(3 - offset) * (m + 2) + i + offset + k] +=
                    2.0 * row[i * (m - 1) + k] * row[(i + offset) * (m - 1) + k];
}

static void set_coefficients(int64_t m, const double *steps, const Settings *set, const double *guess, double *c)
{
    double largest = -INFINITY;
    for (int64_t i = 0; i < m; i++) {
        c[i + 1] = 0.5 * (guess[i] + guess[i + 1]);
        largest = most(largest, c[i + 1]);
    }
    double lowest = 1e-3 * (1e-12 > largest ? 1e-12 : largest);
    for (int64_t i = 1; i <= m; i++)
        c[i] = most(c[i], lowest);
    double first = set->first_v * set->first_v, last = set->last_v * set->last_v;
    c[0] = first - set->first_a * steps[0];
    c[1] = first + set->first_a * steps[0];
    c[m] = last - set->last_a * steps[m - 1];
    c[m + 1] = last + set->last_a * steps[m - 1];
}

/* Program, first coefficients and stencil of x'' on the grid of `set_limits`; see `optdock_reference_program`. work: 17 m + 3 samples
 * + 2 half + 2. */
static void make_program(Sizes n, const Settings *set, const double *knots, const double *cells, const double *profile,
                         double *program, double *first, double *stencil, double *room)
{
    int64_t m = n.m, k = m + 1, curved = n.curved, rows = 3 + 4 * (n.limits - curved);
    Grid grid = {cells, knots + k, knots + 2 * k, knots + 3 * k, knots + 5 * k, knots + 6 * k, cells + m, cells + 2 * m};
    double *linear = program + m, *with_speed = linear + 3 * rows * m;
    double *places = with_speed + 3 * (2 + 4 * curved) * m, *right = places + 3 * 4 * curved * m;
    Program out = {linear, with_speed, places, right, right + k, rows, 2 + 4 * curved, 4 * curved};
    Spline spline = {room, room + 3 * m, room + 6 * m, room + 9 * m, stencil};
    double *work = room + 12 * m, *guess = work + 4 * m;

    for (int64_t i = 0; i < m; i++)
        program[i] = cells[i];
    initial_guess(n, &grid, set, profile, guess, guess + k, guess + k + n.times);
    make_spline(m, cells, out.right_share, &spline);
    plain_rows(m, &grid, set, &spline, &out);
    limit_rows(n, &grid, set, &spline, &out, work);
    price_jerk(m, set, guess, spline.curve, out.bands, work);
    set_coefficients(m, cells, set, guess, first);
}

/* Sizes of the program on m cells; see `_filter`. */
static Sizes sizes_of(Counts n, const Case *set, const Tuning *tuned, const Profile *profile, int64_t m)
{
    double total = profile->time[n.nodes - 1], periods = floor(total / tuned->guess_sample), peak = profile->squared[0];
    for (int64_t i = 1; i < n.nodes; i++)
        peak = most(peak, profile->squared[i]);
    double reachable = sqrt(set->full_jerk * sqrt(peak));
    double rise = reachable < set->acceleration ? reachable : set->acceleration;
    double fall = reachable < set->deceleration ? reachable : set->deceleration;
    int64_t count = periods > 2.0 ? (int64_t)periods : 2;
    double half = 0.5 * (rise + fall) / set->full_jerk * (double)count / total;
    int64_t curved = 0;
    for (int64_t l = 0; l < n.limits; l++)
        curved += set->orders[l] != 1.0;
    return (Sizes){m, n.limits, curved, n.nodes, count + 1, half < (double)count ? (int64_t)half + 1 : count + 1};
}

/* Set states, durations and jerks (5, m + 1) from the coefficients c; see `states_of`. right: weights of c_{i+1} at the
 * knots, curve: stencil of x''. */
static void set_states(int64_t m, const Case *set, State first, State last, double stopped, const double *knots,
                       const double *steps, const double *right, const double *curve, const double *c, double *table)
{
    int64_t k = m + 1;
    double *v = table + k, *a = v + k, *times = a + k, *jerks = times + k;
    for (int64_t i = 0; i < k; i++) {
        double slope = 1.0 / (steps[i == 0 ? 0 : i - 1] + steps[i == m ? m - 1 : i]);
        table[i] = knots[i];
        v[i] = sqrt(most((1.0 - right[i]) * c[i] + right[i] * c[i + 1], 1e-12));
        a[i] = least(most(slope * c[i + 1] - slope * c[i], -set->deceleration), set->acceleration);
    }
    v[0] = first.v;
    a[0] = first.a;
    v[m] = last.v;
    a[m] = last.a;
    for (int64_t i = 0; i < m; i++) {
        double bend = curve[i] * c[i] + curve[m + i] * c[i + 1] + curve[2 * m + i] * c[i + 2];
        times[i] = 2.0 * steps[i] / (v[i] + v[i + 1]);
        jerks[i] = 0.5 * fabs(bend) * most(v[i], v[i + 1]);
    }
    times[m] = stopped;
    jerks[m] = INFINITY;
}

/* Make the reference program of a segment with nodes >= 2 and at most two turning limits, and its first iterations.
 *
 *   sizes      nodes, turning limits, jumps, most cells and samples, most iterations, most cells times iterations
 *   numbers    see `Case`; then the start, s, v and a
 *   tuned      see `Tuning`; then the settings of the interior point method
 *   along      (13 nodes - 9,), see `PathLimits.table`
 *   bounds     (2 + limits, nodes - 1), see `ReferenceBounds.table`
 *   jumps      (jumps,)
 *   found      out, one after the other:
 *              (10,): duration and jerk of the launch arc, state after it, duration of the stop arc, state before it,
 *              iterations;
 *              profile (2, nodes): v^2 and time;
 *              knots (6 + limits, m + 1) and cells (4, m), see `set_limits`;
 *              states, durations and jerks (5, m + 1), see `states_of`;
 *              x'' (3, m) as a stencil, and the state of `optdock_interior_point`;
 *              program: steps (m,), linear (3, 3 + 4 of order 1, m), with speed (3, 2 + 4 of order 2, m), places (3, 4
 *              of order 2, m), right shares (m + 1,), bands (4, m + 2)
 *   work       2 nodes + 34 most + 7 jumps + 32, or as `optdock_interior_point` if that is more
 *
 * Return the number m of cells, 0 if the arcs leave no room for the reference, -1 if a size is wrong, and -m, or the
 * number of samples, if more cells or samples are needed. */
int64_t optdock_reference_program(
    int64_t nodes, int64_t limits, int64_t jumps, int64_t room, int64_t iterations, int64_t at_once, double acceleration, double deceleration, double full_jerk,
    double jerk, double price, double step, double zone_start, double is_steered, double first_cap, double order,
    double other_order, double bound, double other_bound, double start_s, double start_v, double start_a,
    const double *tuned_numbers, const double *along, const double *bounds, const int64_t *jump_nodes, double *found,
    double *work)
{
    if (nodes < 2 || limits < 0 || limits > MOST_LIMITS || jumps < 0 || room < 8)
        return -1;
    for (int64_t j = 0; j < jumps; j++)
        if (jump_nodes[j] < 1 || jump_nodes[j] > nodes - 2)
            return -1;
    const double *g = tuned_numbers;
    Tuning tuned = {g[0],  g[1],  g[2],  g[3],  g[4],  g[5],  g[6],  g[7],  g[8],  g[9],
                    g[10], g[11], g[12], g[13], g[14], g[15], g[16], g[17], g[18], g[19]};
    int64_t pieces = nodes - 1;
    const double *left = along + nodes, *bend = left + 6 * pieces, *right = bend + nodes;
    Counts n = {nodes, limits, jumps, room};
    Bounds of = {along,         left,          left + 3 * pieces, bend,
                 bounds,        bounds + pieces, right + 3 * pieces, bounds + 2 * pieces,
                 left + pieces, right,         right + pieces,    right + 2 * pieces,
                 jump_nodes};
    Case set = {acceleration, deceleration,         full_jerk,           jerk, step, zone_start, is_steered,
                first_cap,    {order, other_order}, {bound, other_bound}};
    double *ends = found, *profile_rows = ends + 10, *knots = profile_rows + 2 * nodes;
    Profile profile = {profile_rows, profile_rows + nodes, work};
    double *size = work + nodes, *samples = size + nodes, *places = samples + 2 * room, *sizes = places + jumps;
    double *taken = sizes + jumps, *breaks = taken + jumps + 4, *parts = breaks + jumps + 4, *more = parts + jumps + 4;
    int64_t *large_nodes = (int64_t *)(work + 2 * nodes + 34 * room + 5 * jumps + 32);
    State first = {start_s, start_v, start_a}, last;

    set_profile(n, &of, &set, &tuned, start_v, &profile);
    ends[1] = 0.0;
    ends[0] = launch_arc(n, &of, &set, &tuned, &first, ends + 1);
    ends[5] = stop_arc(n, &of, &set, &tuned, &last);
    double states[2][3] = {{first.s, first.v, first.a}, {last.s, last.v, last.a}};
    for (int64_t i = 0; i < 3; i++) {
        ends[2 + i] = states[0][i];
        ends[6 + i] = states[1][i];
    }
    if (last.s - first.s < tuned.least_rest * along[nodes - 1])
        return 0;
    double total = profile.time[nodes - 1], periods = floor(total / tuned.cruise_sample);
    periods = periods > 2.0 ? periods : 2.0;
    if (periods > (double)(room - 1))
        return -(periods < 1e15 ? (int64_t)periods + 1 : (int64_t)1e15);
    set_clock(n, &of, &set, &tuned, (int64_t)periods + 1, &profile, samples, samples + room, size);
    int64_t large = large_jumps(n, &of, &set, &tuned, &profile, large_nodes, places);
    int64_t count = set_breaks(n, &of, &set, &tuned, &profile, first, last, large_nodes, large, large_nodes + jumps, sizes,
                               taken, breaks);
    int64_t m = set_knots(n, &of, &set, &tuned, &profile, breaks, count, taken, parts, knots);
    if (m > room)
        return -m;
    double *cells = knots + (6 + limits) * (m + 1), *table = cells + 4 * m;
    double *curve = table + 5 * (m + 1), *state = curve + 3 * m;
    set_limits(n, &of, &profile, places, large, m, knots, cells);
    Settings settings = {tuned.drive_share * acceleration, tuned.drive_share * deceleration,
                         jerk,    price,             total,   tuned.guess_share, tuned.guess_blend,
                         first.v, first.v * first.v, first.a, last.v,            last.v * last.v, last.a,
                         {order, other_order}};
    Sizes sizes_now = sizes_of(n, &set, &tuned, &profile, m);
    int64_t linear = 3 + 4 * (limits - sizes_now.curved), curved = 2 + 4 * sizes_now.curved;
    int64_t possible = at_once / m > 1 ? at_once / m : 1;
    double *program = state + (2 * linear + 3 * curved + 1) * m + 4;
    make_program(sizes_now, &settings, knots, cells, profile_rows, program, state, curve, more);
    program[-1] = 0.0; /* the method has not ended */
    g += 20;
    ends[9] = (double)optdock_interior_point(m, linear, curved, 0, possible < iterations ? possible : iterations, g[0],
                                             g[1], g[2], g[3], g[4], g[5], g[6], g[7], g[8], g[9], g[10], g[11],
                                             program, state, work);
    set_states(m, &set, first, last, ends[5], knots, cells, program + (1 + 3 * linear + 6 * curved - 6) * m, curve, state,
               table);
    return m;
}
