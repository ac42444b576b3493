/* Witness points of the smoother's separating planes: the function `_witnesses` of `linearization.py` in C.
 *
 * For each chosen pair, up to three points of the hull's lower side and their gaps to the upper side of the obstacle,
 * in the frame (tangent, axis) of the pair; they are the points of equation (S14) of docs/theory/smoother.md. Sums and
 * products are evaluated in the order of the twin, so the results are equal to the last bit. The certificate does not
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

/* Compute the witness points of the chosen pairs.
 *
 *   p, chosen, v2, k    numbers of pairs, of chosen pairs, of vertices of a hull and of an obstacle
 *   lowest_vertices ... see `CollisionSettings`
 *   index               (chosen,), columns of the chosen pairs
 *   axis_x, axis_y      (p,); hull_x, hull_y, heights: (v2, p); outline_x, outline_y: (k, p); top: (p,)
 *   vertices            out, (2, 3, chosen): first and second vertex of each point
 *   used                out, (3, chosen): whether the point differs from the first one
 *   values              out, (2, 3, chosen): share of the second vertex, and gap [m]
 *   work                4 (v2 + k) numbers
 *
 * Return -1 if a column is out of range, otherwise 0. */
int64_t optdock_witnesses(int64_t p, int64_t chosen, int64_t v2, int64_t k, int64_t lowest_vertices,
                          double support_slope, double same_witness, double lowest_slope, const int64_t *index,
                          const double *axis_x, const double *axis_y, const double *hull_x, const double *hull_y,
                          const double *heights, const double *outline_x, const double *outline_y, const double *top,
                          int64_t *vertices, int64_t *used, double *values, double *work)
{
    Settings settings = {support_slope, same_witness, lowest_slope, lowest_vertices};
    Vertex none = {0.0, 0.0, 0.0, 0};
    Side hull = {(Vertex *)work, none, 0, v2}, obstacle = {(Vertex *)work + v2, none, 0, k};
    for (int64_t c = 0; c < chosen; c++) {
        int64_t column = index[c];
        if (column < 0 || column >= p)
            return -1;
        double x = axis_x[column], y = axis_y[column], low = -INFINITY, high = INFINITY;
        for (int64_t i = 0; i < v2; i++)
            hull.vertices[i] = (Vertex){x * hull_y[p * i + column] - y * hull_x[p * i + column],
                                        heights[p * i + column], 0.0, i};
        for (int64_t i = 0; i < k; i++) {
            double px = outline_x[p * i + column], py = outline_y[p * i + column];
            obstacle.vertices[i] = (Vertex){x * py - y * px, -(x * px + y * py), 0.0, i};
        }
        prepare(&hull, settings);
        prepare(&obstacle, settings);
        flat_range(&hull, settings.support_slope, &low, &high);
        flat_range(&obstacle, settings.support_slope, &low, &high);
        int meets = high >= low;
        double bottom = hull.lowest.along;
        double places[3] = {meets ? smaller(larger(bottom, low), high) : bottom, meets ? low : bottom,
                            meets ? high : bottom};
        for (int64_t t = 0; t < 3; t++) {
            Point point = lowest_point(&hull, places[t]);
            double ceiling = meets ? -lowest_point(&obstacle, places[t]).height : top[column];
            vertices[chosen * t + c] = point.first;
            vertices[chosen * (3 + t) + c] = point.second;
            used[chosen * t + c] = t == 0 || fabs(places[t] - places[0]) > settings.same_witness;
            values[chosen * t + c] = point.share;
            values[chosen * (3 + t) + c] = point.height - ceiling;
        }
    }
    return 0;
}
