/* Poses of a path that is deformed, and their derivatives (D3): `driven` and `moves` of `deformation.py` in C.
 *
 * Sines and cosines are those of the C library, so results differ from the twin's by rounding. A deformed path is
 * judged by the certificate, which does not depend on this file.
 *
 * Arrays of a path with m gears and turns in place, and n knots:
 *
 *   signs      (m,), 1, -1, or 0 for a turn in place
 *   tails      (m,), length of the straight line at the end of a gear [m]
 *   turns      (m,), angle of a turn in place [rad]
 *   first      (m + 1,), index of the first knot of each gear, and n
 *   knots      (n,), of each gear from 0 [m]; curvature: (n,) [1/m]
 *   nodes      (4,), 3 Gauss nodes on [0, 1] in ascending order, and 1; shares: (3,), their weights
 *   places     (4,), Gauss nodes on [-1, 1]; weights: (4,) */

#include <math.h>
#include <stdint.h>

enum { NODES = 3, PLACES = 4 };

/* Compute the poses of a path.
 *
 *   start      (3,), first pose
 *   borders    out, (m + 1, 3), poses at the ends of the gears, the first is the start
 *   at_knots   out, (n, 3), poses at the knots
 *   at_nodes   out, (n, 3, 2), positions at the nodes of the piece behind a knot; 0 behind the last knot of a gear */
int64_t optdock_deformed_poses(int64_t m, int64_t n, const double *signs, const double *tails, const double *turns,
                               const int64_t *first, const double *knots, const double *curvature, const double *start,
                               const double *nodes, const double *places, const double *weights, double *borders,
                               double *at_knots, double *at_nodes)
{
    if (m < 1 || first[0] != 0 || first[m] != n)
        return -1;
    double x = start[0], y = start[1], yaw = start[2];
    for (int64_t i = 0; i < m; i++) {
        double *border = borders + 3 * i;
        border[0] = x, border[1] = y, border[2] = yaw;
        if (signs[i] == 0.0)
            yaw += turns[i];
        for (int64_t j = first[i]; j < first[i + 1]; j++) {
            double *knot = at_knots + 3 * j, *found = at_nodes + 2 * NODES * j;
            knot[0] = x, knot[1] = y, knot[2] = yaw;
            for (int64_t k = 0; k < 2 * NODES; k++)
                found[k] = 0.0;
            if (j + 1 == first[i + 1])
                break;
            double step = knots[j + 1] - knots[j], rate = (curvature[j + 1] - curvature[j]) / step, from = 0.0;
            for (int64_t k = 0; k <= NODES; k++) {
                double to = step * nodes[k], half = 0.5 * (to - from), middle = 0.5 * (from + to);
                double along = 0.0, across = 0.0;
                for (int64_t q = 0; q < PLACES; q++) {
                    double u = middle + half * places[q], heading = yaw + u * (curvature[j] + 0.5 * u * rate);
                    along += weights[q] * cos(heading);
                    across += weights[q] * sin(heading);
                }
                x += signs[i] * half * along;
                y += signs[i] * half * across;
                if (k < NODES)
                    found[2 * k] = x, found[2 * k + 1] = y;
                from = to;
            }
            yaw += 0.5 * step * (curvature[j] + curvature[j + 1]);
        }
        x += signs[i] * tails[i] * cos(yaw);
        y += signs[i] * tails[i] * sin(yaw);
    }
    double *end = borders + 3 * m;
    end[0] = x, end[1] = y, end[2] = yaw;
    return 0;
}

/* Compute the derivatives of a point of the robot by all variables: of each gear its curvatures and the logarithm of
 * its length, or the angle of a turn.
 *
 *   gear       the gear in which the robot is
 *   x, y       the point [m]
 *   share      driven share of a turn; driven: distance driven in a gear [m]
 *   x1, y1     position of the robot, before the straight tail [m]
 *   found      out, (3, n + m) */
int64_t optdock_deformation_moves(int64_t m, int64_t n, int64_t gear, double x, double y, double share, double driven,
                                  double x1, double y1, const double *signs, const int64_t *first, const double *knots,
                                  const double *curvature, const double *borders, const double *at_knots,
                                  const double *at_nodes, const double *nodes, const double *shares, double *found)
{
    if (m < 1 || gear < 0 || gear >= m || first[0] != 0 || first[m] != n)
        return -1;
    double *rows[3] = {found, found + (n + m), found + 2 * (n + m)};
    for (int64_t k = 0; k < 3 * (n + m); k++)
        found[k] = 0.0;
    for (int64_t i = 0; i <= gear; i++) {
        int64_t begin = first[i], end = first[i + 1], length = end + i;
        const double *border = borders + 3 * i;
        if (signs[i] == 0.0) {
            double part = i == gear ? share : 1.0;
            rows[0][length] = part * (border[1] - y);
            rows[1][length] = part * (x - border[0]);
            rows[2][length] = part;
            continue;
        }
        for (int64_t j = begin; j + 1 < end; j++) {
            double step = knots[j + 1] - knots[j];
            for (int64_t k = 0; k < NODES; k++) {
                if (i == gear && knots[j] + step * nodes[k] > driven)
                    continue;
                const double *at = at_nodes + 2 * (NODES * j + k);
                double weight = step * shares[k];
                double turned[3] = {weight * (at[1] - y), weight * (x - at[0]), weight};
                for (int64_t r = 0; r < 3; r++) {
                    rows[r][i + j] += turned[r] * (1.0 - nodes[k]);
                    rows[r][i + j + 1] += turned[r] * nodes[k];
                }
            }
        }
        for (int64_t r = 0; r < 3; r++)
            for (int64_t j = begin; j < end; j++)
                rows[r][length] += rows[r][i + j] * curvature[j];
        /* By the logarithm of the length, the turns and the travelled distance grow in proportion. */
        const double *last = at_knots + 3 * (end - 1);
        rows[0][length] += (i == gear ? x1 : last[0]) - border[0];
        rows[1][length] += (i == gear ? y1 : last[1]) - border[1];
    }
    return 0;
}
