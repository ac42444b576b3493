/* Collision checks of the search: poses, arcs and sequences of arcs by the distance field, its covering discs and exact
 * distances (R6, docs/theory/search.md). In C: `_are_free` of `free_space.py`, and `_extensions`, `are_free`,
 * `first_free`, `may_be_free` and, without a collision check, `_poses_by_gear` of `arcs.py`.
 *
 * Tiles of the field are computed when a pose first needs them. The signed distance of convex polygons is the largest
 * gap over the edge normals of both and the direction between the nearest vertices, as in `geometry/separation.py`. Only
 * guesses depend on this file; the certificate has code of its
 * own. */

#include <math.h>
#include <stdint.h>

#define TILE 32 /* grid points along the side of a tile */

/* Of `distance_field_kernel.c`. */
int64_t optdock_add_tile(int64_t tile, int64_t *progress, int64_t *slots, double *values, const int64_t *shape,
                         const double *grid, const double *vertices, const double *normals, const double *offsets,
                         const double *low, const double *high);

/* A polygon in the world: corners and outward normals (count, 2), offsets (count,). */
typedef struct {
    int64_t count;
    const double *corners, *normals, *offsets;
} Polygon;

typedef struct {
    double x, y, c, s; /* position [m], cosine and sine of the heading */
} Pose;

static double larger(double a, double b) { return a > b ? a : b; }

static double smaller(double a, double b) { return a < b ? a : b; }

static double lowest_along(double x, double y, int64_t count, const double *points)
{
    double low = INFINITY;
    for (int64_t i = 0; i < count; i++)
        low = smaller(low, x * points[2 * i] + y * points[2 * i + 1]);
    return low;
}

/* Largest gap between a polygon and points over the normals of the polygon. */
static double gap_along_normals(Polygon polygon, int64_t count, const double *points)
{
    double best = -INFINITY;
    for (int64_t i = 0; i < polygon.count; i++) {
        double low = lowest_along(polygon.normals[2 * i], polygon.normals[2 * i + 1], count, points);
        best = larger(best, low - polygon.offsets[i]);
    }
    return best;
}

/* Gap along the line through the nearest vertices of two sets of points; -inf if they coincide. */
static double gap_of_vertices(int64_t count, const double *points, int64_t others, const double *corners)
{
    double nearest = INFINITY, x = 0.0, y = 0.0, high = -INFINITY;
    for (int64_t i = 0; i < count; i++) {
        for (int64_t j = 0; j < others; j++) {
            double dx = points[2 * i] - corners[2 * j], dy = points[2 * i + 1] - corners[2 * j + 1];
            double squared = dx * dx + dy * dy;
            if (squared < nearest) {
                nearest = squared;
                x = dx;
                y = dy;
            }
        }
    }
    double length = sqrt(nearest), scale = 1.0 / larger(length, 1e-300);
    if (length <= 1e-12)
        return -INFINITY;
    x *= scale;
    y *= scale;
    for (int64_t j = 0; j < others; j++)
        high = larger(high, x * corners[2 * j] + y * corners[2 * j + 1]);
    return lowest_along(x, y, count, points) - high;
}

/* Whether the signed distance of a body, whose corners in the world are given, (count, 2), is at least the required one.
 * local: work, corners of the piece. */
static int is_apart(Polygon body, Pose at, const double *corners, Polygon piece, double required, double *local)
{
    if (gap_along_normals(piece, body.count, corners) >= required)
        return 1;
    for (int64_t k = 0; k < piece.count; k++) { /* the corners of the piece in the frame of the body */
        double x = piece.corners[2 * k] - at.x, y = piece.corners[2 * k + 1] - at.y;
        local[2 * k] = at.c * x + at.s * y;
        local[2 * k + 1] = at.c * y - at.s * x;
    }
    return gap_along_normals(body, piece.count, local) >= required ||
           gap_of_vertices(body.count, corners, piece.count, piece.corners) >= required;
}

/* Lower bound of the distance of a body, if it is positive, from its circles, (circles, 2) in the world. */
static double broad_gap(int64_t circles, const double *centres, double radius, const double *low, const double *high)
{
    double nearest = INFINITY;
    for (int64_t i = 0; i < circles; i++) {
        double x = larger(larger(low[0] - centres[2 * i], centres[2 * i] - high[0]), 0.0);
        double y = larger(larger(low[1] - centres[2 * i + 1], centres[2 * i + 1] - high[1]), 0.0);
        nearest = smaller(nearest, x * x + y * y);
    }
    return sqrt(nearest) - radius;
}

/* Points of a body, (count, 2), at a pose; out: placed, (count, 2). */
static void place(Pose at, int64_t count, const double *points, double *placed)
{
    for (int64_t i = 0; i < count; i++) {
        double x = points[2 * i], y = points[2 * i + 1];
        placed[2 * i] = at.x + (at.c * x - at.s * y);
        placed[2 * i + 1] = at.y + (at.s * x + at.c * y);
    }
}

/* Bounds of the distance of a point [m]; the lower bound is -inf outside the field. */
typedef struct {
    double lower, upper;
} Bounds;

/* The free space. */
typedef struct {
    int64_t *progress, *slots; /* of the field, as the next four: see `optdock_add_tile` */
    double *values;
    const int64_t *shape;
    const double *grid;
    int64_t m, k;             /* obstacles, corners of an obstacle */
    const double *vertices, *normals, *offsets, *low, *high;
    int64_t checked;          /* poses checked in this call */
    int64_t levels, discs[2]; /* of discs that are used: coarse, fine; numbers of discs of both */
    const double *circles[2]; /* (4, discs) each: x, y, radius that covers, radius inside [m] */
    int64_t bodies;
    const int64_t *body_sizes; /* (bodies, 2), corners and circles */
    const double *body_numbers; /* radius, reach, vertices, normals, offsets and centres of each */
    int64_t *near, near_count; /* rows of the obstacles near the poses in the box; -1: not collected yet */
    double box[4];             /* least x and y, largest x and y of the poses */
    double margin, relief, leaving; /* see `required_at`, as the next */
    const double *rule;
    double *work;              /* 2 (corners + k + circles) numbers */
} Space;

/* Arguments of all checks of poses:
 *
 *   margin, relief, leaving  [m], see `required_at`
 *   sizes     (4 + 2 bodies,): levels, coarse discs, fine discs, bodies; `body_sizes`
 *   numbers   15 numbers of `required_at`, `circles`, `body_numbers`
 *   near      work, (obstacles,); work: 2 (corners + corners of an obstacle + circles) numbers
 *   progress  in and out, (3,): items done; tiles that have values, and the number of them with which the call ends
 *   slots ... high  see `optdock_add_tile` */
#define LIMITS double margin, double relief, double leaving
#define SPACE_PARAMETERS                                                                                               \
    const int64_t *sizes, const double *numbers, int64_t *near, double *work, int64_t *progress, int64_t *slots,       \
        double *values, const int64_t *shape, const double *grid, const double *vertices, const double *normals,       \
        const double *offsets, const double *low, const double *high
#define SPACE                                                                                                          \
    (Space)                                                                                                            \
    {                                                                                                                  \
        progress, slots, values, shape, grid, shape[1], shape[2], vertices, normals, offsets, low, high, 0, sizes[0],  \
            {sizes[1], sizes[2]}, {numbers + 15, numbers + 15 + 4 * sizes[1]}, sizes[3], sizes + 4,                    \
            numbers + 15 + 4 * (sizes[1] + sizes[2]), near, -1, {0.0, 0.0, 0.0, 0.0}, margin, relief, leaving,         \
            numbers, work                                                                                              \
    }

/* A cell of the grid; NaN becomes 0. */
static double clamped(double cell, double last) { return cell > last ? last : cell > 0.0 ? cell : 0.0; }

/* Whether a tile has values, which are computed if the limit of tiles is not reached. */
static int has_values(Space *space, int64_t tile)
{
    return space->slots[tile] >= 0 ||
           optdock_add_tile(tile, space->progress, space->slots, space->values, space->shape, space->grid,
                            space->vertices, space->normals, space->offsets, space->low, space->high);
}

/* Set the bounds of the distance of a point. Return 0 if the tile of the point has no values. */
static int bounds_at(Space *space, double px, double py, Bounds *bounds)
{
    double spacing = space->grid[0], last = (double)(TILE * space->shape[0] - 1);
    double u = (px - space->grid[1]) / spacing, v = (py - space->grid[2]) / spacing;
    double column = rint(u), row = rint(v);
    int is_inside = column >= 0.0 && column <= last && row >= 0.0 && row <= last;
    int64_t i = (int64_t)clamped(column, last), j = (int64_t)clamped(row, last);
    int64_t tile = i / TILE * space->shape[0] + j / TILE;
    if (!has_values(space, tile))
        return 0;
    double distance = space->values[TILE * TILE * space->slots[tile] + TILE * (i % TILE) + j % TILE];
    double du = u - column, dv = v - row, away = spacing * sqrt(du * du + dv * dv);
    *bounds = (Bounds){is_inside ? distance - away : -INFINITY, distance + away};
    return 1;
}

/* State of a pose: 1 if the discs of a level prove the clearance, 2 if they exclude it, 4 if one is outside the field,
 * added; or -1 if a tile has no values. */
static int disc_state(Space *space, Pose at, double required, int level)
{
    int64_t discs = space->discs[level];
    const double *circles = space->circles[level];
    double lowest = INFINITY, highest = INFINITY;
    for (int64_t d = 0; d < discs; d++) {
        double cx = circles[d], cy = circles[discs + d];
        Bounds bounds;
        if (!bounds_at(space, at.x + at.c * cx - at.s * cy, at.y + at.s * cx + at.c * cy, &bounds))
            return -1;
        lowest = smaller(lowest, bounds.lower - circles[2 * discs + d]);
        highest = smaller(highest, bounds.upper - circles[3 * discs + d]);
    }
    return (lowest >= required) + 2 * (highest < required) + 4 * (lowest == -INFINITY);
}

/* Distance [m] from an end of the taper. */
static double tapered(const double *rule, double distance, double least)
{
    double beyond = larger(distance - rule[3], 0.0);
    double share = rule[2] > 0.0 ? smaller(beyond, rule[2]) / rule[2] : beyond > 0.0 ? 1.0 : 0.0;
    return least + (rule[0] - least) * share;
}

/* The required clearance at a position, as `FreeSpace.required` with a margin and a start relief, less the tolerance.
 * leaving: the least clearance of the start. rule: required, at_dock, taper, dock_run, slope, at_start (NaN: none), x and
 * y of start and goal, clearances of start and goal if positive, slope of the margin, tolerance, reach of the footprint. */
static double required_at(const Space *space, double x, double y)
{
    const double *rule = space->rule;
    double from_start = hypot(x - rule[6], y - rule[7]), from_goal = hypot(x - rule[8], y - rule[9]);
    double leaving = space->leaving + rule[4] * larger(0.0, from_start - space->relief);
    if (space->relief > 0.0 && rule[5] == rule[5])
        leaving = smaller(leaving, tapered(rule, from_start, rule[5]));
    double kept = smaller(tapered(rule, from_goal, rule[1]), leaving);
    if (space->margin > 0.0) {
        double ends = smaller(rule[10] + rule[12] * from_start, rule[11] + rule[12] * from_goal);
        kept = larger(kept, smaller(kept + space->margin, ends));
    }
    return kept - rule[13];
}

static void set_box(Space *space, double x0, double y0, double x1, double y1)
{
    space->near_count = -1;
    space->box[0] = x0;
    space->box[1] = y0;
    space->box[2] = x1;
    space->box[3] = y1;
}

/* Collect the obstacles that may be nearer than required to a footprint at a pose in the box. */
static void find_near(Space *space)
{
    double reach = space->rule[14] + space->rule[0] + larger(space->margin, 0.0) + 1e-3;
    const double *box = space->box;
    space->near_count = 0;
    for (int64_t o = 0; o < space->m; o++) {
        const double *low = space->low + 2 * o, *high = space->high + 2 * o;
        if (low[0] <= box[2] + reach && high[0] >= box[0] - reach && low[1] <= box[3] + reach &&
            high[1] >= box[1] - reach)
            space->near[space->near_count++] = o;
    }
}

/* Whether the exact clearance at a pose is at least the required one. */
static int is_clear(Space *space, Pose at, double required)
{
    const double *numbers = space->body_numbers;
    if (space->near_count < 0)
        find_near(space);
    for (int64_t b = 0; b < space->bodies; b++) {
        int64_t v = space->body_sizes[2 * b], circles = space->body_sizes[2 * b + 1];
        const double *body = numbers + 2, *centres = body + 5 * v;
        Polygon outline = {v, body, body + 2 * v, body + 4 * v};
        double *corners = space->work, *local = corners + 2 * v, *placed = local + 2 * space->k;
        place(at, circles, centres, placed);
        place(at, v, body, corners);
        for (int64_t i = 0; i < space->near_count; i++) {
            int64_t o = space->near[i], first = space->k * o;
            double apart = broad_gap(circles, placed, numbers[0], space->low + 2 * o, space->high + 2 * o);
            if (apart >= required && apart > 0.0)
                continue;
            Polygon piece = {space->k, space->vertices + 2 * first, space->normals + 2 * first, space->offsets + first};
            if (!is_apart(outline, at, corners, piece, required, local))
                return 0;
        }
        numbers += 2 + 5 * v + 2 * circles;
    }
    return 1;
}

/* Whether a pose is free: 1 or 0, or -1 if a tile has no values; it counts as checked. */
static int is_free(Space *space, double x, double y, double yaw)
{
    Pose at = {x, y, cos(yaw), sin(yaw)};
    if (space->m == 0)
        return 1;
    double required = required_at(space, x, y);
    space->checked++;
    for (int level = 0; level < space->levels; level++) {
        int state = disc_state(space, at, required, level);
        if (state < 0)
            return -1;
        if (state & 3 || (state && level == 0))
            return state & 1;
    }
    return is_clear(space, at, required);
}

/* Whether no coarse disc inside the footprint overlaps an obstacle: 1 or 0, or -1 if a tile has no values. */
static int may_be_free(Space *space, double x, double y, double yaw)
{
    Pose at = {x, y, cos(yaw), sin(yaw)};
    int state = disc_state(space, at, 0.0, 0);
    space->checked++;
    return state < 0 ? -1 : !(state & 2);
}

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

static int is_free_after(Space *space, const double *from, double length, double curvature)
{
    double pose[3];
    advance(from, length, curvature, pose);
    return is_free(space, pose[0], pose[1], pose[2]);
}

/* Whether poses are free, those from `done` on.
 *
 *   n, most   number of poses; most of them that are checked in this call
 *   poses     (n, 3); free: out, (n,), 1 or 0 */
int64_t optdock_are_free(int64_t n, int64_t most, LIMITS, const double *poses, int64_t *free, SPACE_PARAMETERS)
{
    Space space = SPACE;
    double x0 = INFINITY, y0 = INFINITY, x1 = -INFINITY, y1 = -INFINITY;
    int64_t i, end = progress[0] + most < n ? progress[0] + most : n;
    for (i = progress[0]; i < end; i++) {
        x0 = smaller(x0, poses[3 * i]);
        x1 = larger(x1, poses[3 * i]);
        y0 = smaller(y0, poses[3 * i + 1]);
        y1 = larger(y1, poses[3 * i + 1]);
    }
    set_box(&space, x0, y0, x1, y1);
    for (i = progress[0]; i < end; i++) {
        int found = is_free(&space, poses[3 * i], poses[3 * i + 1], poses[3 * i + 2]);
        if (found < 0)
            break;
        free[i] = found;
    }
    progress[0] = i;
    return 0;
}

/* Collision-free length of an arc up to `longest`, from poses `spacing` apart; -1 if a tile has no values. `bend`: sign of
 * the length, and curvature [1/m]. */
static double free_length(Space *space, const double *from, const double *bend, double longest, double spacing,
                          int64_t bisections)
{
    double free = 0.0, blocked = 0.0, count = larger(ceil((longest - 1e-9 - spacing) / spacing), 0.0);
    int found = 1;
    set_box(space, from[0] - longest, from[1] - longest, from[0] + longest, from[1] + longest);
    for (double j = 0.0; j <= count && found == 1; j += 1.0) {
        double length = j < count ? spacing + j * spacing : longest;
        found = is_free_after(space, from, bend[0] * length, bend[1]);
        if (found == 1)
            free = length;
        else
            blocked = length;
    }
    for (int64_t j = 0; j < bisections && found == 0; j++) {
        double middle = 0.5 * (free + blocked);
        int at_middle = is_free_after(space, from, bend[0] * middle, bend[1]);
        if (at_middle < 0)
            found = -1;
        else if (at_middle)
            free = middle;
        else
            blocked = middle;
    }
    return found < 0 ? -1.0 : free;
}

/* Ends of free arcs from nodes of a tree, by all moves from each node; see `_extensions` of `arcs.py`.
 *
 *   n, moves        numbers of arcs, and of moves from each node
 *   places, bisections, most  numbers of stations, of bisections, and of poses after which the call ends
 *   spacing         of the poses [m]
 *   gear            1, or -1 if the tree is built backwards in time
 *   speed, reverse_speed, reverse_price, stop  [m/s, m/s, s/m, s], prices of motion and of a change of gear
 *   rows            (n / moves,), rows of the tree
 *   nodes           (nodes, 7), of the tree: pose, price, sign and length of the last arc, curvature
 *   bends           (moves, 2), signs of the lengths and curvatures
 *   stations        (places,), ascending lengths [m]
 *   found           in and out, (1,), number of ends
 *   parents, ends   out, (n (places + 1),), rows of the tree; (n (places + 1), 7), as `nodes` */
int64_t optdock_extensions(int64_t n, int64_t moves, int64_t places, int64_t bisections, int64_t most, double spacing,
                           double gear, double speed, double reverse_speed, double reverse_price, double stop, LIMITS,
                           const int64_t *rows, const double *nodes, const double *bends, const double *stations,
                           int64_t *found, int64_t *parents, double *ends, SPACE_PARAMETERS)
{
    Space space = SPACE;
    int64_t i;
    for (i = progress[0]; i < n && space.checked < most; i++) {
        const double *node = nodes + 7 * rows[i / moves], *bend = bends + 2 * (i % moves);
        double free = free_length(&space, node, bend, stations[places - 1], spacing, bisections), reached = 0.0;
        if (free < 0.0)
            break;
        for (int64_t k = 0; k <= places; k++) {
            /* The end of the free length between two stations is also a station. */
            double length = k < places ? stations[k] : reached < free - 0.1 * spacing ? free : 0.0;
            if (!(length > 0.0 && length <= free + 1e-12))
                continue;
            reached = length;
            double driven = bend[0] * length, forward = gear * driven, *end = ends + 7 * found[0];
            double time = forward > 0.0 ? forward / speed : -forward / reverse_speed;
            advance(node, driven, bend[1], end);
            end[3] = node[3] + (time + reverse_price * larger(-forward, 0.0)) + stop * (node[4] * bend[0] < 0.0);
            end[4] = bend[0];
            end[5] = driven;
            end[6] = bend[1];
            parents[found[0]++] = rows[i / moves];
        }
    }
    progress[0] = i;
    return 0;
}

/* Whether a sequence of arcs is free at poses at most `spacing` apart and at all joints: 1 or 0, or -1 if a tile has no
 * values. */
static int is_free_along(Space *space, const double *start, int64_t count, const double *lengths,
                         const double *curvatures, double spacing)
{
    double joint[3] = {start[0], start[1], start[2]};
    int found = 1;
    for (int64_t j = 0; j < count && found == 1; j++) {
        double length = fabs(lengths[j]), parts = length > 1e-9 ? ceil(length / spacing - 1e-9) : 0.0;
        for (double rank = 0.0; rank < parts && found == 1; rank += 1.0)
            found = is_free_after(space, joint, lengths[j] * rank / parts, curvatures[j]);
        advance(joint, lengths[j], curvatures[j], joint);
    }
    return found == 1 ? is_free(space, joint[0], joint[1], joint[2]) : found;
}

/* Whether a sequence of arcs is free at shares of its length, ascending, or may be free in the rough check; otherwise as
 * `is_free_along`. */
static int passes_at_shares(Space *space, int is_rough, const double *start, int64_t count, const double *lengths,
                            const double *curvatures, int64_t places, const double *shares)
{
    double pose[3], joint[3] = {start[0], start[1], start[2]}, whole = 0.0, before = 0.0;
    int found = 1;
    int64_t j = 0;
    for (int64_t k = 0; k < count; k++)
        whole += fabs(lengths[k]);
    for (int64_t k = 0; k < places && found == 1; k++) {
        double s = whole * shares[k];
        for (; j < count - 1 && s > before + fabs(lengths[j]); j++) {
            before += fabs(lengths[j]);
            advance(joint, lengths[j], curvatures[j], joint);
        }
        advance(joint, copysign(s - before, lengths[j]), curvatures[j], pose);
        found = (is_rough ? may_be_free : is_free)(space, pose[0], pose[1], pose[2]);
    }
    return found;
}

/* Prepare the check of a sequence of arcs: no pose is outside the box. */
static void set_box_around(Space *space, const double *start, int64_t count, const double *lengths)
{
    double whole = 0.0;
    for (int64_t j = 0; j < count; j++)
        whole += fabs(lengths[j]);
    set_box(space, start[0] - whole, start[1] - whole, start[0] + whole, start[1] + whole);
}

/* Whether sequences of arcs are free at poses at most `spacing` apart and at all joints, those from `done` on.
 *
 *   n, count, most  numbers of sequences and of arcs of each, and of poses after which the call ends
 *   spacing         [m]
 *   starts          (n, 3); lengths, curvatures: (n, count); free: out, (n,), 1 or 0 */
int64_t optdock_free_sequences(int64_t n, int64_t count, int64_t most, double spacing, LIMITS, const double *starts,
                               const double *lengths, const double *curvatures, int64_t *free, SPACE_PARAMETERS)
{
    Space space = SPACE;
    int64_t i;
    for (i = progress[0]; i < n && space.checked < most; i++) {
        const double *start = starts + 3 * i;
        set_box_around(&space, start, count, lengths + count * i);
        int found = is_free_along(&space, start, count, lengths + count * i, curvatures + count * i, spacing);
        if (found < 0)
            break;
        free[i] = found;
    }
    progress[0] = i;
    return 0;
}

/* The first sequence of arcs that is free at shares of its length, and then at poses at most `spacing` apart and at all
 * joints, among those from `done` on.
 *
 *   n, count, places, most  numbers of sequences, of arcs of each, of shares, and of poses after which the call ends
 *   spacing                 [m]
 *   starts                  (n, 3); lengths, curvatures: (n, count); shares: (places,), ascending
 *   first                   out, (1,), the row of the sequence if one is found, which ends the check */
int64_t optdock_first_free(int64_t n, int64_t count, int64_t places, int64_t most, double spacing, LIMITS,
                           const double *starts, const double *lengths, const double *curvatures, const double *shares,
                           int64_t *first, SPACE_PARAMETERS)
{
    Space space = SPACE;
    int64_t i;
    for (i = progress[0]; i < n && space.checked < most; i++) {
        const double *start = starts + 3 * i, *along = lengths + count * i, *bends = curvatures + count * i;
        set_box_around(&space, start, count, along);
        int found = passes_at_shares(&space, 0, start, count, along, bends, places, shares);
        if (found == 1)
            found = is_free_along(&space, start, count, along, bends, spacing);
        if (found < 0)
            break;
        if (found) {
            first[0] = i;
            i = n - 1;
        }
    }
    progress[0] = i;
    return 0;
}

/* Whether no coarse disc inside the footprint overlaps an obstacle at shares of the length of sequences of arcs, those
 * from `done` on.
 *
 *   n, count, places, most  as for `optdock_first_free`; starts to shares too
 *   may                     out, (n,), 1 or 0 */
int64_t optdock_may_be_free(int64_t n, int64_t count, int64_t places, int64_t most, LIMITS, const double *starts,
                            const double *lengths, const double *curvatures, const double *shares, int64_t *may,
                            SPACE_PARAMETERS)
{
    Space space = SPACE;
    int64_t i;
    for (i = progress[0]; i < n && space.checked < most; i++) {
        int found = passes_at_shares(&space, 1, starts + 3 * i, count, lengths + count * i,
                                     curvatures + count * i, places, shares);
        if (found < 0)
            break;
        may[i] = found;
    }
    progress[0] = i;
    return 0;
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
