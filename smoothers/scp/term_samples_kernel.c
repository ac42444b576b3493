/* Samples of clothoid splines for terms, by equation (S26) of docs/theory/smoother.md: the function `_clothoid_samples` of
 * `term_samples.py` in C. */

#include <math.h>
#include <stdint.h>

enum { SYMBOLS = 7 }; /* see `SYMBOLS` in terms.py */

/* A row of `ClothoidSpline.table`. */
typedef struct {
    double s, x, y, yaw, curvature, rate;
} Break;

/* The state at an arc length behind a break. */
typedef struct {
    double s, yaw, curvature, cosine, sine;
} State;

static State state_at(const Break *from)
{
    return (State){0.0, from->yaw, from->curvature, cos(from->yaw), sin(from->yaw)};
}

/* The state at a later arc length, at which the heading has changed by a small angle: the direction is turned by sums of
 * Taylor whose remainders, turn^6 / 720 and turn^7 / 5040, are below the resolution of doubles for 0.01 rad. */
static State moved_to(State at, const Break *from, double s)
{
    double yaw = from->yaw + s * (from->curvature + 0.5 * s * from->rate);
    double turn = (s - at.s) * (at.curvature + 0.5 * (s - at.s) * from->rate), square = turn * turn;
    double c = 1.0 - square * (0.5 - square / 24.0), n = turn * (1.0 - square * (1.0 / 6.0 - square / 120.0));
    return (State){s, yaw, from->curvature + s * from->rate, c * at.cosine - n * at.sine, n * at.cosine + c * at.sine};
}

/* Replace the headings of n points by the equivalent angles in [-pi, pi), as the function `wrap_angles`.
 *
 *   points   in and out, (n, 7) */
int64_t optdock_wrap_headings(int64_t n, double *points)
{
    const double pi = 3.141592653589793;
    for (double *yaw = points + 2; n > 0; n--, yaw += SYMBOLS) {
        double turned = *yaw + pi;
        if (!(turned >= 0.0 && turned < 2.0 * pi))
            turned = fmod(turned, 2.0 * pi);
        *yaw = (turned < 0.0 ? turned + 2.0 * pi : turned) - pi;
    }
    return 0;
}

/* Compute the symbols at evenly spaced samples of a spline, both ends included. The spline turns by 0.01 rad at most
 * between samples.
 *
 *   n, count        numbers of samples and of breaks
 *   has_places      whether positions and headings are computed; otherwise they are 0
 *   sign            +1 forward, -1 reverse
 *   driven, whole   distance driven before the spline, and at the end of the path [m]
 *   table           (count, 6), see `Break`
 *   s               out, (n,), arc lengths [m]
 *   points          out, (n, 7) */
int64_t optdock_clothoid_samples(int64_t n, int64_t count, int64_t has_places, double sign, double driven,
                                 double whole, const double *table, double *s, double *points)
{
    const Break *from = (const Break *)table, *last = from + count - 2;
    double length = last[1].s, step = length / (double)(n - 1), x = from->x, y = from->y;
    State at = state_at(from); /* where the position is (x, y) */
    for (int64_t i = 0; i < n; i++) {
        double *point = points + SYMBOLS * i;
        s[i] = i < n - 1 ? (double)i * step : length;
        while (from < last && s[i] >= from[1].s) {
            from++;
            x = from->x;
            y = from->y;
            at = state_at(from);
        }
        if (has_places) {
            State next = moved_to(at, from, s[i] - from->s);
            double moved = next.s - at.s, half = 0.5 * sign * moved, bent = sign * moved * moved / 12.0;
            x += half * (at.cosine + next.cosine) + bent * (next.curvature * next.sine - at.curvature * at.sine);
            y += half * (at.sine + next.sine) + bent * (at.curvature * at.cosine - next.curvature * next.cosine);
            at = next;
        }
        point[0] = has_places ? x : 0.0;
        point[1] = has_places ? y : 0.0;
        point[2] = has_places ? at.yaw : 0.0;
        point[3] = from->curvature + (s[i] - from->s) * from->rate;
        point[4] = driven + s[i];
        point[5] = whole - point[4];
        point[6] = sign;
    }
    return has_places ? optdock_wrap_headings(n, points) : 0;
}
