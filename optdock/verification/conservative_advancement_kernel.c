/* Lower bounds of the clearance of one convex body over stretches of motion: the function `_body_bounds` of
 * `conservative_advancement.py` in C. Equation numbers are those of docs/theory/certificate.md.
 *
 * Every sum and product is evaluated in the order of the twin, and angles enter as the sines and cosines that NumPy has
 * computed, so the results are equal to the last bit. A NaN is kept by every minimum and maximum and ends as a bound of
 * -inf, which proves nothing.
 *
 * Part of the trusted code of a certificate. It calls no other file. */

#include <math.h>
#include <stdint.h>

/* A convex body in its own frame. */
typedef struct {
    int64_t corners, circles;
    double radius, reach;   /* of the bounding circles; of the corners, from the origin [m] */
    const double *vertices; /* (corners, 2) [m] */
    const double *normals;  /* (corners, 2), outward */
    const double *offsets;  /* (corners,) [m] */
    const double *centres;  /* (circles, 2) [m] */
} Body;

/* A convex obstacle in the world. */
typedef struct {
    int64_t corners;
    const double *vertices; /* (corners, 2) [m] */
    const double *normals;  /* (corners, 2), outward */
    const double *offsets;  /* (corners,) [m] */
} Piece;

typedef struct {
    double x, y, c, s; /* position [m], cosine and sine of the heading */
} Pose;

/* Signed distance and the unit axis, from the obstacle to the body, that attains it. */
typedef struct {
    double distance, x, y;
} Gap;

/* The motion over one stretch: d pose / du at its pose, and the bounds of (C4). */
typedef struct {
    double x, y, yaw;                       /* velocity [m, m, rad per u] */
    double width, speed, turn, bend, twist; /* see `Advances` */
} Stretch;

/* Minimum and maximum that are NaN if any of the two values is. */
static double least(double a, double b) { return a < b || a != a ? a : b; }

static double most(double a, double b) { return a > b || a != a ? a : b; }

/* Whether a value comes before the largest so far; the first NaN comes before all numbers. */
static int is_larger(double value, double best) { return value > best || (value != value && best == best); }

static void place_corners(const Body *body, Pose at, double *corners)
{
    for (int64_t v = 0; v < body->corners; v++) {
        double x = body->vertices[2 * v], y = body->vertices[2 * v + 1];
        corners[2 * v] = at.x + (at.c * x - at.s * y);
        corners[2 * v + 1] = at.y + (at.s * x + at.c * y);
    }
}

/* Smallest product of an axis with one of the points (count, 2). */
static double lowest(double x, double y, const double *points, int64_t count)
{
    double low = x * points[0] + y * points[1];
    for (int64_t i = 1; i < count; i++)
        low = least(low, x * points[2 * i] + y * points[2 * i + 1]);
    return low;
}

static double highest(double x, double y, const double *points, int64_t count)
{
    double high = x * points[0] + y * points[1];
    for (int64_t i = 1; i < count; i++)
        high = most(high, x * points[2 * i] + y * points[2 * i + 1]);
    return high;
}

/* (C3) over the outward normals of the obstacle. */
static Gap along_piece_normals(const double *corners, int64_t count, const Piece *piece)
{
    Gap best = {0.0, 0.0, 0.0};
    for (int64_t k = 0; k < piece->corners; k++) {
        double x = piece->normals[2 * k], y = piece->normals[2 * k + 1];
        double distance = lowest(x, y, corners, count) - piece->offsets[k];
        if (k == 0 || is_larger(distance, best.distance))
            best = (Gap){distance, x, y};
    }
    return best;
}

/* (C3) over the outward normals of the body; local: work, (corners of the piece, 2). */
static Gap along_body_normals(const Body *body, Pose at, const Piece *piece, double *local)
{
    for (int64_t k = 0; k < piece->corners; k++) {
        double x = piece->vertices[2 * k] - at.x, y = piece->vertices[2 * k + 1] - at.y;
        local[2 * k] = at.c * x + at.s * y;
        local[2 * k + 1] = at.c * y - at.s * x;
    }
    Gap best = {0.0, 0.0, 0.0};
    for (int64_t v = 0; v < body->corners; v++) {
        double x = body->normals[2 * v], y = body->normals[2 * v + 1];
        double distance = lowest(x, y, local, piece->corners) - body->offsets[v];
        if (v == 0 || is_larger(distance, best.distance))
            best = (Gap){distance, at.s * y - at.c * x, -at.s * x - at.c * y};
    }
    return best;
}

/* (C3) along the line through the nearest two vertices; -inf if they coincide and define no axis. */
static Gap along_nearest_vertices(const double *corners, int64_t count, const Piece *piece)
{
    double nearest = 0.0, x = 0.0, y = 0.0;
    for (int64_t v = 0; v < count; v++) {
        for (int64_t k = 0; k < piece->corners; k++) {
            double dx = corners[2 * v] - piece->vertices[2 * k];
            double dy = corners[2 * v + 1] - piece->vertices[2 * k + 1];
            double squared = dx * dx + dy * dy;
            if (v + k == 0 || squared < nearest || (squared != squared && nearest == nearest)) {
                nearest = squared;
                x = dx;
                y = dy;
            }
        }
    }
    double length = sqrt(nearest), scale = 1.0 / most(length, 1e-300);
    x *= scale;
    y *= scale;
    if (!(length > 1e-12))
        return (Gap){-INFINITY, x, y};
    return (Gap){lowest(x, y, corners, count) - highest(x, y, piece->vertices, piece->corners), x, y};
}

/* (C3): the exact signed distance. work: (corners of the body + corners of the piece, 2). */
static Gap separation(const Body *body, Pose at, const Piece *piece, double *work)
{
    place_corners(body, at, work);
    Gap best = along_piece_normals(work, body->corners, piece);
    Gap other = along_body_normals(body, at, piece, work + 2 * body->corners);
    if (other.distance > best.distance)
        best = other;
    other = along_nearest_vertices(work, body->corners, piece);
    return other.distance > best.distance ? other : best;
}

/* Lower bound of the distance of a body from the box (lower, upper) of an obstacle, by the body's circles. */
static double broad_gap(const Body *body, const double *circles, const double *lower, const double *upper)
{
    double nearest = INFINITY; /* squared; the square root is monotonic, so one at the end suffices */
    for (int64_t i = 0; i < body->circles; i++) {
        double x = circles[2 * i], y = circles[2 * i + 1];
        double across = most(most(lower[0] - x, x - upper[0]), 0.0);
        double along = most(most(lower[1] - y, y - upper[1]), 0.0);
        nearest = least(nearest, across * across + along * along);
    }
    return sqrt(nearest) - body->radius;
}

/* First-order part of (C5): min over the vertices of n.v + n.v' du, less min of n.v, at du = width. */
static double directional(const Body *body, Pose at, Stretch motion, Gap gap)
{
    double across = gap.x * at.c + gap.y * at.s, along = gap.y * at.c - gap.x * at.s; /* axis in the body's frame */
    double push = gap.x * motion.x + gap.y * motion.y;
    double before = 0.0, after = 0.0;
    for (int64_t v = 0; v < body->corners; v++) {
        double x = body->vertices[2 * v], y = body->vertices[2 * v + 1];
        double height = across * x + along * y;
        double rate = push + motion.yaw * (along * x - across * y);
        double moved = height + motion.width * rate;
        before = v == 0 ? height : least(before, height);
        after = v == 0 ? moved : least(after, moved);
    }
    return after - before;
}

/* The larger part of a stretch's motion that (C5) subtracts in second order. */
static double stray(const Body *body, Stretch motion)
{
    return 0.5 * (motion.bend + body->reach * motion.twist) * (motion.width * motion.width);
}

static double travel(const Body *body, Stretch motion)
{
    return motion.width * (motion.speed + body->reach * motion.turn);
}

/* motions: (8, n), the rows x, y, yaw, width, speed, turn, bend, twist. */
static Stretch stretch_at(const double *motions, int64_t n, int64_t i)
{
    const double *m = motions + i;
    return (Stretch){m[0], m[n], m[2 * n], m[3 * n], m[4 * n], m[5 * n], m[6 * n], m[7 * n]};
}

/* Group the n stretches by their pose: those of pose p are order[first[p]] to order[first[p + 1] - 1], ascending. */
static int group_by_pose(int64_t n, int64_t k, const int64_t *pose, int64_t *first, int64_t *order)
{
    for (int64_t p = 0; p <= k; p++)
        first[p] = 0;
    for (int64_t i = 0; i < n; i++) {
        if (pose[i] < 0 || pose[i] >= k)
            return 0;
        first[pose[i] + 1]++;
    }
    for (int64_t p = 0; p < k; p++)
        first[p + 1] += first[p];
    for (int64_t i = n - 1; i >= 0; i--) /* from the end of every group, first[p + 1], to its beginning */
        order[--first[pose[i] + 1]] = i;
    for (int64_t p = 0; p < k; p++)
        first[p] = first[p + 1];
    first[k] = n;
    return 1;
}

/* Bound of a stretch over all obstacles, and the first obstacle that attains it. */
static double bound_of(const Body *body, Pose at, Stretch motion, int64_t m, const double *gaps,
                       const int64_t *pair_of, const Gap *exact, int64_t *row)
{
    double by_travel = travel(body, motion), by_stray = stray(body, motion), best = 0.0;
    for (int64_t o = 0; o < m; o++) {
        double bound;
        if (pair_of[o] < 0) {
            bound = gaps[o] - by_travel;
        } else {
            Gap gap = exact[pair_of[o]];
            bound = least(gap.distance, gap.distance + directional(body, at, motion, gap) - by_stray); /* (C5) */
        }
        if (bound != bound)
            bound = -INFINITY; /* NaN is no proof */
        if (o == 0 || bound < best) {
            best = bound;
            *row = o;
        }
    }
    return best;
}

/* Compute the bounds of n stretches from k poses among m >= 1 obstacles.
 *
 *   sizes      n, k, m, corners of the body, corners of the obstacles, circles of the body
 *   numbers    radius of the circles and reach of the body [m]
 *   body       vertices, normals (corners, 2), offsets (corners,), centres (circles, 2), one after the other
 *   poses      (k, 3) [m, m, rad]; turned: (k, 2), cosine and sine of the headings
 *   pose       (n,), pose of every stretch
 *   motions    (8, n), see `stretch_at`
 *   within     (n,) [m]: pairs that may come closer are evaluated exactly
 *   vertices, normals (m, q, 2), offsets (m, q), lower, upper (m, 2) of the obstacles
 *   bound      out, (n,) [m]; row: out, (n,)
 *   distance   out, (k m,) [m], of the pairs that were evaluated exactly, with their pose_of and obstacle_of (k m,)
 *   work       4 m + 2 (corners + q + circles) numbers; indices: 2 m + n + k + 1
 *
 * Return the number of pairs, or -1 if an index is out of range. */
int64_t optdock_advance_bounds(int64_t n, int64_t k, int64_t m, int64_t corners, int64_t q, int64_t circles,
                               double radius, double reach, const double *body_arrays, const double *poses,
                               const double *turned, const int64_t *pose, const double *motions, const double *within,
                               const double *vertices, const double *normals, const double *offsets,
                               const double *lower, const double *upper, double *bound, int64_t *row, double *distance,
                               int64_t *pose_of, int64_t *obstacle_of, double *work, int64_t *indices)
{
    Body body = {corners, circles, radius, reach, body_arrays, body_arrays + 2 * corners, body_arrays + 4 * corners,
                 body_arrays + 5 * corners};
    double *gaps = work, *points = work + 4 * m;
    Gap *exact = (Gap *)(work + m);
    double *centres = points + 2 * (corners + q);
    int64_t *pair_of = indices, *order = indices + m, *first = order + n;
    int64_t pairs = 0;

    if (!group_by_pose(n, k, pose, first, order))
        return -1;
    for (int64_t p = 0; p < k; p++) {
        Pose at = {poses[3 * p], poses[3 * p + 1], turned[2 * p], turned[2 * p + 1]};
        double farthest = -INFINITY;
        for (int64_t j = first[p]; j < first[p + 1]; j++)
            farthest = most(farthest, within[order[j]] + travel(&body, stretch_at(motions, n, order[j])));
        for (int64_t i = 0; i < circles; i++) {
            double x = body.centres[2 * i], y = body.centres[2 * i + 1];
            centres[2 * i] = at.x + at.c * x - at.s * y;
            centres[2 * i + 1] = at.y + at.s * x + at.c * y;
        }
        int64_t here = 0;
        for (int64_t o = 0; o < m; o++) {
            gaps[o] = broad_gap(&body, centres, lower + 2 * o, upper + 2 * o);
            pair_of[o] = -1;
            if (gaps[o] >= farthest)
                continue;
            Piece piece = {q, vertices + 2 * q * o, normals + 2 * q * o, offsets + q * o};
            exact[here] = separation(&body, at, &piece, points);
            distance[pairs] = exact[here].distance;
            pose_of[pairs] = p;
            obstacle_of[pairs++] = o;
            pair_of[o] = here++;
        }
        for (int64_t j = first[p]; j < first[p + 1]; j++) {
            int64_t i = order[j];
            bound[i] = bound_of(&body, at, stretch_at(motions, n, i), m, gaps, pair_of, exact, row + i);
        }
    }
    return pairs;
}
