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

/* Limits along the segment by nodes (nodes,) or cells (nodes - 1,), see `PathLimits`: places; curvature, rate and
 * slowness at the left end of every cell with their slopes, (3, nodes - 1) each. Indices of nodes with a jump of the
 * curvature rate, (jumps,). */
typedef struct {
    const double *s, *left, *slope, *curvature, *rate_left, *rate_right, *slowness_left, *slowness_right;
    const int64_t *jump;
    int64_t nodes, jumps;
    double bound, relief, share; /* [rad/s^2], [m], factor on the excess beyond the relief */
    int is_steered;
} Limits;

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

/* Number of jumps below x, or at most x. */
static int64_t jumps_below(const Limits *limits, double x, int includes_equal)
{
    int64_t low = 0, count = limits->jumps;
    while (low < count) {
        int64_t middle = low + (count - low) / 2;
        double place = limits->s[limits->jump[middle]];
        if (place < x || (includes_equal && place == x))
            low = middle + 1;
        else
            count = middle;
    }
    return low;
}

/* Ratio of the yaw acceleration to its bound; 0 if the bound is infinite. */
static double turning_ratio(const Limits *limits, double curvature, double rate, double v, double a)
{
    return isinf(limits->bound) ? 0.0 : most(0.0, fabs(a * curvature + v * v * rate) * (1.0 / limits->bound));
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
static void add_jumps(const Limits *limits, Samples *samples, double shift, Settings set)
{
    int64_t last = jumps_below(limits, samples->states[samples->count - 1].s, 1);
    for (int64_t k = jumps_below(limits, samples->states[0].s, 0); k < last; k++) {
        int64_t node = limits->jump[k], before = number_below(samples->key, samples->count, limits->s[node] + shift, 0) - 1;
        before = before < 0 ? 0 : before;
        State at = reached(samples->states[before], samples->jerk[before], limits->s[node], set);
        double turning = most(turning_ratio(limits, limits->curvature[node], limits->rate_right[node - 1], at.v, at.a),
                              turning_ratio(limits, limits->curvature[node], limits->rate_left[node], at.v, at.a));
        double slowness = most(limits->slowness_right[node - 1], limits->slowness_left[node]);
        double excess = most(sqrt(turning), limits->is_steered ? at.v * slowness : 0.0);
        excess = checked(limits, limits->s[node], excess);
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
 *   sizes      n, size of `moves`, nodes >= 2, jumps, largest number of samples of a move
 *   numbers    sampling period [s], least speed [m/s], relief [m], factor on the excess, bound [rad/s^2], whether the
 *              steering rate is limited
 *   moves      for every move the number of phases, distance, speed and acceleration at its start, and duration [s] and
 *              jerk [m/s^3] of its phases
 *   along      (13 nodes - 9,), see `PathLimits.table`
 *   jumps      (jumps,), nodes
 *   found      out, (2, n), excess and place [m]; then work, 6 times the largest number of samples
 *
 * Return 0, or -1 if a size or a jump is wrong. */
int64_t optdock_move_excess(int64_t n, int64_t size, int64_t nodes, int64_t jumps, int64_t room, double period,
                            double crawl, double relief, double share, double bound, double is_steered,
                            const double *moves, const double *along, const int64_t *jump_nodes, double *found)
{
    if (nodes < 2)
        return -1;
    for (int64_t j = 0; j < jumps; j++)
        if (jump_nodes[j] < 1 || jump_nodes[j] > nodes - 2)
            return -1;
    int64_t cells = nodes - 1;
    const double *left = along + nodes, *curvature = left + 6 * cells, *right = curvature + nodes;
    Limits limits = {along,         left,  left + 3 * cells, curvature, left + cells,       right, right + cells,
                     right + 2 * cells, jump_nodes, nodes,   jumps,     bound,              relief, share,
                     is_steered != 0.0};
    Settings set = {period, crawl, along[nodes - 1], 2.0 * along[nodes - 1]};
    double *work = found + 2 * n;
    Samples samples = {(State *)work, work + 3 * room, work + 4 * room, work + 5 * room, 0};
    for (int64_t i = 0; i < n; i++) {
        if (size < 4 || !(moves[0] >= 1.0 && 2.0 * moves[0] <= (double)(size - 4)))
            return -1;
        int64_t count = (int64_t)moves[0];
        State from = {moves[1], moves[2], moves[3]};
        double shift = set.stride * (double)i;
        if (!sample(&limits, from, moves + 4, count, shift, room, set, &samples))
            return -1;
        moves += 4 + 2 * count;
        size -= 4 + 2 * count;
        add_jumps(&limits, &samples, shift, set);
        double worst = samples.excess[0], place = NAN;
        for (int64_t k = 1; k < samples.count; k++)
            worst = most(worst, samples.excess[k]);
        for (int64_t k = 0; k < samples.count; k++)
            if (samples.excess[k] >= worst)
                place = samples.states[k].s;
        found[i] = worst;
        found[n + i] = place;
    }
    return 0;
}
