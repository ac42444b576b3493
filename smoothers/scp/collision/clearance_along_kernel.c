/* Clearance of the footprint swept along a roll-out: the function `clearance_along` of `clearance_along.py` in C.
 *
 * The broad phase and the narrow phase are those of `broad_phase.py` and `narrow_phase.py`, whose docstrings derive the
 * bounds; equation numbers are those of docs/theory/smoother.md. Sums and products are evaluated in the order of the
 * twins, with the sines and cosines of the C library; where NumPy uses the same, results are equal to the last bit. A
 * search for a path uses them; the certificate does not. */

#include <math.h>
#include <stdint.h>

typedef struct {
    double x, y;
} Vector;

/* Numbers of body parts, corners of a part, obstacles, their corners, nodes and intervals. */
typedef struct {
    int64_t parts, v, obstacles, k, nodes, intervals;
} Counts;

/* Body, obstacles and the settings of the selection. */
typedef struct {
    const double *vertices, *normals; /* (parts, v, 2), of the body */
    const double *reach;              /* (parts, v) [m], distances of the vertices from the origin */
    const double *low, *high;         /* (parts, 2), boxes of the parts */
    const double *outline, *edges;    /* (obstacles, k, 2), vertices and outward normals */
    const double *lower, *upper;      /* (obstacles, 2), boxes */
    double radius;                    /* of the body [m] */
    double near;                      /* [m]: pairs whose boxes are farther apart are left out */
    double close;                     /* [m]: pairs whose boxes are nearer may violate the rule */
    int64_t few, nearest, nearest_close, together, lowest_vertices, facing_edges;
    double lowest_slope;
} Scene;

/* The roll-out at its nodes and intervals. */
typedef struct {
    const double *poses;                 /* (nodes, 3) [m, m, rad] */
    const double *cosine, *sine, *kappa; /* (nodes,) */
    const double *required, *leaving;    /* (nodes,) [m], see `Requirement` */
    const double *steps, *rate;          /* (intervals,) */
    const double *signs;                 /* (gears,) */
    const int64_t *rule;                 /* (nodes,), deciding part of the clearance rule; 2: LEAVING */
    const int64_t *left;                 /* (intervals,), node at which the interval begins */
} Motion;

/* The body at the nodes, column = part * nodes + node: corners (columns, v), boxes of the corners (columns,). */
typedef struct {
    Vector *corners, *lower, *upper;
} Placed;

/* Boxes of the swept parts, row = part * intervals + interval: in the world, and in the frame of the left node. */
typedef struct {
    Vector *lower, *upper, *middle, *half;
} Swept;

static double least(double a, double b) { return a < b || a != a ? a : b; }

static double most(double a, double b) { return a > b || a != a ? a : b; }

static double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y; }

/* Coordinate of a point along the axis turned left by 90 degrees. */
static double across(Vector axis, Vector point) { return axis.x * point.y - axis.y * point.x; }

static Vector at(const double *points, int64_t i) { return (Vector){points[2 * i], points[2 * i + 1]}; }

/* ---- Required clearance ---- */

/* The clearance rule, in the order of `Scene.packed`; at_start is infinite where it does not apply. */
typedef struct {
    Vector goal, start;
    double required, at_dock, taper, dock_run, at_start, least_leaving, relief, relief_slope;
} Rule;

static double tapered(const Rule *rule, double distance, double lowest)
{
    double beyond = most(distance - rule->dock_run, 0.0);
    double share = rule->taper > 0.0 ? least(beyond, rule->taper) / rule->taper : beyond > 0.0 ? 1.0 : 0.0;
    return lowest + (rule->required - lowest) * share;
}

static double taper_slope(const Rule *rule, double distance, double lowest)
{
    int rises = rule->dock_run <= distance && distance < rule->dock_run + rule->taper;
    return rises && rule->taper > 0.0 ? (rule->required - lowest) / rule->taper : 0.0;
}

/* Write the requirement at all nodes, in the order of `Requirement`, as the function `Scene.required`. */
static void write_required(const Rule *rule, int64_t nodes, const double *poses, double *value, double *gradient,
                           int64_t *part, double *leaving)
{
    for (int64_t i = 0; i < nodes; i++) {
        Vector to_goal = {poses[3 * i] - rule->goal.x, poses[3 * i + 1] - rule->goal.y};
        Vector to_start = {poses[3 * i] - rule->start.x, poses[3 * i + 1] - rule->start.y};
        double from_goal = hypot(to_goal.x, to_goal.y), from_start = hypot(to_start.x, to_start.y);
        double docking = tapered(rule, from_goal, rule->at_dock), slope = 0.0;
        leaving[i] = rule->least_leaving + rule->relief_slope * most(0.0, from_start - rule->relief);
        value[i] = least(docking, leaving[i]);
        part[i] = leaving[i] <= docking ? 2 : from_goal < rule->dock_run + rule->taper ? 0 : 1;
        if (from_start > rule->relief)
            slope = rule->relief_slope;
        if (isfinite(rule->at_start)) {
            double undocking = tapered(rule, from_start, rule->at_start);
            if (undocking < value[i]) {
                value[i] = undocking;
                part[i] = 3;
                slope = taper_slope(rule, from_start, rule->at_start);
            }
        }
        Vector away = part[i] >= 2 ? to_start : to_goal;
        double share = part[i] >= 2 ? slope / most(from_start, 1e-9)
                                    : taper_slope(rule, from_goal, rule->at_dock) / most(from_goal, 1e-9);
        gradient[2 * i] = share * away.x;
        gradient[2 * i + 1] = share * away.y;
    }
}

/* ---- Broad phase ---- */

static void place_body(Counts n, const Scene *scene, const Motion *motion, Placed *placed)
{
    for (int64_t column = 0; column < n.parts * n.nodes; column++) {
        int64_t part = column / n.nodes, node = column % n.nodes;
        double c = motion->cosine[node], s = motion->sine[node];
        Vector low = {INFINITY, INFINITY}, high = {-INFINITY, -INFINITY};
        for (int64_t i = 0; i < n.v; i++) {
            Vector point = at(scene->vertices, part * n.v + i);
            Vector corner = {motion->poses[3 * node] + (c * point.x - s * point.y),
                             motion->poses[3 * node + 1] + (s * point.x + c * point.y)};
            placed->corners[column * n.v + i] = corner;
            low = (Vector){least(low.x, corner.x), least(low.y, corner.y)};
            high = (Vector){most(high.x, corner.x), most(high.y, corner.y)};
        }
        placed->lower[column] = low;
        placed->upper[column] = high;
    }
}

/* Box of a part swept over an interval, in the frame of the left node: the corners at both ends, grown by the largest
 * deviation of a vertex from its chord, h^2 / 8 times the bound of its second derivative. */
static void body_frame_box(Counts n, const Scene *scene, const Motion *motion, const Placed *placed, int64_t row,
                           Swept *swept)
{
    int64_t part = row / n.intervals, interval = row % n.intervals, left = motion->left[interval];
    double c = motion->cosine[left], s = motion->sine[left], step = motion->steps[interval];
    const Vector *corners = placed->corners + (part * n.nodes + left + 1) * n.v;
    Vector low = {INFINITY, INFINITY}, high = {-INFINITY, -INFINITY};
    for (int64_t i = 0; i < n.v; i++) {
        double x = corners[i].x - motion->poses[3 * left], y = corners[i].y - motion->poses[3 * left + 1];
        double ahead = c * x + s * y, beside = c * y - s * x;
        low = (Vector){least(low.x, ahead), least(low.y, beside)};
        high = (Vector){most(high.x, ahead), most(high.y, beside)};
    }
    double turn = most(fabs(motion->kappa[left]), fabs(motion->kappa[left + 1]));
    double bend = turn + scene->radius * (turn * turn + fabs(motion->rate[interval]));
    double stray = 0.125 * (step * step) * bend;
    Vector first = at(scene->low, part), last = at(scene->high, part);
    low = (Vector){least(low.x, first.x) - stray, least(low.y, first.y) - stray};
    high = (Vector){most(high.x, last.x) + stray, most(high.y, last.y) + stray};
    swept->middle[row] = (Vector){0.5 * (low.x + high.x), 0.5 * (low.y + high.y)};
    swept->half[row] = (Vector){0.5 * (high.x - low.x), 0.5 * (high.y - low.y)};
}

static void sweep(Counts n, const Scene *scene, const Motion *motion, const Placed *placed, Swept *swept)
{
    for (int64_t row = 0; row < n.parts * n.intervals; row++) {
        int64_t column = row / n.intervals * n.nodes + motion->left[row % n.intervals];
        Vector a = placed->lower[column], b = placed->lower[column + 1];
        swept->lower[row] = (Vector){least(a.x, b.x), least(a.y, b.y)};
        a = placed->upper[column];
        b = placed->upper[column + 1];
        swept->upper[row] = (Vector){most(a.x, b.x), most(a.y, b.y)};
        body_frame_box(n, scene, motion, placed, row, swept);
    }
}

/* Lower bound of the signed distance of two boxes from the gaps along their sides. */
static double box_separation(double x, double y)
{
    double right = most(x, 0.0), up = most(y, 0.0);
    return sqrt(right * right + up * up) + least(most(x, y), 0.0);
}

/* Separation of a swept part and the box of an obstacle in the frame of the left node. */
static double in_body_frame(Counts n, const Scene *scene, const Motion *motion, const Swept *swept, int64_t row,
                            int64_t obstacle)
{
    int64_t node = motion->left[row % n.intervals];
    double c = motion->cosine[node], s = motion->sine[node];
    Vector low = at(scene->lower, obstacle), high = at(scene->upper, obstacle);
    double dx = 0.5 * (low.x + high.x) - motion->poses[3 * node];
    double dy = 0.5 * (low.y + high.y) - motion->poses[3 * node + 1];
    double ahead = fabs(c * dx + s * dy - swept->middle[row].x) - swept->half[row].x;
    double beside = fabs(c * dy - s * dx - swept->middle[row].y) - swept->half[row].y;
    double wide = 0.5 * (high.x - low.x), tall = 0.5 * (high.y - low.y);
    c = fabs(c);
    s = fabs(s);
    return box_separation(ahead - (c * wide + s * tall), beside - (s * wide + c * tall));
}

/* Set (low, high) to the common box of the rows first to last - 1, grown by `near` on all sides. */
static void group(const Scene *scene, const Swept *swept, int64_t first, int64_t last, Vector *low, Vector *high)
{
    *low = swept->lower[first];
    *high = swept->upper[first];
    for (int64_t row = first + 1; row < last; row++) {
        *low = (Vector){least(low->x, swept->lower[row].x), least(low->y, swept->lower[row].y)};
        *high = (Vector){most(high->x, swept->upper[row].x), most(high->y, swept->upper[row].y)};
    }
    *low = (Vector){low->x - scene->near, low->y - scene->near};
    *high = (Vector){high->x + scene->near, high->y + scene->near};
}

/* Find the near pairs in the order of the twin; rows, obstacles: out. apart: out [m]. Return their number. */
static int64_t near_pairs(Counts n, const Scene *scene, const Motion *motion, const Swept *swept, int64_t *rows,
                          int64_t *obstacles, double *apart)
{
    int64_t count = 0, total = n.parts * n.intervals;
    for (int64_t first = 0; first < total; first += scene->together) {
        int64_t last = first + scene->together < total ? first + scene->together : total;
        Vector low, high;
        group(scene, swept, first, last, &low, &high);
        for (int64_t o = 0; o < n.obstacles; o++) {
            Vector lower = at(scene->lower, o), upper = at(scene->upper, o);
            if (!(low.x < upper.x && high.x > lower.x && low.y < upper.y && high.y > lower.y))
                continue;
            for (int64_t row = first; row < last; row++) {
                double x = most(swept->lower[row].x - upper.x, lower.x - swept->upper[row].x);
                double y = most(swept->lower[row].y - upper.y, lower.y - swept->upper[row].y);
                if (!(most(x, y) < scene->near))
                    continue;
                double gap = most(box_separation(x, y), in_body_frame(n, scene, motion, swept, row, o));
                if (gap < scene->near) {
                    rows[count] = row;
                    obstacles[count] = o;
                    apart[count++] = gap;
                }
            }
        }
    }
    return count;
}

/* Number of pairs of the same row before pair i in the order of their separations; next: the next pair of the row. */
static int64_t rank_of(int64_t i, int64_t first, const int64_t *next, const double *apart)
{
    int64_t rank = 0;
    for (int64_t j = first; j >= 0; j = next[j])
        rank += apart[j] < apart[i] || (apart[j] == apart[i] && j < i);
    return rank;
}

/* Keep the nearest pairs of every row, and more of those that may be too close. Return the number kept.
 * next, keep: work, (count,); first: work, (total rows,). */
static int64_t nearest_pairs(const Scene *scene, int64_t count, int64_t total, int64_t *rows, int64_t *obstacles,
                             const double *apart, int64_t *next, int64_t *keep, int64_t *first)
{
    int64_t kept = 0;
    for (int64_t row = 0; row < total; row++)
        first[row] = -1;
    for (int64_t i = count - 1; i >= 0; i--) {
        next[i] = first[rows[i]];
        first[rows[i]] = i;
    }
    for (int64_t i = 0; i < count; i++) {
        int64_t limit = apart[i] < scene->close ? scene->nearest_close * scene->nearest : scene->nearest;
        keep[i] = rank_of(i, first[rows[i]], next, apart) < limit;
    }
    for (int64_t i = 0; i < count; i++) {
        if (keep[i]) {
            rows[kept] = rows[i];
            obstacles[kept++] = obstacles[i];
        }
    }
    return kept;
}

/* ---- Narrow phase of one pair ---- */

/* A swept hull (count = 2 v, the corners at the left node first) and an obstacle (k). */
typedef struct {
    int64_t count, k;
    const Vector *hull, *outline, *edges;
} Pair;

/* Largest coordinate of the obstacle along an axis, and the first corner that has it. */
static double support(const Pair *pair, Vector axis, Vector *corner)
{
    double high = dot(axis, pair->outline[0]);
    *corner = pair->outline[0];
    for (int64_t i = 1; i < pair->k; i++) {
        double height = dot(axis, pair->outline[i]);
        if (!(height <= high) && high == high) { /* the first NaN, as in NumPy */
            high = height;
            *corner = pair->outline[i];
        }
    }
    return high;
}

/* An axis and the separation along it. */
typedef struct {
    Vector axis;
    double gap;
} Candidate;

/* Replace the best candidate if an axis separates more. */
static void consider(const Pair *pair, Vector axis, Candidate *best, int is_first)
{
    Vector corner;
    double high = support(pair, axis, &corner), low = dot(axis, pair->hull[0]);
    for (int64_t i = 1; i < pair->count; i++) {
        if (!is_first && low - high <= best->gap)
            return; /* further vertices only lower the gap */
        low = least(low, dot(axis, pair->hull[i]));
    }
    double gap = low - high;
    if (is_first || gap > best->gap || (gap != gap && best->gap == best->gap))
        *best = (Candidate){axis, gap};
}

static Vector unit(Vector v, Vector fallback)
{
    double length = hypot(v.x, v.y);
    return length < 1e-9 ? fallback : (Vector){v.x / length, v.y / length};
}

/* The first pair of a hull vertex and a corner with the smallest distance. */
static void closest(const Pair *pair, int64_t *vertex, int64_t *corner)
{
    double nearest = INFINITY;
    *vertex = *corner = 0;
    for (int64_t i = 0; i < pair->count; i++) {
        for (int64_t j = 0; j < pair->k; j++) {
            double dx = pair->hull[i].x - pair->outline[j].x, dy = pair->hull[i].y - pair->outline[j].y;
            double squared = dx * dx + dy * dy;
            if (!(squared >= nearest) && nearest == nearest) { /* the first NaN, as in NumPy */
                nearest = squared;
                *vertex = i;
                *corner = j;
            }
        }
    }
}

/* A hull vertex in the frame (tangent, axis), or another vector, with a key to sort by. */
typedef struct {
    double along, height, key;
} Seen;

/* Sort by key, in the order of the input where keys are equal. */
static void sort(Seen *points, int64_t count)
{
    for (int64_t i = 1; i < count; i++) {
        Seen moved = points[i];
        int64_t j = i;
        for (; j > 0 && moved.key < points[j - 1].key; j--)
            points[j] = points[j - 1];
        points[j] = moved;
    }
}

/* Keep the edge normals of the body that face most along an axis, in the order of how far they do. Return their number.
 * inward: (v,), changed; points: work, (v,). */
static int64_t facing(const Scene *scene, Vector axis, int64_t v, Vector *inward, Seen *points)
{
    for (int64_t i = 0; i < v; i++)
        points[i] = (Seen){inward[i].x, inward[i].y, -dot(inward[i], axis)};
    sort(points, v);
    for (int64_t i = 0; i < scene->facing_edges; i++)
        inward[i] = (Vector){points[i].along, points[i].height};
    return scene->facing_edges;
}

/* The best of the candidates of the separating axis theorem: edge normals of the obstacle, inward edge normals (v,) of
 * the body, the direction between the closest vertices, and both normals of the chord of the closest vertex. Of a body
 * with many edges, those that face most along the best of the other candidates. points: work, (v,). */
static Candidate best_candidate(const Scene *scene, const Pair *pair, Vector *inward, Seen *points)
{
    int64_t vertex, corner, v = pair->count / 2, edges = v;
    Candidate best = {{0.0, 0.0}, 0.0};
    for (int64_t i = 0; i < pair->k; i++)
        consider(pair, pair->edges[i], &best, i == 0);
    closest(pair, &vertex, &corner);
    Vector here = pair->hull[vertex], there = pair->outline[corner], other = pair->hull[(vertex + v) % pair->count];
    Vector direct = {here.x - there.x, here.y - there.y}, chord = {here.y - other.y, other.x - here.x};
    direct = unit(direct, pair->edges[0]);
    chord = unit(chord, pair->edges[0]);
    Vector between[3] = {direct, chord, {-chord.x, -chord.y}};
    if (v > scene->facing_edges) {
        Candidate without = best;
        for (int64_t i = 0; i < 3; i++)
            consider(pair, between[i], &without, 0);
        edges = facing(scene, without.axis, v, inward, points);
    }
    for (int64_t i = 0; i < edges; i++)
        consider(pair, inward[i], &best, 0);
    for (int64_t i = 0; i < 3; i++)
        consider(pair, between[i], &best, 0);
    return best;
}

/* Sort the vertices that may form the lower side from left to right; return their number. */
static int64_t lower_side(const Scene *scene, const Pair *pair, Vector axis, Seen *points)
{
    int64_t lowest_point = 0, count = pair->count;
    for (int64_t i = 0; i < count; i++) {
        points[i] = (Seen){across(axis, pair->hull[i]), dot(axis, pair->hull[i]), 0.0};
        if (points[i].height < points[lowest_point].height)
            lowest_point = i;
    }
    if (count > scene->lowest_vertices) {
        double middle = points[lowest_point].along;
        for (int64_t i = 0; i < count; i++)
            points[i].key = points[i].height - scene->lowest_slope * fabs(points[i].along - middle);
        sort(points, count);
        count = scene->lowest_vertices;
    }
    for (int64_t i = 0; i < count; i++)
        points[i].key = points[i].along;
    sort(points, count);
    return count;
}

/* Replace the axis by the normal of the hull's lower edge over the support point of the obstacle if it separates more.
 * points: work, (2 v,). */
static Vector refined(const Scene *scene, const Pair *pair, Candidate best, Seen *points)
{
    Vector corner;
    support(pair, best.axis, &corner);
    double place = across(best.axis, corner), lowest_level = INFINITY, run = 0.0, rise = 0.0;
    int64_t count = lower_side(scene, pair, best.axis, points);
    for (int64_t a = 0; a < count; a++) {
        for (int64_t b = a + 1; b < count; b++) {
            double between = points[b].along - points[a].along, up = points[b].height - points[a].height;
            if (!(between > 1e-12))
                continue;
            double share = (place - points[a].along) / between;
            if (!(share >= -1e-9 && share <= 1.0 + 1e-9))
                continue;
            double level = points[a].height + share * up;
            if (level < lowest_level) {
                lowest_level = level;
                run = between;
                rise = up;
            }
        }
    }
    if (!isfinite(lowest_level))
        return best.axis;
    double length = hypot(run, rise), a = run / length, b = rise / length;
    Candidate edge = {{a * best.axis.x + b * best.axis.y, a * best.axis.y - b * best.axis.x}, 0.0};
    consider(pair, edge.axis, &edge, 1);
    return edge.gap > best.gap ? edge.axis : best.axis;
}

/* Bound (S12) by which vertex i may fall below its chord along the axis, with g'' at both ends and M3 of (S13). */
static double sag(Counts n, const Scene *scene, const Motion *motion, const Pair *pair, Vector axis, int64_t row,
                  int64_t i)
{
    int64_t part = row / n.intervals, interval = row % n.intervals, left = motion->left[interval];
    double step = motion->steps[interval], rate = motion->rate[interval], bend = 0.0;
    for (int64_t end = 0; end < 2; end++) {
        int64_t node = left + end;
        Vector place = {motion->poses[3 * node], motion->poses[3 * node + 1]};
        double kappa = motion->kappa[node];
        Vector corner = pair->hull[end * n.v + i];
        double along = dot(axis, corner) - dot(axis, place), beside = across(axis, corner) - across(axis, place);
        double lateral = motion->signs[left - interval] * kappa *
                         (axis.y * motion->cosine[node] - axis.x * motion->sine[node]);
        double found = lateral - rate * beside - kappa * kappa * along;
        bend = end == 0 ? found : most(bend, found);
    }
    double turn = most(fabs(motion->kappa[left]), fabs(motion->kappa[left + 1]));
    double reach = scene->reach[part * n.v + i];
    double third = fabs(rate) * (1.0 + 3.0 * turn * reach) + turn * turn * (1.0 + turn * reach);
    return 0.125 * (step * step) * most(bend + 0.5 * step * third, 0.0);
}

/* Requirement at the left and at the right end of an interval that covers the interval, see `_node_requirements`. */
static void requirements(const Motion *motion, int64_t left, double *first, double *last)
{
    *first = motion->required[left];
    *last = motion->required[left + 1];
    if (motion->rule[left] == motion->rule[left + 1])
        return;
    if (motion->rule[left] == 2) {
        *last = motion->leaving[left + 1];
        return;
    }
    *first = *last = most(*first, *last);
}

/* Write the margin (S11) of a pair and its terms. Rows of the result, (6 v + 2 k + 4, p): hull x, hull y, axis x, axis y,
 * heights, outline x, outline y, top, margin. dip: work, (v,). */
static void write_pair(Counts n, const Scene *scene, const Motion *motion, const Pair *pair, Vector axis, int64_t row,
                       double *dip, double *out, int64_t p)
{
    double *heights = out + (2 * pair->count + 2) * p, *outline = heights + pair->count * p;
    double first, last, top, margin = 0.0;
    Vector corner;
    requirements(motion, motion->left[row % n.intervals], &first, &last);
    for (int64_t i = 0; i < pair->count; i++) {
        double height = dot(axis, pair->hull[i]) - (i < n.v ? first : last);
        dip[i % n.v] = i < n.v ? sag(n, scene, motion, pair, axis, row, i) : dip[i % n.v];
        height -= dip[i % n.v];
        out[i * p] = pair->hull[i].x;
        out[(pair->count + i) * p] = pair->hull[i].y;
        heights[i * p] = height;
        margin = i == 0 ? height : least(margin, height);
    }
    out[2 * pair->count * p] = axis.x;
    out[(2 * pair->count + 1) * p] = axis.y;
    for (int64_t i = 0; i < pair->k; i++) {
        outline[i * p] = pair->outline[i].x;
        outline[(pair->k + i) * p] = pair->outline[i].y;
    }
    top = support(pair, axis, &corner);
    outline[2 * pair->k * p] = top;
    outline[(2 * pair->k + 1) * p] = margin - top;
}

/* Find the near pairs of a roll-out and bound their margins.
 *
 *   parts ... facing_edges      see `Counts` and `Scene`
 *   radius ... lowest_slope     see `Scene`
 *   scene     see `Scene.packed`: vertices, normals, reach, low, high of the body, outline, edges, lower, upper of the
 *             obstacles, then the numbers of `Rule`
 *   rollout   see `Rollout.packed`: poses, kappa, rate, steps
 *   signs     (gears,); left: (intervals,)
 *   pairs     out, (nodes + 3 p,): rule of the requirement, see `Requirement`; interval, part and obstacle
 *   out       out, (4 nodes + (6 v + 2 k + 4) p,): value, gradient (nodes, 2) and leaving of the requirement, and the
 *             table of `write_pair`; p is at most parts intervals times the smaller of obstacles and
 *             nearest_close nearest, or few
 *   work      2 parts (v + 2) nodes + 8 parts intervals + parts intervals obstacles + 8 v + 2 nodes numbers
 *   indices   work, 4 parts intervals obstacles + parts intervals
 *
 * Return p, the number of pairs. */
int64_t optdock_clearance_along(int64_t parts, int64_t v, int64_t obstacles, int64_t k, int64_t nodes,
                                int64_t intervals, int64_t few, int64_t nearest, int64_t nearest_close,
                                int64_t together, int64_t lowest_vertices, int64_t facing_edges, double radius,
                                double near, double close, double lowest_slope, const double *scene_arrays,
                                const double *rollout, const double *signs, const int64_t *left, int64_t *pairs,
                                double *out, double *work, int64_t *indices)
{
    Counts n = {parts, v, obstacles, k, nodes, intervals};
    const double *a = scene_arrays, *b = a + parts * (5 * v + 4), *rate = rollout + 4 * nodes;
    const Rule *rule = (const Rule *)(b + obstacles * (4 * k + 4));
    Scene scene = {a, a + 2 * parts * v, a + 4 * parts * v, a + 5 * parts * v, a + parts * (5 * v + 2),
                   b, b + 2 * obstacles * k, b + 4 * obstacles * k, b + obstacles * (4 * k + 2),
                   radius, near, close, few, nearest, nearest_close, together, lowest_vertices, facing_edges,
                   lowest_slope};
    double *cosine = work, *sine = work + nodes;
    Motion motion = {rollout, cosine, sine, rollout + 3 * nodes, out, out + 3 * nodes, rate + intervals, rate, signs,
                     pairs, left};
    write_required(rule, nodes, rollout, out, out + nodes, pairs, out + 3 * nodes);
    for (int64_t i = 0; i < nodes; i++) {
        cosine[i] = cos(rollout[3 * i + 2]);
        sine[i] = sin(rollout[3 * i + 2]);
    }
    pairs += nodes;
    out += 4 * nodes;
    work += 2 * nodes;
    int64_t columns = parts * nodes, rows = parts * intervals, room = rows * obstacles;
    Vector *vectors = (Vector *)work;
    Placed placed = {vectors, vectors + columns * v, vectors + columns * (v + 1)};
    vectors += columns * (v + 2);
    Swept swept = {vectors, vectors + rows, vectors + 2 * rows, vectors + 3 * rows};
    double *apart = (double *)(vectors + 4 * rows);
    Seen *points = (Seen *)(apart + room);
    Vector *inward = (Vector *)(points + 2 * v);
    int64_t *row_of = indices, *obstacle_of = indices + room, p;

    place_body(n, &scene, &motion, &placed);
    sweep(n, &scene, &motion, &placed, &swept);
    p = near_pairs(n, &scene, &motion, &swept, row_of, obstacle_of, apart);
    if (p > few)
        p = nearest_pairs(&scene, p, rows, row_of, obstacle_of, apart, indices + 2 * room, indices + 3 * room,
                          indices + 4 * room);
    for (int64_t i = 0; i < p; i++) {
        int64_t row = row_of[i], part = row / intervals, node = left[row % intervals];
        const Vector *corners = placed.corners + (part * nodes + node) * v; /* those of the next node follow */
        Pair pair = {2 * v, k, corners, (const Vector *)scene.outline + obstacle_of[i] * k,
                     (const Vector *)scene.edges + obstacle_of[i] * k};
        double c = motion.cosine[node], s = motion.sine[node];
        for (int64_t j = 0; j < v; j++) {
            Vector normal = at(scene.normals, part * v + j);
            double x = -normal.x, y = -normal.y;
            inward[j] = (Vector){c * x - s * y, s * x + c * y};
        }
        Vector axis = refined(&scene, &pair, best_candidate(&scene, &pair, inward, points), points);
        write_pair(n, &scene, &motion, &pair, axis, row, (double *)points, out + i, p);
        pairs[i] = row % intervals;
        pairs[p + i] = part;
        pairs[2 * p + i] = obstacle_of[i];
    }
    return p;
}
