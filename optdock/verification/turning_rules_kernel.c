/* Instants at which a motion reaches given distances: the function `crossings` of `turning_rules.py` in C.
 *
 * The operations are those of the twin, so the results are equal to the last bit. */

#include <math.h>
#include <stdint.h>

static double most(double a, double b) { return a > b || a != a ? a : b; }

/* Order of sorted numbers: NaN is above all others. */
static int is_below(double a, double b) { return a < b || (b != b && a == a); }

/* Number of the first `count` values, in ascending order, below a value. */
static int64_t number_below(const double *values, int64_t count, double value)
{
    int64_t first = 0;
    while (first < count) {
        int64_t middle = first + (count - first) / 2;
        if (is_below(values[middle], value))
            first = middle + 1;
        else
            count = middle;
    }
    return first;
}

/* Time of constant jerk after which a distance is reached, by bisection of [0, high]. */
static double time_to(double distance, double v, double a, double jerk, double high, int64_t bisections)
{
    double low = 0.0, half_a = a / 2.0, sixth_j = jerk / 6.0;
    for (int64_t i = 0; i < bisections; i++) {
        double middle = 0.5 * (low + high);
        if (middle * (v + middle * (half_a + middle * sixth_j)) >= distance)
            high = middle;
        else
            low = middle;
    }
    return 0.5 * (low + high);
}

/* Compute the first instants at which the distance reaches n places.
 *
 *   sizes      n, number of phases >= 1, bisections
 *   durations  (phases,) [s]; jerks: (phases,) [m/s^3]
 *   states     (phases + 1, 3), distance, speed and acceleration at the borders of the phases
 *   places     (n,) [m]
 *   phase      out, (n,); since: out, (n,), time since the start of the phase [s]
 *   reached    work, (phases + 1,)
 *
 * Return 0, or -1 if there is no phase. */
int64_t optdock_crossings(int64_t n, int64_t phases, int64_t bisections, const double *durations, const double *jerks,
                          const double *states, const double *places, int64_t *phase, double *since, double *reached)
{
    if (phases < 1)
        return -1;
    for (int64_t p = 0; p <= phases; p++)
        reached[p] = p == 0 ? states[0] : most(reached[p - 1], states[3 * p]);
    for (int64_t i = 0; i < n; i++) {
        int64_t p = number_below(reached, phases + 1, places[i]) - 1;
        p = p < 0 ? 0 : p > phases - 1 ? phases - 1 : p;
        const double *state = states + 3 * p;
        phase[i] = p;
        since[i] = time_to(places[i] - state[0], state[1], state[2], jerks[p], durations[p], bisections);
    }
    return 0;
}
