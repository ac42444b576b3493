/* Poses of a sequence of arcs: the function `_poses_by_gear` of `arcs.py` in C.
 *
 * Sums and products are evaluated in the order of the twin, which also uses the trigonometric functions of the C library,
 * so the results are equal to the last bit. Only guesses depend on this file; the certificate has code of its own. */

#include <math.h>
#include <stdint.h>

/* The pose at the end of an arc, as `advance` of `arcs.py`. */
static void advance(const double *from, double length, double curvature, double *to)
{
    const double pi = 3.14159265358979323846;
    double turn = length * curvature, share = turn / (2.0 * pi);
    double angle = pi * (share == 0.0 ? 1e-20 : share), chord = length * (sin(angle) / angle);
    double middle = from[2] + 0.5 * turn, x = from[0] + chord * cos(middle), y = from[1] + chord * sin(middle);
    to[0] = x;
    to[1] = y;
    to[2] = from[2] + turn;
}

/* Poses of a sequence of arcs, gear by gear: the poses of every arc without its end, then the end of the gear.
 *
 *   n, fewest  numbers of arcs, and of poses of each that moves, without its end, at least
 *   spacing    largest distance of the poses along an arc [m]
 *   start      (3,); lengths, curvatures: (n,)
 *   poses      out, room for n (fewest + 2) poses and one per spacing, (., 3)
 *   counts     out, (n,), numbers of poses of each gear, negative in reverse
 *   found      out, (2,), numbers of poses and of gears */
int64_t optdock_poses_by_gear(int64_t n, int64_t fewest, double spacing, const double *start, const double *lengths,
                              const double *curvatures, double *poses, int64_t *counts, int64_t *found)
{
    double joint[3] = {start[0], start[1], start[2]};
    int64_t rows = 0, first = 0, gears = 0, gear = 0;
    for (int64_t i = 0; i < n; i++) {
        double length = fabs(lengths[i]), parts = ceil(length / spacing - 1e-9);
        if (length > 1e-9) {
            int64_t sign = lengths[i] > 0.0 ? 1 : -1;
            if (sign * gear < 0) { /* behind the end of the last gear */
                counts[gears++] = gear * (++rows - first);
                first = rows;
            }
            gear = sign;
            parts = parts < (double)fewest ? (double)fewest : parts;
            for (double rank = 0.0; rank < parts; rank += 1.0)
                advance(joint, lengths[i] * rank / parts, curvatures[i], poses + 3 * rows++);
            advance(joint, lengths[i], curvatures[i], poses + 3 * rows); /* the end, if it is that of a gear */
        }
        advance(joint, lengths[i], curvatures[i], joint);
    }
    counts[gears++] = gear * (++rows - first);
    found[0] = rows;
    found[1] = gears;
    return 0;
}
