/* The cheapest Reeds-Shepp words between pairs of poses: `_cheapest` of `connections.py` in C.
 *
 * Sums and products are evaluated in the order of the twin, so the results are equal to the last bit. Only guesses
 * depend on this file; the certificate has code of its own. */

#include <math.h>
#include <stdint.h>

#define FORMS 44      /* words of a pair */
#define ARCS 5        /* arcs and lines of a word */
#define NOTHING 1e-6  /* [m]: shorter arcs do not count as motion */

/* Price of a signed length at full speed [s]. */
static double driving_price(double length, double speed, double reverse_speed, double reverse_price)
{
    double time = length > 0.0 ? length / speed : -length / reverse_speed;
    return time + reverse_price * (length < 0.0 ? -length : 0.0);
}

/* Signs of the first and the last motion of a word, 0 without motion, and its changes of gear. */
static void set_gears(const double *lengths, double *gears)
{
    gears[0] = gears[1] = gears[2] = 0.0;
    for (int64_t k = 0; k < ARCS; k++) {
        if (!(fabs(lengths[k]) > NOTHING))
            continue;
        double sign = lengths[k] > 0.0 ? 1.0 : -1.0;
        gears[0] = gears[0] == 0.0 ? sign : gears[0];
        gears[2] += sign * gears[1] < 0.0;
        gears[1] = sign;
    }
}

/* Select the words of every pair that are cheapest at full speed, in ascending order of price.
 *
 *   n, most                              numbers of pairs, and of words per pair, most < FORMS
 *   speed, reverse_speed, reverse_price  [m/s, m/s, s/m]
 *   radius                               [m]
 *   words                                (ARCS, FORMS, n), signed lengths, NaN without a solution [m]
 *   turns                                (FORMS, ARCS), 1 left, -1 right, 0 straight on
 *   pairs                                out, (n most,), index of the pair of each word
 *   driven                               out, (n most,), prices [s]
 *   gears                                out, (n most, 3), see `set_gears`
 *   lengths, curvatures                  out, (n most, ARCS) [m, 1/m]
 *
 * Return the number of words. */
int64_t optdock_cheapest_words(int64_t n, int64_t most, double speed, double reverse_speed, double reverse_price,
                               double radius, const double *words, const double *turns, int64_t *pairs, double *driven,
                               double *gears, double *lengths, double *curvatures)
{
    int64_t found = 0, forms[FORMS];
    double prices[FORMS];
    for (int64_t i = 0; i < n; i++) {
        int64_t count = 0;
        for (int64_t form = 0; form < FORMS; form++) {
            double price = 0.0;
            for (int64_t k = 0; k < ARCS; k++)
                price += driving_price(words[n * (FORMS * k + form) + i], speed, reverse_speed, reverse_price);
            if (!(price < INFINITY) || (count == most && !(price < prices[count - 1])))
                continue;
            int64_t at = count < most ? count++ : count - 1; /* the place of the last one if there are enough */
            for (; at > 0 && price < prices[at - 1]; at--) {
                prices[at] = prices[at - 1];
                forms[at] = forms[at - 1];
            }
            prices[at] = price;
            forms[at] = form;
        }
        for (int64_t rank = 0; rank < count; rank++, found++) {
            pairs[found] = i;
            driven[found] = prices[rank];
            for (int64_t k = 0; k < ARCS; k++) {
                lengths[ARCS * found + k] = words[n * (FORMS * k + forms[rank]) + i];
                curvatures[ARCS * found + k] = turns[ARCS * forms[rank] + k] / radius;
            }
            set_gears(lengths + ARCS * found, gears + 3 * found);
        }
    }
    return found;
}
