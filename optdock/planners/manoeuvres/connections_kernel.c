/* The cheapest Reeds-Shepp words between pairs of poses: `_cheapest` of `connections.py` and the closed forms of
 * `reeds_shepp.py` in C.
 *
 * Sums and products are evaluated in the order of the twins, which also use the trigonometric functions of the C library,
 * so the results are equal to the last bit. Only guesses depend on this file; the certificate has code of its own. */

#include <math.h>
#include <stdint.h>

#define MIRRORS 4     /* identity, time reversal, reflection, both */
#define FORMS 44      /* words of a pair: eleven solutions with four mirrors each */
#define ARCS 5        /* arcs and lines of a word */
#define NOTHING 1e-6  /* [m]: shorter arcs do not count as motion */
#define ROUNDING 1e-10 /* [rad]: tolerance of the sign of an arc */

static const double PI = 3.141592653589793, HALF_PI = 0.5 * 3.141592653589793;

/* Vector from the centre of the first arc, a left turn, to that of the last one, in turning radii: square of its length,
 * length, direction; length of the line that touches two opposite circles, and its angle to the vector. */
typedef struct {
    double squared, apart, bearing, tangent, slope;
} Centres;

/* Lengths of the arcs of the words of one pair of poses, whether a word exists, and the signed turning radius. */
typedef struct {
    double lengths[FORMS][ARCS], radius;
    int exists[FORMS];
} Words;

static double within_half_turn(double angle) { return angle - 2.0 * PI * rint(angle / (2.0 * PI)); }

static Centres between_centres(double xi, double eta)
{
    Centres to = {xi * xi + eta * eta, 0.0, atan2(eta, xi), 0.0, 0.0};
    to.apart = sqrt(to.squared);
    if (to.squared >= 4.0) { /* the words that use them exist only then */
        to.tangent = sqrt(to.squared - 4.0);
        to.slope = atan2(2.0, to.tangent);
    }
    return to;
}

/* Note a word of five arcs, in the order in which they are driven. */
static void set_word(Words *words, int form, double t, double u, double v, double w, double x)
{
    double *lengths = words->lengths[form], radius = words->radius;
    lengths[0] = t * radius;
    lengths[1] = u * radius;
    lengths[2] = v * radius;
    lengths[3] = w * radius;
    lengths[4] = x * radius;
    words->exists[form] = 1;
}

/* Solve the forms whose first and last arc turn to the same side: equations 8.1, 8.3, 8.4 and 8.9. `mirror`: number of
 * the mirror; `bearings`: directions of the vectors of the mirror, from the start to the goal and back; `half`: angle of
 * equation 8.3, of vectors up to 4. */
static void solve_same(Words *words, int mirror, const Centres *to, const double *bearings, double half, double phi)
{
    double t = within_half_turn(bearings[0]), v = within_half_turn(phi - t), u = 2.0 - to->tangent;
    if (t >= -ROUNDING && v >= -ROUNDING)
        set_word(words, mirror, t, to->apart, v, 0.0, 0.0);
    for (int back = 0; back < 2; back++) {
        int form = mirror + MIRRORS * back;
        t = within_half_turn(bearings[back] + 0.5 * half + PI);
        v = within_half_turn(phi - t + half);
        if (to->apart <= 4.0 && t >= -ROUNDING)
            set_word(words, 2 * MIRRORS + form, back ? v : t, half, back ? t : v, 0.0, 0.0);
        t = within_half_turn(bearings[back] + to->slope + HALF_PI);
        v = within_half_turn(phi - HALF_PI - t);
        if (!(to->apart >= 2.0 && t >= -ROUNDING && u <= ROUNDING && v <= ROUNDING))
            continue;
        if (back)
            set_word(words, 6 * MIRRORS + form, v, u, -HALF_PI, t, 0.0);
        else
            set_word(words, 6 * MIRRORS + form, t, -HALF_PI, u, v, 0.0);
    }
}

/* Angles of the forms of four arcs: of equations 8.7 and 8.8, and the direction of the second one. */
typedef struct {
    double rho, other, once, twice, towards;
} FourArcs;

static FourArcs four_arcs(const Centres *to)
{
    FourArcs of = {0.25 * (2.0 + to->apart), (20.0 - to->squared) / 16.0, 0.0, 0.0, 0.0};
    if (of.rho <= 1.0)
        of.once = acos(of.rho);
    if (of.other >= 0.0 && of.other <= 1.0) {
        of.twice = acos(of.other);
        of.towards = atan2(of.other - 2.0, -sqrt(1.0 - of.other * of.other));
    }
    return of;
}

/* Solve the forms of four arcs of a mirror: equations 8.7 and 8.8. */
static void solve_four(Words *words, int mirror, const FourArcs *of, double bearing, double phi)
{
    double t, v;
    if (of->rho <= 1.0) {
        t = within_half_turn(bearing + of->once + HALF_PI);
        v = within_half_turn(t - of->once - of->once - phi);
        if (t >= -ROUNDING && v <= ROUNDING)
            set_word(words, 4 * MIRRORS + mirror, t, of->once, -of->once, v, 0.0);
    }
    if (of->other >= 0.0 && of->other <= 1.0) {
        t = within_half_turn(bearing - of->towards);
        v = within_half_turn(t - phi);
        if (t >= -ROUNDING && v >= -ROUNDING)
            set_word(words, 5 * MIRRORS + mirror, t, -of->twice, -of->twice, v, 0.0);
    }
}

/* Solve the other forms whose first and last arc turn to different sides: equations 8.2, 8.10 and 8.11. `apart`,
 * `bearings`: lengths and directions of the vectors of the mirror, from the start to the goal and back. */
static void solve_other(Words *words, int mirror, const Centres *to, const double *apart, const double *bearings,
                        double phi)
{
    double t = within_half_turn(bearings[0] + to->slope), v = within_half_turn(t - phi), u = 4.0 - to->tangent;
    if (to->squared >= 4.0 && t >= -ROUNDING && v >= -ROUNDING)
        set_word(words, MIRRORS + mirror, t, to->tangent, v, 0.0, 0.0);
    t = within_half_turn(bearings[0] + to->slope + HALF_PI);
    v = within_half_turn(t - phi);
    if (to->apart >= 2.0 && u <= ROUNDING && t >= -ROUNDING && v >= -ROUNDING)
        set_word(words, 10 * MIRRORS + mirror, t, -HALF_PI, u, -HALF_PI, v);
    for (int back = 0; back < 2; back++) {
        t = within_half_turn(bearings[back] + HALF_PI);
        u = 2.0 - apart[back];
        v = within_half_turn(t + HALF_PI - phi);
        if (!(apart[back] >= 2.0 && t >= -ROUNDING && u <= ROUNDING && v <= ROUNDING))
            continue;
        if (back)
            set_word(words, 9 * MIRRORS + mirror, v, u, -HALF_PI, t, 0.0);
        else
            set_word(words, 8 * MIRRORS + mirror, t, -HALF_PI, u, v, 0.0);
    }
}

/* Set the words between two poses, (3,) each. */
static void set_words(Words *words, const double *start, const double *goal, double radius)
{
    double dx = (goal[0] - start[0]) / radius, dy = (goal[1] - start[1]) / radius, phi = goal[2] - start[2];
    double c0 = cos(start[2]), s0 = sin(start[2]), c = cos(phi), s = sin(phi);
    double x = c0 * dx + s0 * dy, y = c0 * dy - s0 * dx;
    Centres same[2], other[2];
    double across[MIRRORS];
    for (int side = 0; side < 2; side++) {
        double turn = side ? -1.0 : 1.0, left = turn * y - 1.0;
        same[side] = between_centres(x - turn * s, left + c);
        other[side] = between_centres(x + turn * s, left - c);
        across[2 * side] = other[side].bearing;
        across[2 * side + 1] = PI - other[side].bearing;
    }
    for (int form = 0; form < FORMS; form++)
        words->exists[form] = 0;
    for (int side = 0; side < 2; side++) {
        double half = same[side].apart <= 4.0 ? -2.0 * asin(0.25 * same[side].apart) : 0.0;
        FourArcs of = four_arcs(other + side);
        for (int reversed = 0; reversed < 2; reversed++) {
            int mirror = 2 * side + reversed;
            double turned = (side == reversed ? 1.0 : -1.0) * phi;
            double ahead = reversed ? PI - same[side].bearing : same[side].bearing;
            double along[2] = {ahead, turned - ahead}, apart[2] = {other[side].apart, other[1 - side].apart};
            double crossing[2] = {across[mirror], across[(mirror + 2) % MIRRORS] + turned};
            words->radius = (reversed ? -1.0 : 1.0) * radius;
            solve_same(words, mirror, same + side, along, half, turned);
            solve_four(words, mirror, &of, crossing[0], turned);
            solve_other(words, mirror, other + side, apart, crossing, turned);
        }
    }
}

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
 *   n, most                              numbers of pairs, and of words per pair, most <= FORMS
 *   speed, reverse_speed, reverse_price  [m/s, m/s, s/m]
 *   radius                               [m]
 *   starts, goals                        (n, 3), poses [m, m, rad]
 *   turns                                (FORMS, ARCS), 1 left, -1 right, 0 straight on
 *   pairs                                out, (n most,), index of the pair of each word
 *   driven                               out, (n most,), prices [s]
 *   gears                                out, (n most, 3), see `set_gears`
 *   lengths, curvatures                  out, (n most, ARCS) [m, 1/m]
 *
 * Return the number of words. */
int64_t optdock_cheapest_words(int64_t n, int64_t most, double speed, double reverse_speed, double reverse_price,
                               double radius, const double *starts, const double *goals, const double *turns,
                               int64_t *pairs, double *driven, double *gears, double *lengths, double *curvatures)
{
    int64_t found = 0, forms[FORMS];
    double prices[FORMS];
    Words words;
    for (int64_t i = 0; i < n; i++) {
        int64_t count = 0;
        set_words(&words, starts + 3 * i, goals + 3 * i, radius);
        for (int64_t form = 0; form < FORMS; form++) {
            if (!words.exists[form])
                continue;
            double price = 0.0;
            for (int64_t k = 0; k < ARCS; k++)
                price += driving_price(words.lengths[form][k], speed, reverse_speed, reverse_price);
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
                lengths[ARCS * found + k] = words.lengths[forms[rank]][k];
                curvatures[ARCS * found + k] = turns[ARCS * forms[rank] + k] / radius;
            }
            set_gears(lengths + ARCS * found, gears + 3 * found);
        }
    }
    return found;
}
