/* Poses of a path that is deformed, their derivatives (D3), and contacts with obstacles: `driven`, `moves` and `contact`
 * of `deformation.py` in C.
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

/* A convex polygon: corners, outward normals, their offsets. */
typedef struct {
    int64_t count;
    const double *x, *y, *normal_x, *normal_y, *offsets;
    int64_t stride; /* between the elements of the first four */
} Polygon;

typedef struct {
    double distance, x, y; /* along the unit vector (x, y) from obstacle to body */
} Gap;

/* Return the largest gap between a polygon and points (count, 2) along the polygon's normals, which are in the frame of
 * the points; the axis is that normal. */
static Gap along_normals(Polygon polygon, const double *points, int64_t count)
{
    Gap best = {-INFINITY, 1.0, 0.0};
    for (int64_t j = 0; j < polygon.count; j++) {
        double x = polygon.normal_x[j * polygon.stride], y = polygon.normal_y[j * polygon.stride], low = INFINITY;
        for (int64_t i = 0; i < count; i++) {
            double height = x * points[2 * i] + y * points[2 * i + 1];
            low = height < low ? height : low;
        }
        if (low - polygon.offsets[j] > best.distance)
            best = (Gap){low - polygon.offsets[j], x, y};
    }
    return best;
}

/* Return the gap between points (count, 2) and an obstacle along the line through the nearest two corners. */
static Gap along_corners(const double *points, int64_t count, Polygon obstacle)
{
    double x = 0.0, y = 0.0, least = INFINITY, low = INFINITY, high = -INFINITY;
    for (int64_t i = 0; i < count; i++) {
        for (int64_t j = 0; j < obstacle.count; j++) {
            double dx = points[2 * i] - obstacle.x[j], dy = points[2 * i + 1] - obstacle.y[j];
            if (dx * dx + dy * dy < least)
                least = dx * dx + dy * dy, x = dx, y = dy;
        }
    }
    double length = sqrt(least);
    if (!(length > 1e-12))
        return (Gap){-INFINITY, 1.0, 0.0};
    x *= 1.0 / length, y *= 1.0 / length;
    for (int64_t i = 0; i < count; i++) {
        double height = x * points[2 * i] + y * points[2 * i + 1];
        low = height < low ? height : low;
    }
    for (int64_t j = 0; j < obstacle.count; j++) {
        double height = x * obstacle.x[j] + y * obstacle.y[j];
        high = height > high ? height : high;
    }
    return (Gap){low - high, x, y};
}

/* Return the signed distance of a body at a pose from an obstacle, and its axis.
 *
 *   cosine, sine   of the yaw
 *   corners        (body.count, 2), corners of the body at the pose
 *   local          work, (obstacle.count, 2) */
static Gap separation(Polygon body, double x, double y, double cosine, double sine, const double *corners,
                      Polygon obstacle, double *local)
{
    Gap best = along_normals(obstacle, corners, body.count);
    for (int64_t j = 0; j < obstacle.count; j++) {
        double dx = obstacle.x[j] - x, dy = obstacle.y[j] - y;
        local[2 * j] = cosine * dx + sine * dy;
        local[2 * j + 1] = cosine * dy - sine * dx;
    }
    Gap own = along_normals(body, local, obstacle.count);
    if (own.distance > best.distance)
        best = (Gap){own.distance, sine * own.y - cosine * own.x, -sine * own.x - cosine * own.y};
    Gap between = along_corners(corners, body.count, obstacle);
    return between.distance > best.distance ? between : best;
}

/* Return the point of the body that is nearest to the obstacle: a corner; on an edge along the obstacle, whose corners
 * are equally near up to `flat`, the point next to the nearest corner of the obstacle. */
static void nearest_point(const double *corners, int64_t count, Polygon obstacle, Gap gap, double flat, double *point)
{
    double low = INFINITY, high = -INFINITY;
    int64_t first = -1, last = -1, facing = 0;
    for (int64_t i = 0; i < count; i++) {
        double height = corners[2 * i] * gap.x + corners[2 * i + 1] * gap.y;
        low = height < low ? height : low;
    }
    for (int64_t i = 0; i < count; i++) {
        if (corners[2 * i] * gap.x + corners[2 * i + 1] * gap.y <= low + flat) {
            first = first < 0 ? i : first;
            last = i;
        }
    }
    if (first < 0) /* not a number */
        first = last = 0;
    point[0] = corners[2 * first], point[1] = corners[2 * first + 1];
    if (first == last)
        return;
    for (int64_t j = 0; j < obstacle.count; j++) {
        double height = obstacle.x[j] * gap.x + obstacle.y[j] * gap.y;
        if (height > high)
            high = height, facing = j;
    }
    double dx = corners[2 * last] - point[0], dy = corners[2 * last + 1] - point[1];
    double share = ((obstacle.x[facing] - point[0]) * dx + (obstacle.y[facing] - point[1]) * dy) / (dx * dx + dy * dy);
    share = share < 0.0 ? 0.0 : share > 1.0 ? 1.0 : share;
    point[0] += dx * share, point[1] += dy * share;
}

/* Return the pose at a share of the length of a gear, and the distance driven in the gear. */
static double pose_at(int64_t gear, double share, const double *signs, const double *tails, const double *turns,
                      const int64_t *first, const double *knots, const double *curvature, const double *borders,
                      const double *at_knots, const double *places, const double *weights, double *pose)
{
    if (signs[gear] == 0.0) {
        const double *border = borders + 3 * gear;
        pose[0] = border[0], pose[1] = border[1], pose[2] = border[2] + share * turns[gear];
        return 0.0;
    }
    int64_t last = first[gear + 1] - 1, row = first[gear];
    double driven = share * (knots[last] + tails[gear]);
    while (row < last && knots[row + 1] <= driven)
        row++;
    const double *at = at_knots + 3 * row;
    double step = driven - knots[row], bend = curvature[row], slope = 0.0, along = 0.0, across = 0.0;
    if (row < last)
        slope = (curvature[row + 1] - bend) / (knots[row + 1] - knots[row]);
    for (int64_t q = 0; q < PLACES; q++) {
        double u = 0.5 * step * (1.0 + places[q]), heading = at[2] + u * (bend + 0.5 * u * slope);
        along += weights[q] * cos(heading);
        across += weights[q] * sin(heading);
    }
    pose[0] = at[0] + 0.5 * signs[gear] * step * along;
    pose[1] = at[1] + 0.5 * signs[gear] * step * across;
    pose[2] = at[2] + step * (bend + 0.5 * step * slope);
    return driven;
}

/* Compute the missing clearances of the robot at places of the path, and the derivatives of its clearances.
 *
 *   k              number of pushes
 *   size, most     of `numbers`; largest number of corners of a body and its obstacle
 *   flat           tolerance of corners of an edge along the obstacle [m]
 *   sizes          (k, 3), gear, corners of the body, v, and of the obstacle, q
 *   numbers        of each push: share of the gear, required distance [m]; of the body corners (v, 2), normals (v, 2)
 *                  and their offsets (v,); of the obstacle x, y, normals' x and y, and their offsets, (q,) each
 *   work           3 (n + m) + 2 most numbers
 *   found          out, (k, n + m)
 *   missing        out, (k,) [m] */
int64_t optdock_deformation_contacts(int64_t m, int64_t n, int64_t k, int64_t size, int64_t most, double flat,
                                     const double *signs, const double *tails, const double *turns,
                                     const int64_t *first, const double *knots, const double *curvature,
                                     const double *borders, const double *at_knots, const double *at_nodes,
                                     const int64_t *sizes, const double *numbers, const double *nodes,
                                     const double *shares, const double *places, const double *weights, double *work,
                                     double *found, double *missing)
{
    const double *end = numbers + size;
    double *moves = work, *corners = moves + 3 * (n + m);
    if (m < 1 || first[0] != 0 || first[m] != n)
        return -1;
    for (int64_t i = 0; i < k; i++) {
        int64_t gear = sizes[3 * i], v = sizes[3 * i + 1], q = sizes[3 * i + 2];
        if (gear < 0 || gear >= m || v < 1 || q < 1 || v + q > most || end - numbers < 2 + 5 * (v + q))
            return -1;
        double share = numbers[0], distance = numbers[1], pose[3], point[2];
        const double *own = numbers + 2, *other = own + 5 * v;
        Polygon body = {v, own, own + 1, own + 2 * v, own + 2 * v + 1, own + 4 * v, 2};
        Polygon obstacle = {q, other, other + q, other + 2 * q, other + 3 * q, other + 4 * q, 1};
        double driven = pose_at(gear, share, signs, tails, turns, first, knots, curvature, borders, at_knots, places,
                                weights, pose);
        double cosine = cos(pose[2]), sine = sin(pose[2]);
        for (int64_t j = 0; j < v; j++) {
            corners[2 * j] = pose[0] + (cosine * own[2 * j] - sine * own[2 * j + 1]);
            corners[2 * j + 1] = pose[1] + (sine * own[2 * j] + cosine * own[2 * j + 1]);
        }
        Gap gap = separation(body, pose[0], pose[1], cosine, sine, corners, obstacle, corners + 2 * v);
        nearest_point(corners, v, obstacle, gap, flat, point);
        const double *robot = pose;
        if (signs[gear] != 0.0 && driven > knots[first[gear + 1] - 1])
            robot = at_knots + 3 * (first[gear + 1] - 1);
        optdock_deformation_moves(m, n, gear, point[0], point[1], share, driven, robot[0], robot[1], signs, first,
                                  knots, curvature, borders, at_knots, at_nodes, nodes, shares, moves);
        for (int64_t j = 0; j < n + m; j++)
            found[(n + m) * i + j] = gap.x * moves[j] + gap.y * moves[n + m + j];
        missing[i] = distance - gap.distance;
        numbers = other + 5 * q;
    }
    return 0;
}
