/* The proof of clearance: bounds over stretches of motion and rounds of cells (`conservative_advancement.py`), cells and
 * their ends (`motion_bounds.py`), and clearances of poses (`clearance_kernel.py`) in C. Equation numbers are those of
 * docs/theory/certificate.md.
 *
 * Every sum and product is evaluated in the order of the twin, and angles enter as the sines and cosines that NumPy has
 * computed, so the results are equal to the last bit. A NaN is kept by every minimum and maximum and ends as a bound of
 * -inf, which proves nothing.
 *
 * Part of the trusted code of a certificate. Of other files it calls that of clothoid splines alone. */

#include <math.h>
#include <stdint.h>

int64_t optdock_clothoid_poses(int64_t n, int64_t count, double sign, const double *s, const double *table,
                               const double *quadrature, double *poses);

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

/* Distance of a coordinate from an interval, 0 within; NaN if the coordinate is. */
static double outside(double x, double lower, double upper)
{
    double farther = lower - x > x - upper ? lower - x : x - upper;
    return farther < 0.0 ? 0.0 : farther;
}

/* Lower bound of the distance of a body from the box (lower, upper) of an obstacle, by the body's circles. */
static double broad_gap(const Body *body, const double *circles, const double *lower, const double *upper)
{
    double nearest = INFINITY; /* squared; the square root is monotonic, so one at the end suffices */
    for (int64_t i = 0; i < body->circles; i++) {
        double x = circles[2 * i], y = circles[2 * i + 1];
        double across = outside(x, lower[0], upper[0]), along = outside(y, lower[1], upper[1]);
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

/* The obstacles of a proof: rows (m,), those that are evaluated, of the arrays (., q, 2), (., q) and (., 2). */
typedef struct {
    int64_t m, q;
    const int64_t *rows; /* null: the first m */
    const double *vertices, *normals, *offsets, *lower, *upper;
} Obstacles;

static int64_t row_of(const Obstacles *all, int64_t o) { return all->rows ? all->rows[o] : o; }

static Piece piece_at(const Obstacles *all, int64_t o)
{
    int64_t at = all->q * row_of(all, o);
    return (Piece){all->q, all->vertices + 2 * at, all->normals + 2 * at, all->offsets + at};
}

/* Centres of the body's circles at a pose; out, (circles, 2). */
static void place_circles(const Body *body, Pose at, double *centres)
{
    for (int64_t i = 0; i < body->circles; i++) {
        double x = body->centres[2 * i], y = body->centres[2 * i + 1];
        centres[2 * i] = at.x + at.c * x - at.s * y;
        centres[2 * i + 1] = at.y + at.s * x + at.c * y;
    }
}

/* Keep the smallest bound of a stretch, and the first obstacle that attains it; a row of -1 is none. */
static void keep_least(double candidate, int64_t o, double *bound, int64_t *row)
{
    if (candidate != candidate)
        candidate = -INFINITY; /* NaN is no proof */
    if (*row < 0 || candidate < *bound || (candidate == *bound && o < *row)) {
        *bound = candidate;
        *row = o;
    }
}

/* Squared distance above which a distance certainly exceeds `limit` by more than `reach`. */
static double squared_beyond(double limit, double reach)
{
    double far = limit + reach;
    return far < 0.0 ? -1.0 : far * far;
}

/* The pairs that were evaluated exactly, (pairs,): pose, obstacle and distance [m] of each. */
typedef struct {
    int64_t count, *pose, *obstacle;
    double *distance;
} Pairs;

/* n stretches from k poses: pose (n,); motions (8, n), see `stretch_at`; within (n,) [m], see `advance_bounds`. */
typedef struct {
    int64_t n, k;
    const double *poses, *turned;
    const int64_t *pose;
    const double *motions, *within;
} Stretches;

/* Radius [m] of a circle around all circles of a body, whose centre is that of the middle one, with a margin. */
static double reach_around(const Body *body)
{
    const double *middle = body->centres + 2 * (body->circles / 2);
    double away = 0.0;
    for (int64_t i = 0; i < body->circles; i++)
        away = most(away, hypot(body->centres[2 * i] - middle[0], body->centres[2 * i + 1] - middle[1]));
    return body->radius + away + 1e-9;
}

/* Squared distances of the middle circle's centre from the boxes of the obstacles; out, (m,) [m^2]. */
static void squared_distances(const Body *body, const double *centres, const Obstacles *all, double *squared)
{
    double x = centres[2 * (body->circles / 2)], y = centres[2 * (body->circles / 2) + 1];
    for (int64_t o = 0; o < all->m; o++) {
        const double *lower = all->lower + 2 * row_of(all, o), *upper = all->upper + 2 * row_of(all, o);
        double across = outside(x, lower[0], upper[0]), along = outside(y, lower[1], upper[1]);
        squared[o] = across * across + along * along;
    }
}

/* Gap [m] above which no obstacle lowers the bounds of the stretches order[begin] to order[end - 1] any further. */
static double limit_at(const Body *body, const Stretches *some, int64_t begin, int64_t end, const int64_t *order,
                       const double *bound, const int64_t *row)
{
    double limit = -INFINITY;
    for (int64_t j = begin; j < end; j++) {
        int64_t i = order[j];
        limit = most(limit, row[i] < 0 ? INFINITY : bound[i] + travel(body, stretch_at(some->motions, some->n, i)));
    }
    return limit;
}

/* Bounds of stretches for one body; bound, row: out, (n,). For work and indices see `optdock_advance_bounds`. Obstacles
 * that certainly are farther than all others that matter are excluded by one circle. */
static int bounds_of_body(const Body *body, const Stretches *some, const Obstacles *all, double *bound, int64_t *row,
                          Pairs *pairs, double *work, int64_t *indices)
{
    int64_t n = some->n, k = some->k, m = all->m;
    double *squared = work, *points = work + m, *centres = points + 2 * (body->corners + all->q);
    int64_t *is_left = indices, *order = indices + m, *first = order + n, likely;
    double around = reach_around(body);

    if (!group_by_pose(n, k, some->pose, first, order))
        return 0;
    for (int64_t p = 0; p < k; p++) {
        Pose at = {some->poses[3 * p], some->poses[3 * p + 1], some->turned[2 * p], some->turned[2 * p + 1]};
        double farthest = -INFINITY, reach = around + 1e-14 * (fabs(at.x) + fabs(at.y)); /* for rounding */
        for (int64_t j = first[p]; j < first[p + 1]; j++) {
            farthest = most(farthest, some->within[order[j]] + travel(body, stretch_at(some->motions, n, order[j])));
            row[order[j]] = -1;
        }
        place_circles(body, at, centres);
        squared_distances(body, centres, all, squared);
        double beyond = squared_beyond(farthest, reach);
        for (int64_t o = likely = 0; o < m; o++) {
            is_left[o] = squared[o] > beyond; /* not if NaN */
            likely = squared[o] < squared[likely] ? o : likely;
            if (is_left[o])
                continue;
            double gap = broad_gap(body, centres, all->lower + 2 * row_of(all, o), all->upper + 2 * row_of(all, o));
            int is_exact = !(gap >= farthest);
            Gap exact = {0.0, 0.0, 0.0};
            if (is_exact) {
                Piece piece = piece_at(all, o);
                exact = separation(body, at, &piece, points);
                pairs->distance[pairs->count] = exact.distance;
                pairs->pose[pairs->count] = p;
                pairs->obstacle[pairs->count++] = o;
            }
            for (int64_t j = first[p]; j < first[p + 1]; j++) {
                int64_t i = order[j];
                Stretch motion = stretch_at(some->motions, n, i);
                double lowest = gap - travel(body, motion);
                if (is_exact)
                    lowest = least(exact.distance, exact.distance + directional(body, at, motion, exact) -
                                                       stray(body, motion)); /* (C5) */
                keep_least(lowest, o, bound + i, row + i);
            }
        }
        beyond = squared_beyond(limit_at(body, some, first[p], first[p + 1], order, bound, row), reach);
        for (int64_t j = m > 0 ? -1 : 0; j < m; j++) { /* first the one that excludes most of the others */
            int64_t o = j < 0 ? likely : j;
            if (!is_left[o] || squared[o] > beyond)
                continue;
            double gap = broad_gap(body, centres, all->lower + 2 * row_of(all, o), all->upper + 2 * row_of(all, o));
            for (int64_t l = first[p]; l < first[p + 1]; l++) {
                int64_t i = order[l];
                keep_least(gap - travel(body, stretch_at(some->motions, n, i)), o, bound + i, row + i);
            }
            beyond = squared_beyond(limit_at(body, some, first[p], first[p + 1], order, bound, row), reach);
        }
    }
    return 1;
}

/* A body whose arrays follow one another: vertices, normals (corners, 2), offsets (corners,), centres (circles, 2). */
static Body body_at(int64_t corners, int64_t circles, double radius, double reach, const double *arrays)
{
    return (Body){corners, circles, radius, reach, arrays, arrays + 2 * corners, arrays + 4 * corners,
                  arrays + 5 * corners};
}

/* Compute the bounds of n stretches from k poses among m >= 1 obstacles.
 *
 *   sizes      n, k, m, corners of the body, corners of the obstacles, circles of the body
 *   numbers    radius of the circles and reach of the body [m]
 *   body       see `body_at`
 *   poses      (k, 3) [m, m, rad]; turned: (k, 2), cosine and sine of the headings
 *   pose       (n,), pose of every stretch
 *   motions    (8, n), see `stretch_at`
 *   within     (n,) [m]: pairs that may come closer are evaluated exactly
 *   vertices, normals (m, q, 2), offsets (m, q), lower, upper (m, 2) of the obstacles
 *   bound      out, (n,) [m]; row: out, (n,)
 *   distance   out, (k m,) [m], of the pairs that were evaluated exactly, with their pose_of and obstacle_of (k m,)
 *   work       m + 2 (corners + q + circles) numbers; indices: m + n + k + 1
 *
 * Return the number of pairs, or -1 if an index is out of range. */
int64_t optdock_advance_bounds(int64_t n, int64_t k, int64_t m, int64_t corners, int64_t q, int64_t circles,
                               double radius, double reach, const double *body_arrays, const double *poses,
                               const double *turned, const int64_t *pose, const double *motions, const double *within,
                               const double *vertices, const double *normals, const double *offsets,
                               const double *lower, const double *upper, double *bound, int64_t *row, double *distance,
                               int64_t *pose_of, int64_t *obstacle_of, double *work, int64_t *indices)
{
    Body body = body_at(corners, circles, radius, reach, body_arrays);
    Stretches some = {n, k, poses, turned, pose, motions, within};
    Obstacles all = {m, q, 0, vertices, normals, offsets, lower, upper};
    Pairs pairs = {0, pose_of, obstacle_of, distance};
    return bounds_of_body(&body, &some, &all, bound, row, &pairs, work, indices) ? pairs.count : -1;
}

/* Signed clearances of n poses among m obstacles, and the first obstacle that attains each; see
 * `of_pieces` of `proximity.py`.
 *
 *   sizes      n, m, bodies, q, largest numbers of corners and circles of a body
 *   body_sizes (bodies, 2): corners and circles; bodies: radius, reach and the arrays of `body_at` of each body
 *   best       in and out, (n,) [m]: clearances that no obstacle attains, then the smaller ones of obstacles
 *   nearest    out, (n,); -1 where no obstacle is closer than `best`
 *   work       m + 2 (corners + q + circles) numbers
 * The other arrays are those of `optdock_advance_bounds`. */
int64_t optdock_clearances(int64_t n, int64_t m, int64_t bodies, int64_t q, int64_t corners, int64_t circles,
                           const int64_t *body_sizes, const double *body_arrays, const double *poses,
                           const double *turned, const double *vertices, const double *normals, const double *offsets,
                           const double *lower, const double *upper, double *best, int64_t *nearest, double *work)
{
    Obstacles all = {m, q, 0, vertices, normals, offsets, lower, upper};
    double *gaps = work, *points = work + m, *centres = points + 2 * (corners + q);
    (void)circles;
    for (int64_t i = 0; i < n; i++) {
        Pose at = {poses[3 * i], poses[3 * i + 1], turned[2 * i], turned[2 * i + 1]};
        const double *arrays = body_arrays;
        nearest[i] = -1;
        for (int64_t b = 0; b < bodies; b++) {
            Body body = body_at(body_sizes[2 * b], body_sizes[2 * b + 1], arrays[0], arrays[1], arrays + 2);
            double smallest = INFINITY, known = best[i];
            int64_t likely = 0, row = 0;
            place_circles(&body, at, centres);
            for (int64_t o = 0; o < m; o++) {
                gaps[o] = broad_gap(&body, centres, lower + 2 * o, upper + 2 * o);
                likely = gaps[o] < gaps[likely] ? o : likely;
            }
            if (gaps[likely] < known || !(gaps[likely] > 0.0)) { /* a bound that prunes most of the others */
                Piece piece = piece_at(&all, likely);
                known = least(known, separation(&body, at, &piece, points).distance);
            }
            for (int64_t o = 0; o < m; o++) {
                if (gaps[o] > known && gaps[o] > 0.0)
                    continue;
                Piece piece = piece_at(&all, o);
                double distance = separation(&body, at, &piece, points).distance;
                if (distance < smallest || (distance != distance && smallest == smallest)) {
                    smallest = distance;
                    row = o;
                }
                known = least(known, distance);
            }
            if (smallest < best[i])
                nearest[i] = row;
            best[i] = least(smallest, best[i]);
            arrays += 2 + 5 * body.corners + 2 * body.circles;
        }
    }
    return 0;
}

/* Cells, (n,) each: segment, first and last parameter. */
typedef struct {
    int64_t n, *segment;
    double *first, *last;
} Cells;

/* Whether cell a lies before cell b on the path. */
static int is_before(const Cells *cells, int64_t a, int64_t b)
{
    if (cells->segment[a] != cells->segment[b])
        return cells->segment[a] < cells->segment[b];
    if (cells->first[a] != cells->first[b])
        return cells->first[a] < cells->first[b];
    return cells->last[a] < cells->last[b];
}

static void sift_down(const Cells *cells, int64_t *order, int64_t root, int64_t count)
{
    for (int64_t child; (child = 2 * root + 1) < count; root = child) {
        if (child + 1 < count && is_before(cells, order[child], order[child + 1]))
            child++;
        if (!is_before(cells, order[root], order[child]))
            return;
        int64_t swapped = order[root];
        order[root] = order[child];
        order[child] = swapped;
    }
}

/* The order of the cells along the path, by heapsort. */
static void sort_cells(const Cells *cells, int64_t *order)
{
    int64_t n = cells->n, is_sorted = 1;
    for (int64_t i = 0; i < n; i++) {
        order[i] = i;
        is_sorted = is_sorted && (i == 0 || is_before(cells, i - 1, i));
    }
    if (is_sorted)
        return;
    for (int64_t i = n / 2 - 1; i >= 0; i--)
        sift_down(cells, order, i, n);
    for (int64_t i = n - 1; i > 0; i--) {
        int64_t largest = order[0];
        order[0] = order[i];
        order[i] = largest;
        sift_down(cells, order, 0, i);
    }
}

/* Cells and their ends, as they are returned: whole (6, most): segment, work, end_segment in two rows, ends in two rows;
 * numbers (4, most): first and last parameter, end_u in two rows. end_segment, end_u (2 most,): the distinct ends in
 * order along the path; ends (2, n), the rows of the first and the last end of every cell. */
static Cells cells_in(int64_t n, int64_t most_cells, int64_t *whole, double *numbers)
{
    return (Cells){n, whole, numbers, numbers + most_cells};
}

/* Set the ends of cells, and return their number. */
static int64_t number_ends(const Cells *cells, int64_t most_cells, int64_t *whole, double *numbers)
{
    int64_t *order = whole + most_cells, *end_segment = whole + 2 * most_cells, *ends = whole + 4 * most_cells, k = 0;
    double *end_u = numbers + 2 * most_cells;
    sort_cells(cells, order);
    for (int64_t i = 0; i < cells->n; i++) {
        int64_t cell = order[i], segment = cells->segment[cell];
        for (int side = 0; side < 2; side++) {
            double u = side ? cells->last[cell] : cells->first[cell];
            if (k == 0 || end_segment[k - 1] != segment || end_u[k - 1] != u) {
                end_segment[k] = segment;
                end_u[k++] = u;
            }
            ends[side * cells->n + cell] = k - 1;
        }
    }
    return k;
}

/* A break of a segment and the state there, as in clothoid_kernel.c: arc length within the segment [m], pose, curvature
 * [1/m], and curvature rate up to the next break [1/m^2]. For a turn in place, whose two breaks are its ends, the
 * curvature is the turn per metre. */
typedef struct {
    double s, x, y, yaw, curvature, rate;
} Break;

/* The pieces of a path: kinds (segments, 2), number of breaks and gear, 0 for a turn in place; and their breaks. */
typedef struct {
    int64_t count;
    const int64_t *kinds;
    const Break *breaks;
} Pieces;

/* Whether every segment has at least two breaks, and all together have as many as there are. */
static int are_pieces(const Pieces *path, int64_t breaks)
{
    for (int64_t i = 0; i < path->count; i++) {
        if (path->kinds[2 * i] < 2)
            return 0;
        breaks -= path->kinds[2 * i];
    }
    return breaks == 0;
}

/* Cells of at most `step` [m] that cover a path, without breaks in their interiors; the last is divided into halves.
 *
 *   sizes     segments, breaks in all, most cells
 *   kinds, table: see `Pieces`
 *   whole, numbers: out, see `cells_in`; found: out, (2,): numbers of cells and of ends
 *
 * Return 0, or -1 if there are more cells. */
int64_t optdock_first_cells(int64_t segments, int64_t breaks, int64_t most_cells, double step, const int64_t *kinds,
                            const double *table, int64_t *whole, double *numbers, int64_t *found)
{
    Pieces path = {segments, kinds, (const Break *)table};
    Cells cells = cells_in(0, most_cells, whole, numbers);
    const Break *at = path.breaks;
    int64_t n = 0;
    if (!are_pieces(&path, breaks))
        return -1;
    for (int64_t i = 0; i < segments; i++, at++) {
        for (int64_t j = 1; j < kinds[2 * i]; j++, at++) {
            double width = at[1].s - at->s, parts = ceil(width / step);
            parts = parts > 1.0 ? parts : 1.0;
            if (!(parts <= (double)(most_cells - 1 - n)))
                return -1;
            for (double rank = 0.0; rank < parts; rank += 1.0, n++) {
                cells.segment[n] = i;
                cells.first[n] = at->s + width * rank / parts;
                cells.last[n] = rank + 1.0 < parts ? at->s + width * (rank + 1.0) / parts : at[1].s;
            }
        }
    }
    if (n == 0 || n >= most_cells)
        return -1;
    cells.segment[n] = cells.segment[n - 1];
    cells.last[n] = cells.last[n - 1];
    cells.first[n] = cells.last[n - 1] = cells.first[n - 1] + (cells.last[n - 1] - cells.first[n - 1]) * 0.5;
    cells.n = n + 1;
    found[0] = cells.n;
    found[1] = number_ends(&cells, most_cells, whole, numbers);
    return 0;
}

/* Divide some cells into equal parts: first all first parts, then all second parts, as `Cells.cut`.
 *
 *   sizes     cells, chosen cells, parts
 *   segment, first, last (cells,); chosen: (chosen,), their rows
 *   whole, numbers: out, see `cells_in`, with most = chosen parts
 *
 * Return the number of ends, or -1 if a row is out of range. */
int64_t optdock_divided_cells(int64_t count, int64_t chosen_count, int64_t parts, const int64_t *segment,
                              const double *first, const double *last, const int64_t *chosen, int64_t *whole,
                              double *numbers)
{
    int64_t n = chosen_count * parts;
    Cells cells = cells_in(n, n, whole, numbers);
    for (int64_t j = 0; j < parts; j++) {
        for (int64_t i = 0; i < chosen_count; i++) {
            int64_t cell = chosen[i], at = j * chosen_count + i;
            if (cell < 0 || cell >= count)
                return -1;
            double begin = first[cell], width = last[cell] - begin;
            cells.segment[at] = segment[cell];
            cells.first[at] = j == 0 ? begin : begin + width * ((double)j / (double)parts);
            cells.last[at] = j + 1 < parts ? begin + width * ((double)(j + 1) / (double)parts) : last[cell];
        }
    }
    return number_ends(&cells, n, whole, numbers);
}

/* The required clearance (C2): see `ClearanceRule.required_at`. */
typedef struct {
    double required, at_dock, taper, run; /* of the dock [m] */
    double least, slope, relief;          /* of the start [m, 1, m] */
    double at_start;                      /* [m]; NaN: not set */
    double goal_x, goal_y, start_x, start_y;
} Rule;

static double tapered(const Rule *rule, double distance, double low)
{
    double beyond = most(distance - rule->run, 0.0), share;
    if (rule->taper > 0.0)
        share = least(beyond, rule->taper) / rule->taper;
    else
        share = beyond > 0.0 ? 1.0 : 0.0;
    return low + (rule->required - low) * share;
}

static double required_at(const Rule *rule, double from_goal, double from_start)
{
    double near_start = rule->least + rule->slope * most(0.0, from_start - rule->relief);
    if (rule->relief > 0.0 && rule->at_start == rule->at_start)
        near_start = least(near_start, tapered(rule, from_start, rule->at_start));
    return least(tapered(rule, from_goal, rule->at_dock), near_start);
}

/* The last break of a segment below a parameter, at least the first. */
static const Break *break_before(const Pieces *path, int64_t segment, double u)
{
    const Break *breaks = path->breaks;
    for (int64_t i = 0; i < segment; i++)
        breaks += path->kinds[2 * i];
    int64_t low = 0, high = path->kinds[2 * segment] - 2;
    while (low < high) {
        int64_t middle = (low + high + 1) / 2;
        if (breaks[middle].s < u)
            low = middle;
        else
            high = middle - 1;
    }
    return breaks + low;
}

/* Motion (C4) over the first half of a cell, from its first pose, and over the last half, backwards from its last. */
static void halves(const Pieces *path, int64_t segment, double u0, double u1, const double *first_turned,
                   const double *last_turned, Stretch *half)
{
    double sign = (double)path->kinds[2 * segment + 1], width = u1 - u0;
    const Break *from = break_before(path, segment, 0.5 * (u0 + u1));
    if (sign == 0.0) {
        double turn = from->curvature, size = fabs(turn);
        half[0] = (Stretch){0.0, 0.0, turn, 0.5 * width, 0.0, size, 0.0, turn * turn};
        half[1] = (Stretch){-0.0, -0.0, -turn, 0.5 * width, 0.0, size, 0.0, turn * turn};
        return;
    }
    double rate = from->rate, begin = from->curvature + rate * (u0 - from->s);
    double end = begin + rate * width, turn = most(fabs(begin), fabs(end)), twist = fabs(rate) + turn * turn;
    half[0] = (Stretch){sign * first_turned[0], sign * first_turned[1], begin, 0.5 * width, 1.0, turn, turn, twist};
    half[1] = (Stretch){-(sign * last_turned[0]), -(sign * last_turned[1]), -end, 0.5 * width, 1.0, turn, turn, twist};
}

static void keep_stretch(double *motions, int64_t n, int64_t i, Stretch one)
{
    double values[8] = {one.x, one.y, one.yaw, one.width, one.speed, one.turn, one.bend, one.twist};
    for (int64_t j = 0; j < 8; j++)
        motions[j * n + i] = values[j];
}

/* Whether a pose that violates the rule, marked in bad (k,), lies within a cell; s: (k,), ascending [m]. */
static int touches(const int64_t *bad, const double *s, int64_t k, int64_t first, int64_t last)
{
    double low = s[first] - 1e-9, high = s[last] + 1e-9;
    for (int64_t p = first; p >= 0 && s[p] >= low; p--)
        if (bad[p])
            return 1;
    for (int64_t p = first + 1; p < k && s[p] <= high; p++)
        if (bad[p])
            return 1;
    return 0;
}

/* One round over n cells with k ends, among m >= 1 obstacles: `_round_numpy` of `clearance_rounds.py`.
 *
 *   sizes      n, k, m, bodies, q, largest number of corners and of circles of a body, segments, breaks
 *   attained   smallest clearance of a pose so far [m]; tolerance, sharpness [m]
 *   segment    (n,); edges: (2, n), first and last parameters; ends: (2, n), rows of the ends
 *   poses      (k, 3); turned: (k, 2); s: (k,), arc lengths [m]
 *   kinds, table: see `Pieces`
 *   rule       (12,), see `Rule`
 *   body_sizes, bodies: see `optdock_clearances`; rows, vertices ... upper: see `Obstacles`
 *   cells      out, (3, n): bound, required clearance [m], arc length of the pose; places: out, (3, n): obstacle,
 *              pose, and fate: 0 if a cell is proven and sharp, 1 if it contains a violation, 2 if it is open
 *   needed     out, (k + 1,): required clearance at the poses, and the smallest distance of the pairs [m]
 *   pair_of    out, (2, k m bodies), pose and obstacle of the pairs that were evaluated exactly; distances: (k m bodies,)
 *   counts     out, (2,): pairs, and those that violate the rule
 *   work       22 n + 2 k + m + 2 (corners + q + circles) numbers; indices: 6 n + m + 2 k + 1
 *
 * Return 0, or -1 if an index is out of range. */
int64_t optdock_clearance_round(
    int64_t n, int64_t k, int64_t m, int64_t bodies, int64_t q, int64_t corners, int64_t circles, int64_t segments,
    int64_t breaks, double attained, double tolerance, double sharpness, const int64_t *segment, const double *edges,
    const int64_t *ends, const double *poses, const double *turned, const double *s, const int64_t *kinds,
    const double *table, const double *rule_numbers, const int64_t *body_sizes, const double *body_arrays,
    const int64_t *rows, const double *vertices, const double *normals, const double *offsets, const double *lower,
    const double *upper, double *cells, int64_t *places, double *needed, int64_t *pair_of, double *distances, int64_t *counts,
    double *work, int64_t *indices)
{
    Rule rule = *(const Rule *)rule_numbers;
    Pieces path = {segments, kinds, (const Break *)table};
    Obstacles all = {m, q, rows, vertices, normals, offsets, lower, upper};
    Pairs pairs = {0, pair_of, pair_of + k * m * bodies, distances};
    double *motions = work, *within = work + 16 * n, *bound = within + 2 * n, *other = bound + 2 * n;
    double *from_goal = other + 2 * n, *from_start = from_goal + k, *rest = from_start + k;
    int64_t *bad = indices, *row = bad + k, *other_row = row + 2 * n, *more = other_row + 2 * n;
    Stretches some = {2 * n, k, poses, turned, ends, motions, within};
    (void)corners;
    (void)circles;

    if (!are_pieces(&path, breaks))
        return -1;
    for (int64_t i = 0; i < n; i++)
        if (ends[i] < 0 || ends[i] >= k || ends[n + i] < 0 || ends[n + i] >= k || segment[i] < 0 ||
            segment[i] >= segments)
            return -1;
    for (int64_t p = 0; p < k; p++) {
        from_goal[p] = hypot(poses[3 * p] - rule.goal_x, poses[3 * p + 1] - rule.goal_y);
        from_start[p] = hypot(poses[3 * p] - rule.start_x, poses[3 * p + 1] - rule.start_y);
        needed[p] = required_at(&rule, from_goal[p], from_start[p]);
        bad[p] = 0;
    }
    for (int64_t i = 0; i < n; i++) {
        Stretch half[2];
        halves(&path, segment[i], edges[i], edges[n + i], turned + 2 * ends[i], turned + 2 * ends[n + i], half);
        double width = edges[n + i] - edges[i], sag = half[0].bend * (width * width) / 8.0; /* (C7) */
        double goal = most(from_goal[ends[i]], from_goal[ends[n + i]]);
        double start = most(from_start[ends[i]], from_start[ends[n + i]]);
        cells[n + i] = required_at(&rule, goal + sag, start + sag);
        within[i] = within[n + i] = most(cells[n + i], attained);
        keep_stretch(motions, 2 * n, i, half[0]);
        keep_stretch(motions, 2 * n, n + i, half[1]);
    }
    const double *arrays = body_arrays;
    for (int64_t b = 0; b < bodies; b++) {
        Body body = body_at(body_sizes[2 * b], body_sizes[2 * b + 1], arrays[0], arrays[1], arrays + 2);
        if (!bounds_of_body(&body, &some, &all, b ? other : bound, b ? other_row : row, &pairs, rest, more))
            return -1;
        for (int64_t i = 0; b && i < 2 * n; i++) {
            if (!(bound[i] <= other[i])) {
                bound[i] = other[i];
                row[i] = other_row[i];
            }
        }
        arrays += 2 + 5 * body.corners + 2 * body.circles;
    }
    double smallest = INFINITY;
    counts[0] = pairs.count;
    counts[1] = 0;
    for (int64_t i = 0; i < pairs.count; i++) {
        smallest = least(smallest, distances[i]);
        if (distances[i] < needed[pairs.pose[i]] - tolerance) {
            bad[pairs.pose[i]] = 1;
            counts[1]++;
        }
    }
    needed[k] = smallest;
    attained = smallest < attained ? smallest : attained;
    for (int64_t i = 0; i < n; i++) {
        int64_t half = bound[i] <= bound[n + i] ? i : n + i; /* (C8) */
        cells[i] = bound[half];
        cells[2 * n + i] = s[ends[half]];
        places[i] = row[half];
        places[n + i] = ends[half];
        if (cells[i] >= cells[n + i] - tolerance && cells[i] >= attained - sharpness)
            places[2 * n + i] = 0;
        else
            places[2 * n + i] = counts[1] && touches(bad, s, k, ends[i], ends[n + i]) ? 1 : 2;
    }
    return 0;
}

/* The poses at the parameters u (k,), ascending in every segment, with their cosines and sines, and their arc lengths;
 * starts: (segments,), arc lengths [m]. */
static void poses_at(const Pieces *path, const double *starts, const double *quadrature, const int64_t *segment,
                     const double *u, int64_t k, double *poses, double *turned, double *s)
{
    const Break *breaks = path->breaks;
    for (int64_t i = 0, at = 0, end; i < path->count; breaks += path->kinds[2 * i++], at = end) {
        int64_t gear = path->kinds[2 * i + 1];
        for (end = at; end < k && segment[end] == i;)
            end++;
        if (gear)
            optdock_clothoid_poses(end - at, path->kinds[2 * i], (double)gear, u + at, (const double *)breaks,
                                   quadrature, poses + 3 * at);
        for (int64_t j = at; j < end; j++) {
            if (!gear) {
                poses[3 * j] = breaks->x;
                poses[3 * j + 1] = breaks->y;
                poses[3 * j + 2] = breaks->yaw + breaks->curvature * least(most(u[j], 0.0), breaks[1].s);
            }
            turned[2 * j] = cos(poses[3 * j + 2]);
            turned[2 * j + 1] = sin(poses[3 * j + 2]);
            s[j] = u[j] + starts[i];
        }
    }
}

/* Rows of the obstacles whose boxes intersect the box of the poses, widened by `reach`; all if they are not few. */
static int64_t crop(const Obstacles *all, const double *poses, int64_t k, double reach, double worthwhile,
                    int64_t *rows)
{
    double lower[2] = {INFINITY, INFINITY}, upper[2] = {-INFINITY, -INFINITY};
    int64_t count = 0;
    for (int64_t p = 0; p < k; p++) {
        for (int64_t i = 0; i < 2; i++) {
            lower[i] = least(lower[i], poses[3 * p + i]);
            upper[i] = most(upper[i], poses[3 * p + i]);
        }
    }
    for (int64_t o = 0; o < all->m; o++)
        if (all->lower[2 * o] <= upper[0] + reach && all->lower[2 * o + 1] <= upper[1] + reach &&
            all->upper[2 * o] >= lower[0] - reach && all->upper[2 * o + 1] >= lower[1] - reach)
            rows[count++] = o;
    if ((double)count <= worthwhile * (double)all->m)
        return count;
    for (int64_t o = 0; o < all->m; o++)
        rows[o] = o;
    return all->m;
}

/* The smallest bound so far, its place, and the smallest margin: `_Least` of the twin. */
typedef struct {
    double proven, s, needed, row, margin;
} Least;

/* Add the cells of a round that are proven and sharp; see `optdock_clearance_round`. Return 0 if one is in contact. */
static int add_settled(int64_t n, const double *cells, const int64_t *places, const double *needed, Least *found)
{
    int64_t first = -1;
    for (int64_t i = 0; i < n; i++) {
        if (places[2 * n + i] != 0)
            continue;
        if (cells[i] < 0.0)
            return 0;
        found->margin = least(found->margin, cells[i] - cells[n + i]);
        first = first < 0 || cells[i] < cells[first] ? i : first;
    }
    if (first >= 0 && (cells[first] < found->proven || found->row < 0.0))
        *found = (Least){cells[first], cells[2 * n + first], needed[places[n + first]], (double)places[first],
                         found->margin};
    return 1;
}

/* The proof for a path whose cells are all cleared without contact, within the given memory: `_quick_numpy` of
 * `conservative_advancement.py`.
 *
 *   sizes       segments, breaks; obstacles m, bodies, q, largest number of corners and of circles of a body;
 *               room: most cells of a round; pairs: most of poses, obstacles and bodies in a round;
 *               cheap: cells whose round takes about as long as that of one; most levels and poses;
 *               is_sharp: whether the smallest clearance is determined
 *   numbers     step [m] of the first cells; known clearance of a pose [m], or inf; tolerance, sharpness [m];
 *               reach [m] and worthwhile of `crop`
 *   kinds, table: see `Pieces`; starts: (segments + 1,), arc lengths [m]
 *   quadrature  (2, 5), see clothoid_kernel.c; rule: (12,), see `Rule`
 *   body_sizes, body_arrays, vertices ... upper: see `optdock_clearances`
 *   found       out, (8,): smallest bound [m], its arc length [m], requirement there [m], obstacle, smallest margin
 *               [m], numbers of poses and of obstacles that were evaluated, and clearance at the end [m] if is_sharp
 *   work        53 room + pairs + m + 2 (corners + q + circles) + 1 numbers
 *   indices     26 room + 2 pairs + 2 m + 3
 *
 * Return 1 if the path is proven, 0 if the proof needs more than this, or -1 if an index is out of range. */
int64_t optdock_clearance_proof(
    int64_t segments, int64_t breaks, int64_t m, int64_t bodies, int64_t q, int64_t corners, int64_t circles,
    int64_t room, int64_t pairs, int64_t cheap, int64_t most_levels, int64_t most_poses, int64_t is_sharp, double step,
    double known, double tolerance, double sharpness, double reach, double worthwhile, const int64_t *kinds,
    const double *table, const double *starts, const double *quadrature, const double *rule, const int64_t *body_sizes,
    const double *body_arrays, const double *vertices, const double *normals, const double *offsets,
    const double *lower, const double *upper, double *found, double *work, int64_t *indices)
{
    Obstacles all = {m, q, 0, vertices, normals, offsets, lower, upper};
    Pieces path = {segments, kinds, (const Break *)table};
    double *numbers = work, *finer_numbers = numbers + 4 * room, *edges = finer_numbers + 4 * room;
    double *poses = edges + 2 * room, *turned = poses + 6 * room, *s = turned + 4 * room, *cells = s + 2 * room;
    double *needed = cells + 3 * room, *distances = needed + 2 * room + 1, *rest = distances + pairs;
    int64_t *whole = indices, *finer_whole = whole + 6 * room, *places = finer_whole + 6 * room;
    int64_t *chosen = places + 3 * room, *rows = chosen + room, *pair_of = rows + m, *counts = pair_of + 2 * pairs;
    int64_t *more = counts + 2, stride = room, near, evaluated = 0, level = 0, nearest;
    double attained = -INFINITY, at_end = INFINITY;
    Least cleared = {INFINITY, 0.0, 0.0, -1.0, INFINITY};

    if (optdock_first_cells(segments, breaks, room, step, kinds, table, whole, numbers, counts))
        return 0;
    int64_t n = counts[0], k = counts[1];
    most_poses += n;
    poses_at(&path, starts, quadrature, whole + 2 * stride, numbers + 2 * stride, k, poses, turned, s);
    near = crop(&all, poses, k, reach, worthwhile, rows);
    if (is_sharp) {
        optdock_clearances(1, m, bodies, q, corners, circles, body_sizes, body_arrays, poses + 3 * (k - 1),
                           turned + 2 * (k - 1), vertices, normals, offsets, lower, upper, &at_end, &nearest, rest);
        attained = least(at_end, known);
        if (!(at_end >= 0.0))
            return 0;
    }
    while (near > 0 && k * near * bodies <= pairs) {
        for (int64_t i = 0; i < n; i++) {
            edges[i] = numbers[i];
            edges[n + i] = numbers[stride + i];
        }
        if (optdock_clearance_round(n, k, near, bodies, q, corners, circles, segments, breaks, attained, tolerance,
                                    sharpness, whole, edges, whole + 4 * stride, poses, turned, s, kinds, table, rule,
                                    body_sizes, body_arrays, rows, vertices, normals, offsets, lower, upper, cells,
                                    places, needed, pair_of, distances, counts, rest, more))
            return -1;
        evaluated += k;
        attained = least(attained, needed[k]);
        if (counts[1] || !add_settled(n, cells, places, needed, &cleared))
            return 0;
        int64_t open = 0, halvings = 1;
        for (int64_t i = 0; i < n; i++)
            if (places[2 * n + i])
                chosen[open++] = i;
        if (open == 0) {
            double values[8] = {cleared.proven, cleared.s, cleared.needed, (double)rows[(int64_t)cleared.row],
                                cleared.margin, (double)evaluated, (double)near, at_end};
            for (int64_t i = 0; i < 8; i++)
                found[i] = values[i];
            return 1;
        }
        while (open << (halvings + 1) <= cheap)
            halvings++;
        if (level >= most_levels || evaluated > most_poses || open << halvings > room)
            return 0;
        k = optdock_divided_cells(n, open, (int64_t)1 << halvings, whole, numbers, numbers + stride, chosen,
                                  finer_whole, finer_numbers);
        level += halvings;
        stride = n = open << halvings;
        int64_t *old_whole = whole;
        double *old_numbers = numbers;
        whole = finer_whole;
        numbers = finer_numbers;
        finer_whole = old_whole;
        finer_numbers = old_numbers;
        poses_at(&path, starts, quadrature, whole + 2 * stride, numbers + 2 * stride, k, poses, turned, s);
    }
    return 0;
}
