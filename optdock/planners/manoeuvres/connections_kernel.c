/* The cheapest Reeds-Shepp words between pairs of poses: `words_between` and `_connected` of `connections.py`, and the
 * closed forms of `reeds_shepp.py` in C.
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

/* Bounds and prices of motion: `words_between` of `connections.py`. */
typedef struct {
    double speed, reverse_speed, reverse_price, radius; /* [m/s, m/s, s/m, m] */
} Driving;

/* Select the words between two poses that are cheapest at full speed, in ascending order of price, at most `most`.
 * forms, prices: out, (most,). Return their number. */
static int64_t select_words(Words *words, const Driving *driving, int64_t most, const double *start, const double *goal,
                            int64_t *forms, double *prices)
{
    int64_t count = 0;
    set_words(words, start, goal, driving->radius);
    for (int64_t form = 0; form < FORMS; form++) {
        if (!words->exists[form])
            continue;
        double price = 0.0;
        for (int64_t k = 0; k < ARCS; k++)
            price += driving_price(words->lengths[form][k], driving->speed, driving->reverse_speed,
                                   driving->reverse_price);
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
    return count;
}

/* Copy lengths and curvatures of a word, (ARCS,) each, and its gears, see `set_gears`. */
static void copy_word(const Words *words, int64_t form, const double *turns, double radius, double *lengths,
                      double *curvatures, double *gears)
{
    for (int64_t k = 0; k < ARCS; k++) {
        lengths[k] = words->lengths[form][k];
        curvatures[k] = turns[ARCS * form + k] / radius;
    }
    set_gears(lengths, gears);
}

/* Select the words of every pair that are cheapest at full speed, in ascending order of price.
 *
 *   n, most                              numbers of pairs, and of words per pair, most <= FORMS
 *   speed ... radius                     see `Driving`
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
    Driving driving = {speed, reverse_speed, reverse_price, radius};
    int64_t found = 0, forms[FORMS];
    double prices[FORMS];
    Words words;
    for (int64_t i = 0; i < n; i++) {
        int64_t count = select_words(&words, &driving, most, starts + 3 * i, goals + 3 * i, forms, prices);
        for (int64_t rank = 0; rank < count; rank++, found++) {
            pairs[found] = i;
            driven[found] = prices[rank];
            copy_word(&words, forms[rank], turns, radius, lengths + ARCS * found, curvatures + ARCS * found,
                      gears + 3 * found);
        }
    }
    return found;
}

/* Select the cheapest words between nodes of two trees as `optdock_cheapest_words`, omit those in gears that are not
 * allowed, and add the prices of the nodes and of changes of gear.
 *
 *   n, most ... radius   as above
 *   stop                 price of a change of gear [s]
 *   wanted, start_speed  signs of the last and of the first gear, 0 for any
 *   exit_rows, entry_rows  (n,), rows of the trees
 *   exits, entries       (nodes, 7): pose, price, sign and length of the last arc, curvature
 *   turns                as above
 *   prices, changes      out, (n most,), prices [s] and numbers of changes of gear
 *   rows                 out, (2, n most), rows of the exits and of the entries
 *   lengths, curvatures  out, (n most, ARCS) [m, 1/m]
 *
 * Return the number of words. */
int64_t optdock_connections(int64_t n, int64_t most, double speed, double reverse_speed, double reverse_price,
                            double radius, double stop, double wanted, double start_speed, const int64_t *exit_rows,
                            const int64_t *entry_rows, const double *exits, const double *entries, const double *turns,
                            double *prices, double *changes, int64_t *rows, double *lengths, double *curvatures)
{
    Driving driving = {speed, reverse_speed, reverse_price, radius};
    int64_t found = 0, forms[FORMS];
    double driven[FORMS], gears[3];
    Words words;
    for (int64_t i = 0; i < n; i++) {
        const double *exit = exits + 7 * exit_rows[i], *entry = entries + 7 * entry_rows[i];
        double before = exit[4], after = -entry[4];
        int64_t count = select_words(&words, &driving, most, exit, entry, forms, driven);
        for (int64_t rank = 0; rank < count; rank++) {
            copy_word(&words, forms[rank], turns, radius, lengths + ARCS * found, curvatures + ARCS * found, gears);
            int stays = gears[0] == 0.0;
            double first = before != 0.0 ? before : stays ? after : gears[0];
            double last = after != 0.0 ? after : stays ? before : gears[1];
            if (first == 0.0 || (wanted != 0.0 && !(last * wanted > 0.0)) ||
                (start_speed != 0.0 && !(first * start_speed > 0.0)))
                continue;
            double cusps = gears[2] + (before * gears[0] < 0.0) + (gears[1] * after < 0.0) +
                           (stays && before * after < 0.0);
            prices[found] = driven[rank] + exit[3] + entry[3];
            prices[found] += stop * cusps;
            changes[found] = cusps;
            rows[found] = exit_rows[i];
            rows[n * most + found] = entry_rows[i];
            found++;
        }
    }
    return found;
}
