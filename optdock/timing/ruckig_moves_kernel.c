/* Largest excess of moves: the function `_evaluate` of `ruckig_moves.py` in C.
 *
 * The excess is (T10) of docs/theory/timing.md at samples of the moves and at jumps of the curvature rate. Sums and
 * products are evaluated in the order of the twin, so the results are equal to the last bit. A limit on the lateral
 * jerk needs cube roots, whose last bits depend on the library; the twin alone evaluates it. A search for a motion uses
 * this file; the certificate does not. */

#include <math.h>
#include <stdint.h>

typedef struct {
    double s, v, a;
} State;

/* Limits along the segment: places s (nodes,), and curvature, rate and slowness at the left end of every cell with
 * their slopes, (3, nodes - 1) each. */
typedef struct {
    const double *s, *left, *slope;
    int64_t nodes, is_limited; /* whether there is a bound of the yaw acceleration */
    double bound, relief, share; /* [rad/s^2], [m], factor on the excess beyond the relief */
} Limits;

/* Jumps of the curvature rate, (5, count): place, curvature, rates on both sides, slowness. */
typedef struct {
    const double *table;
    int64_t count;
} Jumps;

/* Samples of one move, and their places as increasing numbers. */
typedef struct {
    State *states;
    double *jerk, *excess, *key;
    int64_t count;
} Samples;

typedef struct {
    double sample, crawl, length, stride;
} Settings;

static double least(double a, double b) { return a < b || a != a ? a : b; }

static double most(double a, double b) { return a > b || a != a ? a : b; }

static State after(double t, State from, double jerk)
{
    double gain = t * jerk;
    return (State){from.s + t * (from.v + t * (0.5 * from.a + gain / 6.0)), from.v + t * (from.a + 0.5 * gain),
                   from.a + gain};
}

/* Number of values at most x, or below x, among `count` ascending ones. */
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

/* Ratio of the yaw acceleration to its bound; 0 without a bound. */
static double turning_ratio(const Limits *limits, double curvature, double rate, double v, double a)
{
    return limits->is_limited ? most(0.0, fabs(a * curvature + v * v * rate) * (1.0 / limits->bound)) : 0.0;
}

static double checked(const Limits *limits, double s, double excess)
{
    return excess * (limits->relief > 0.0 && s < limits->relief ? 1.0 : limits->share);
}

/* from: in and out, index from which the cell is searched. */
static double excess_at(const Limits *limits, State at, int64_t *from)
{
    int64_t cells = limits->nodes - 1, cell = *from;
    while (cell > 0 && !(at.s >= limits->s[cell]))
        cell--;
    while (cell < cells - 1 && at.s >= limits->s[cell + 1])
        cell++;
    *from = cell;
    double along = at.s - limits->s[cell], values[3];
    for (int64_t j = 0; j < 3; j++)
        values[j] = limits->left[j * cells + cell] + limits->slope[j * cells + cell] * along;
    double turning = turning_ratio(limits, values[0], values[1], at.v, at.a);
    return checked(limits, at.s, most(at.v * values[2], sqrt(turning)));
}

static double clipped(double x, double low, double high) { return least(most(x, low), high); }

/* State at a place that is reached at most one period after a sample. */
static State reached(State sample, double jerk, double place, Settings set)
{
    State from = {sample.s - place, sample.v, sample.a};
    double t = -from.s / most(from.v, set.crawl);
    for (int64_t i = 0; i < 2; i++) { /* Newton steps for the time */
        State there = after(t, from, jerk);
        t = clipped(t - there.s / most(there.v, set.crawl), 0.0, set.sample);
    }
    return after(t, from, jerk);
}

/* Raise the excess of the last sample before each jump to the excess at the jump. */
static void add_jumps(const Limits *limits, Jumps jumps, Samples *samples, double shift, Settings set)
{
    const double *places = jumps.table, *curvature = places + jumps.count, *right = curvature + jumps.count;
    const double *left = right + jumps.count, *slowness = left + jumps.count;
    int64_t first = number_below(places, jumps.count, samples->states[0].s, 0);
    int64_t last = number_below(places, jumps.count, samples->states[samples->count - 1].s, 1);
    for (int64_t k = first; k < last; k++) {
        int64_t before = number_below(samples->key, samples->count, places[k] + shift, 0) - 1;
        before = before < 0 ? 0 : before;
        State at = reached(samples->states[before], samples->jerk[before], places[k], set);
        double turning = most(turning_ratio(limits, curvature[k], right[k], at.v, at.a),
                              turning_ratio(limits, curvature[k], left[k], at.v, at.a));
        double excess = checked(limits, places[k], most(sqrt(turning), at.v * slowness[k]));
        samples->excess[before] = most(samples->excess[before], excess);
    }
}

/* Sample `count` phases from a state. Return 0 if there is not enough room. */
static int sample(const Limits *limits, State from, const double *phases, int64_t count, double shift, int64_t room,
                  Settings set, Samples *out)
{
    int64_t cell = number_below(limits->s, limits->nodes - 1, from.s, 0);
    cell = cell > 0 ? cell - 1 : 0;
    out->count = 0;
    for (int64_t p = 0; p < count; p++) {
        double duration = phases[2 * p], jerk = phases[2 * p + 1], parts = duration / set.sample;
        if (!(parts >= 0.0 && parts < (double)(room - out->count)))
            return 0;
        int64_t number = 1 + (int64_t)parts;
        for (int64_t i = 0; i < number; i++) {
            int64_t k = out->count++;
            State at = after((double)i * (duration / (double)number), from, jerk);
            at.s = clipped(at.s, 0.0, set.length);
            out->states[k] = at;
            out->jerk[k] = jerk;
            out->excess[k] = excess_at(limits, at, &cell);
            out->key[k] = k == 0 ? at.s + shift : most(out->key[k - 1], at.s + shift);
        }
        from = after(duration, from, jerk);
    }
    return 1;
}

/* Compute the largest excess of n moves and the last place where it is attained.
 *
 *   sizes      n, number of phases, nodes >= 2, jumps, whether the yaw acceleration has a bound, largest number of
 *              samples of a move
 *   numbers    sampling period [s], least speed [m/s], relief [m], factor on the excess, bound [rad/s^2]
 *   counts     (n,), phases of every move
 *   starts     (n, 3), distance, speed and acceleration at the start of every move
 *   phases     (phases, 2), duration [s] and jerk [m/s^3], move after move
 *   limits     (13 nodes - 9,), see `PathLimits.table`
 *   jumps      (5, jumps), see `Jumps`
 *   found      out, (n, 2), excess and place [m]
 *   work       6 times the largest number of samples
 *
 * Return 0, or -1 if a size is wrong. */
int64_t optdock_move_excess(int64_t n, int64_t total, int64_t nodes, int64_t jumps, int64_t is_limited, int64_t room,
                            double period, double crawl, double relief, double share, double bound,
                            const int64_t *counts, const double *starts, const double *phases, const double *along,
                            const double *jump_table, double *found, double *work)
{
    if (nodes < 2)
        return -1;
    const double *left = along + nodes;
    Limits limits = {along, left, left + 3 * (nodes - 1), nodes, is_limited, bound, relief, share};
    Settings set = {period, crawl, along[nodes - 1], 2.0 * along[nodes - 1]};
    Samples samples = {(State *)work, work + 3 * room, work + 4 * room, work + 5 * room, 0};
    int64_t first = 0;
    for (int64_t i = 0; i < n; i++) {
        State from = {starts[3 * i], starts[3 * i + 1], starts[3 * i + 2]};
        double shift = set.stride * (double)i;
        if (counts[i] < 1 || counts[i] > total - first ||
            !sample(&limits, from, phases + 2 * first, counts[i], shift, room, set, &samples))
            return -1;
        first += counts[i];
        if (jumps > 0)
            add_jumps(&limits, (Jumps){jump_table, jumps}, &samples, shift, set);
        double worst = samples.excess[0], place = NAN;
        for (int64_t k = 1; k < samples.count; k++)
            worst = most(worst, samples.excess[k]);
        for (int64_t k = 0; k < samples.count; k++)
            if (samples.excess[k] >= worst)
                place = samples.states[k].s;
        found[2 * i] = worst;
        found[2 * i + 1] = place;
    }
    return 0;
}
