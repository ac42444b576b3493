/* Shortest durations of gears and lower bounds of the prices of paths: `_durations` and `least_prices` of `price.py` in C.
 *
 * Sums and products are evaluated in the order of the twins, so the results are equal to the last bit. Only guesses
 * depend on this file; the certificate has code of its own. */

#include <math.h>
#include <stdint.h>

#define STEPS 20           /* most iterations for a peak speed */
#define EXCESS 1e-6        /* [m]: tolerance of the length */
#define LEAST_MOTION 1e-6  /* [m]: shorter arcs do not count as motion */
#define CUSP_PRICE 1.0     /* [s] */

/* The numbers of a problem: largest speeds forward and in reverse, acceleration, deceleration, jerk, speed at the start,
 * speed and length of the zone before the dock, price of reversing [s/m]. */
typedef struct {
    double speed, reverse_speed, acceleration, deceleration, jerk, start_speed, zone_speed, zone_distance, reverse_price;
} Rule;

static double larger(double a, double b) { return a > b ? a : b; }

static double smaller(double a, double b) { return a < b ? a : b; }

/* Time and distance between two speeds, and d distance / d speed for the faster speed [s, m, s]. */
typedef struct {
    double time, distance, slope;
} Ramp;

static Ramp ramp(double slow, double fast, double acceleration, double jerk)
{
    double change = larger(fast - slow, 0.0), mean = 0.5 * (slow + fast), time, slope;
    if (change >= acceleration * acceleration / jerk) { /* the acceleration reaches its bound */
        time = change / acceleration + acceleration / jerk;
        slope = 1.0 / acceleration;
    } else {
        time = 2.0 * sqrt(change / jerk);
        slope = 1.0 / larger(sqrt(change * jerk), 1e-12);
    }
    return (Ramp){time, mean * time, 0.5 * time + mean * slope};
}

/* Shortest duration of a straight motion of a length, from speed `first` to speed `last`, at most `top`; Newton's method
 * safeguarded by bisection for the peak speed. */
static double motion_duration(const Rule *rule, double length, double first, double last, double top)
{
    first = smaller(first, top);
    last = smaller(last, top);
    double low = larger(first, last), high = top, peak = top;
    int is_known = 0;
    for (int i = 0; i < STEPS && !is_known; i++) {
        Ramp up = ramp(first, peak, rule->acceleration, rule->jerk);
        Ramp down = ramp(last, peak, rule->deceleration, rule->jerk);
        double excess = up.distance + down.distance - length;
        is_known = fabs(excess) <= EXCESS || (peak >= top && excess <= 0.0) || high <= low;
        if (is_known)
            break;
        if (excess > 0.0)
            high = peak;
        else
            low = peak;
        double step = peak - excess / larger(up.slope + down.slope, 1e-12);
        peak = step > low && step < high ? step : 0.5 * (low + high);
    }
    if (!is_known)
        peak = low; /* also if the length is too short for braking */
    Ramp up = ramp(first, peak, rule->acceleration, rule->jerk);
    Ramp down = ramp(last, peak, rule->deceleration, rule->jerk);
    return up.time + down.time + larger(length - up.distance - down.distance, 0.0) / larger(peak, 1e-300);
}

/* Shortest duration of one gear, 0 for a length of 0. */
static double gear_duration(const Rule *rule, double gear, int is_first, int is_last)
{
    double length = fabs(gear), top = gear > 0.0 ? rule->speed : rule->reverse_speed;
    double first = is_first ? fabs(rule->start_speed) : 0.0, slow = smaller(rule->zone_speed, top), inside = 0.0;
    if (gear == 0.0)
        return 0.0;
    if (is_last && slow < top) {
        double rising = ramp(smaller(first, slow), slow, rule->acceleration, rule->jerk).distance;
        double falling = ramp(0.0, slow, rule->deceleration, rule->jerk).distance;
        if (length <= rule->zone_distance + rising)
            top = slow;
        else if (falling <= rule->zone_distance)
            inside = rule->zone_distance;
    }
    double until = inside > 0.0 ? slow : 0.0;
    double found = motion_duration(rule, length - inside, first, until, top);
    return inside > 0.0 ? found + motion_duration(rule, inside, until, 0.0, until) : found;
}

/* Shortest duration of a path with k gears [s]. */
static double path_duration(const Rule *rule, int64_t k, const double *gears)
{
    int64_t first = 0, last = k - 1;
    double found = 0.0;
    while (first < k && gears[first] == 0.0)
        first++;
    while (last >= 0 && gears[last] == 0.0)
        last--;
    for (int64_t i = 0; i < k; i++)
        found += gear_duration(rule, gears[i], i == first, i == last);
    return found;
}

/* Durations of n paths between stops.
 *
 *   n, k    numbers of paths and of gears of each
 *   rule    (9,), see `Rule`
 *   gears   (n, k), signed lengths, 0 for no motion [m]
 *   found   out, (n,) [s] */
int64_t optdock_durations(int64_t n, int64_t k, const double *rule, const double *gears, double *found)
{
    for (int64_t i = 0; i < n; i++)
        found[i] = path_duration((const Rule *)rule, k, gears + k * i);
    return 0;
}

/* Lower bounds of the prices of n paths without turns in place.
 *
 *   n, k      numbers of paths and of pieces of each
 *   rule      (9,), see `Rule`
 *   lengths   (n, k), signed lengths of the pieces; neighbours may have the same gear [m]
 *   gears     work, (k,)
 *   prices    out, (n,) [s] */
int64_t optdock_least_prices(int64_t n, int64_t k, const double *rule, const double *lengths, double *gears,
                             double *prices)
{
    for (int64_t i = 0; i < n; i++) {
        int64_t gear = 0;
        double now = 0.0, reversing = 0.0;
        for (int64_t j = 0; j < k; j++)
            gears[j] = 0.0;
        for (int64_t j = 0; j < k; j++) {
            double length = lengths[k * i + j];
            if (!(fabs(length) > LEAST_MOTION))
                continue;
            gear += length * now < 0.0;
            now = length > 0.0 ? 1.0 : -1.0;
            gears[gear] += length;
        }
        for (int64_t j = 0; j < k; j++)
            reversing += ((const Rule *)rule)->reverse_price * larger(-gears[j], 0.0);
        prices[i] = path_duration((const Rule *)rule, k, gears) + CUSP_PRICE * (double)gear;
        prices[i] += reversing;
    }
    return 0;
}
