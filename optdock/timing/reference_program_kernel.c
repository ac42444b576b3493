/* The reference program on given knots: the function `prepared` of `reference_program.py` in C.
 *
 * The maps of the spline are (T7), the constraints (T8) of docs/theory/timing.md; the initial guess is the profile (T5),
 * averaged over time. Sums and products are evaluated in the order of the twin, so the results are equal to the last
 * bit. A search for a motion uses them; the certificate does not. */

#include <math.h>
#include <stdint.h>

enum { MOST_LIMITS = 2 }; /* turning limits */

/* Numbers of cells, turning limits, nodes of the profile, samples of the filter, and its half width in samples. */
typedef struct {
    int64_t m, limits, nodes, times, half;
} Counts;

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

static double least(double a, double b) { return a < b || a != a ? a : b; }

static double most(double a, double b) { return a > b || a != a ? a : b; }

/* Interpolate (xp, fp), both (count,), count >= 2, as NumPy does. from: in and out, index from which the cell of x is
 * searched. */
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

/* Guess of v^2 at the knots; mean, values (times,) and sums (times + 2 half + 1,): work. */
static void initial_guess(Counts n, const Grid *grid, const Settings *set, const double *profile, double *guess,
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
static void limit_rows(Counts n, const Grid *grid, const Settings *set, const Spline *spline, Program *out,
                       double *middle)
{
    int64_t m = n.m, counts[2] = {0, 0}, next[2];
    for (int64_t l = 0; l < n.limits; l++)
        counts[set->orders[l] == 1.0 ? 0 : 1] += 2;
    next[0] = 3;
    next[1] = 2;
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

/* Make the program on a grid of m >= 2 cells with at most two turning limits.
 *
 *   sizes      m, turning limits, how many of them have order 2, nodes of the profile, samples and half width of the
 *              filter
 *   numbers    bounds of acceleration and deceleration, jerk, price of jerk steps, duration of the profile, share of the
 *              guess, time of the blend; v, v^2 and a of both ends; orders of two limits
 *   knots      bound, curvature, rate (2), time and turning limits, (m + 1,) each
 *   cells      steps, curvature and rate (2) at the centres, (m,) each
 *   profile    v^2 and time, (nodes,) each
 *   program    out: steps (m,), linear (3, 3 + 4 of order 1, m), with speed (3, 2 + 4 of order 2, m), places (3, 4 of
 *              order 2, m), right shares (m + 1,), bands (4, m + 2)
 *   first      out, coefficients (m + 2,), then x'' (3, m) as a stencil
 *   room       work, 17 m + 3 samples + 2 half + 2
 *
 * Return 0, or -1 if a size is wrong. */
int64_t optdock_reference_program(int64_t m, int64_t limits, int64_t curved, int64_t nodes, int64_t times, int64_t half,
                                  double acceleration, double deceleration, double jerk, double price, double total,
                                  double share, double blend, double first_v, double first_squared, double first_a,
                                  double last_v, double last_squared, double last_a, double order, double other_order,
                                  const double *knots, const double *cells, const double *profile, double *program,
                                  double *first, double *room)
{
    if (m < 2 || limits < 0 || limits > MOST_LIMITS || curved < 0 || curved > limits || nodes < 2 || times < 2 ||
        half < 0)
        return -1;
    Counts n = {m, limits, nodes, times, half};
    Settings set = {acceleration, deceleration,  jerk,    price,  total,        share,  blend,
                    first_v,      first_squared, first_a, last_v, last_squared, last_a, {order, other_order}};
    int64_t k = m + 1, rows = 3 + 4 * (limits - curved);
    Grid grid = {cells, knots, knots + k, knots + 2 * k, knots + 4 * k, knots + 5 * k, cells + m, cells + 2 * m};
    double *linear = program + m, *with_speed = linear + 3 * rows * m;
    double *places = with_speed + 3 * (2 + 4 * curved) * m, *right = places + 3 * 4 * curved * m;
    Program out = {linear, with_speed, places, right, right + k, rows, 2 + 4 * curved, 4 * curved};
    Spline spline = {room, room + 3 * m, room + 6 * m, room + 9 * m, first + m + 2};
    double *work = room + 12 * m, *guess = work + 4 * m;

    for (int64_t i = 0; i < m; i++)
        program[i] = cells[i];
    initial_guess(n, &grid, &set, profile, guess, guess + k, guess + k + times);
    make_spline(m, cells, out.right_share, &spline);
    plain_rows(m, &grid, &set, &spline, &out);
    limit_rows(n, &grid, &set, &spline, &out, work);
    price_jerk(m, &set, guess, spline.curve, out.bands, work);
    set_coefficients(m, cells, &set, guess, first);
    return 0;
}
