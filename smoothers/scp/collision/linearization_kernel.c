/* Rows of the smoother's separating planes: the function `separating_plane_rows` of `linearization.py` in C.
 *
 * For each chosen pair, up to three points of the hull's lower side and their gaps to the upper side of the obstacle,
 * in the frame (tangent, axis) of the pair; they are the witness points of equation (S14) of docs/theory/smoother.md,
 * and each has one row. Sums and products are evaluated in the order of the twin, so the results are equal to the last bit. The certificate does not
 * depend on this file. */

#include <math.h>
#include <stdint.h>

/* A vertex in the frame (tangent, axis), with its index and the key by which it is sorted. */
typedef struct {
    double along, height, key;
    int64_t index;
} Vertex;

/* Sides of a pair: count vertices from left to right that may form the lower side, of `all` vertices; lowest: the first
 * vertex of least height. For the obstacle, heights are negative, so that its upper side is a lower one. */
typedef struct {
    Vertex *vertices, lowest;
    int64_t count, all;
} Side;

/* A point of a lower side: share of the second vertex and height. */
typedef struct {
    int64_t first, second;
    double share, height;
} Point;

typedef struct {
    double support_slope, same_witness, lowest_slope;
    int64_t lowest_vertices;
} Settings;

static double larger(double a, double b) { return a > b || a != a ? a : b; }

static double smaller(double a, double b) { return a < b || a != a ? a : b; }

/* Sort by key, in the order of the input where keys are equal. */
static void sort(Vertex *vertices, int64_t count)
{
    for (int64_t i = 1; i < count; i++) {
        Vertex moved = vertices[i];
        int64_t j = i;
        for (; j > 0 && moved.key < vertices[j - 1].key; j--)
            vertices[j] = vertices[j - 1];
        vertices[j] = moved;
    }
}

/* Select and sort the vertices of a side whose `along` and `height` are given, as the function `chords`. */
static void prepare(Side *side, Settings settings)
{
    side->lowest = side->vertices[0];
    side->count = side->all;
    for (int64_t i = 1; i < side->all; i++)
        if (side->vertices[i].height < side->lowest.height)
            side->lowest = side->vertices[i];
    if (side->all > settings.lowest_vertices) {
        for (int64_t i = 0; i < side->all; i++) {
            Vertex *one = side->vertices + i;
            one->key = one->height - settings.lowest_slope * fabs(one->along - side->lowest.along);
        }
        sort(side->vertices, side->all);
        side->count = settings.lowest_vertices;
    }
    for (int64_t i = 0; i < side->count; i++)
        side->vertices[i].key = side->vertices[i].along;
    sort(side->vertices, side->count);
}

/* The lowest point of the chords at a tangent coordinate, or the lowest vertex if no chord reaches it. */
static Point lowest_point(const Side *side, double place)
{
    Point best = {side->lowest.index, side->lowest.index, 0.0, INFINITY};
    for (int64_t i = 0; i < side->count; i++) {
        for (int64_t j = i + 1; j < side->count; j++) {
            const Vertex *a = side->vertices + i, *b = side->vertices + j;
            double run = b->along - a->along, share = (place - a->along) / run;
            if (!(run > 1e-12 && share >= -1e-9 && share <= 1.0 + 1e-9))
                continue;
            double height = a->height + share * (b->height - a->height);
            if (height < best.height)
                best = (Point){a->index, b->index, smaller(larger(share, 0.0), 1.0), height};
        }
    }
    if (!isfinite(best.height))
        best = (Point){side->lowest.index, side->lowest.index, 0.0, side->lowest.height};
    return best;
}

/* Shrink the tangent range (low, high) to that in which all vertices (before their selection) are nearly flat. */
static void flat_range(const Side *side, double slope, double *low, double *high)
{
    double first = INFINITY, last = -INFINITY;
    for (int64_t i = 0; i < side->all; i++) {
        const Vertex *one = side->vertices + i;
        double limit = side->lowest.height + slope * fabs(one->along - side->lowest.along) + 1e-9;
        if (one->height <= limit) {
            first = smaller(first, one->along);
            last = larger(last, one->along);
        }
    }
    *low = larger(*low, first);
    *high = smaller(*high, last);
}

/* The witness points of the pairs: vertices (2, 3, chosen), used (3, chosen), values (2, 3, chosen): shares of the second
 * vertices and gaps [m]. */
typedef struct {
    int64_t *vertices, *used;
    double *values;
} Witnesses;

/* Witness points of the pair in `column` of `table`, see `Clearance.table`; c: index of the pair among the chosen. */
static void witness(int64_t p, int64_t chosen, int64_t column, int64_t c, const double *table, Settings settings,
                    Side *hull, Side *obstacle, Witnesses out)
{
    int64_t v2 = hull->all, k = obstacle->all;
    const double *at = table + column, *outline = at + p * (3 * v2 + 2);
    double x = at[p * 2 * v2], y = at[p * (2 * v2 + 1)], low = -INFINITY, high = INFINITY;
    for (int64_t i = 0; i < v2; i++)
        hull->vertices[i] = (Vertex){x * at[p * (v2 + i)] - y * at[p * i], at[p * (2 * v2 + 2 + i)], 0.0, i};
    for (int64_t i = 0; i < k; i++) {
        double px = outline[p * i], py = outline[p * (k + i)];
        obstacle->vertices[i] = (Vertex){x * py - y * px, -(x * px + y * py), 0.0, i};
    }
    prepare(hull, settings);
    prepare(obstacle, settings);
    flat_range(hull, settings.support_slope, &low, &high);
    flat_range(obstacle, settings.support_slope, &low, &high);
    int meets = high >= low;
    double bottom = hull->lowest.along;
    double places[3] = {meets ? smaller(larger(bottom, low), high) : bottom, meets ? low : bottom, meets ? high : bottom};
    for (int64_t t = 0; t < 3; t++) {
        Point point = lowest_point(hull, places[t]);
        double ceiling = meets ? -lowest_point(obstacle, places[t]).height : outline[p * 2 * k];
        out.vertices[chosen * t + c] = point.first;
        out.vertices[chosen * (3 + t) + c] = point.second;
        out.used[chosen * t + c] = t == 0 || fabs(places[t] - places[0]) > settings.same_witness;
        out.values[chosen * t + c] = point.share;
        out.values[chosen * (3 + t) + c] = point.height - ceiling;
    }
}

/* Poses (nodes, 3), gradients of the required clearance (nodes, 2), and derivatives of the poses (nodes, size) each. */
typedef struct {
    const double *poses, *required, *by_x, *by_y, *by_yaw;
} Path;

/* Write, or add, the gradient of one hull vertex, with its weight, to a row (S14). */
static void add_vertex(const Path *path, int64_t size, double weight, const double axis[2], const double corner[2],
                       int64_t node, int is_first, double *row)
{
    double arm_x = corner[0] - path->poses[3 * node], arm_y = corner[1] - path->poses[3 * node + 1];
    double x = weight * (axis[0] - path->required[2 * node]), y = weight * (axis[1] - path->required[2 * node + 1]);
    double turn = weight * (axis[1] * arm_x - axis[0] * arm_y);
    const double *by_x = path->by_x + node * size, *by_y = path->by_y + node * size, *by_yaw = path->by_yaw + node * size;
    for (int64_t j = 0; j < size; j++) {
        double value = x * by_x[j] + y * by_y[j] + turn * by_yaw[j];
        row[j] = is_first ? value : row[j] + value;
    }
}

/* Compute the rows (S14) of the chosen pairs, first those of all first witness points.
 *
 *   p, chosen, v2, k    numbers of pairs, of chosen pairs, of vertices of a hull and of an obstacle
 *   nodes, intervals, size     numbers of nodes, intervals and variables
 *   lowest_vertices ... see `CollisionSettings`
 *   index      (chosen,), columns of the chosen pairs
 *   interval   (p,); left: (intervals,), node at which an interval begins
 *   table      (3 v2 + 2 k + 4, p), see `Clearance.table`
 *   poses      (nodes, 3); required: (nodes, 2), gradient of the required clearance
 *   by_x, by_y, by_yaw    (nodes, size)
 *   node       out and work, (3 chosen + 9 chosen,): the left node of each row, work
 *   rows       out and work, (3 chosen (size + 1) + 6 chosen + 4 (v2 + k),): gradients (3 chosen, size), gaps
 *              (3 chosen,) [m], work
 *
 * Return the number of rows, or -1 if an index is out of range. */
int64_t optdock_separating_plane_rows(int64_t p, int64_t chosen, int64_t v2, int64_t k, int64_t nodes,
                                      int64_t intervals, int64_t size, int64_t lowest_vertices, double support_slope,
                                      double same_witness, double lowest_slope, const int64_t *index,
                                      const int64_t *interval, const int64_t *left, const double *table,
                                      const double *poses, const double *required, const double *by_x,
                                      const double *by_y, const double *by_yaw, int64_t *node, double *rows)
{
    Settings settings = {support_slope, same_witness, lowest_slope, lowest_vertices};
    Path path = {poses, required, by_x, by_y, by_yaw};
    double *gap = rows + 3 * chosen * size;
    Witnesses found = {node + 3 * chosen, node + 9 * chosen, gap + 3 * chosen};
    Vertex none = {0.0, 0.0, 0.0, 0}, *work = (Vertex *)(gap + 9 * chosen);
    Side hull = {work, none, 0, v2}, obstacle = {work + v2, none, 0, k};
    int64_t count = 0;
    for (int64_t c = 0; c < chosen; c++) {
        if (index[c] < 0 || index[c] >= p || interval[index[c]] < 0 || interval[index[c]] >= intervals ||
            left[interval[index[c]]] < 0 || left[interval[index[c]]] + 1 >= nodes)
            return -1;
        witness(p, chosen, index[c], c, table, settings, &hull, &obstacle, found);
    }
    for (int64_t i = 0; i < 3 * chosen; i++) {
        if (!found.used[i])
            continue;
        const double *at = table + index[i % chosen];
        double axis[2] = {at[p * 2 * v2], at[p * (2 * v2 + 1)]}, share = found.values[i];
        node[count] = left[interval[index[i % chosen]]];
        for (int64_t second = 0; second < 2; second++) {
            int64_t vertex = found.vertices[3 * chosen * second + i];
            double corner[2] = {at[p * vertex], at[p * (v2 + vertex)]};
            add_vertex(&path, size, second ? share : 1.0 - share, axis, corner, node[count] + (vertex >= v2 / 2),
                       !second, rows + count * size);
        }
        gap[count++] = found.values[3 * chosen + i];
    }
    return count;
}
