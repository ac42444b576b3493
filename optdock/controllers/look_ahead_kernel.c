/* Signed distances of a footprint to obstacles: the function `near_distances` of `look_ahead.py` in C.
 *
 * The axes are those of `optdock/geometry/separation.py`. Sines and cosines are those of the C library, so the results
 * are equal to those of the twin up to rounding. */

#include <math.h>
#include <stdint.h>

typedef struct {
    double x, y;
} Vector;

/* A convex polygon of `count` corners; its outward normals and their offsets. */
typedef struct {
    int64_t count;
    const Vector *corners, *normals;
    const double *offsets;
} Polygon;

static double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y; }

static Vector turned(Vector v, double c, double s) { return (Vector){c * v.x - s * v.y, s * v.x + c * v.y}; }

static double lowest(Vector axis, const Vector *points, int64_t count)
{
    double low = dot(axis, points[0]);
    for (int64_t i = 1; i < count; i++)
        low = fmin(low, dot(axis, points[i]));
    return low;
}

/* Gap along the line through the nearest two corners; -inf if they coincide. */
static double along_nearest(const Vector *mine, int64_t count, const Polygon *other)
{
    double nearest = INFINITY;
    Vector axis = {0.0, 0.0};
    for (int64_t i = 0; i < count; i++) {
        for (int64_t j = 0; j < other->count; j++) {
            Vector apart = {mine[i].x - other->corners[j].x, mine[i].y - other->corners[j].y};
            double squared = dot(apart, apart);
            if (squared < nearest) {
                nearest = squared;
                axis = apart;
            }
        }
    }
    double length = sqrt(nearest);
    if (!(length > 1e-12))
        return -INFINITY;
    axis = (Vector){axis.x / length, axis.y / length};
    return lowest(axis, mine, count) + lowest((Vector){-axis.x, -axis.y}, other->corners, other->count);
}

/* Signed distance of a body with the corners `mine` at a pose (3,) with the cosine c and the sine s. */
static double distance_to(const Polygon *body, const Vector *mine, const double *pose, double c, double s,
                          const Polygon *other)
{
    double best = along_nearest(mine, body->count, other);
    for (int64_t i = 0; i < other->count; i++)
        best = fmax(best, lowest(other->normals[i], mine, body->count) - other->offsets[i]);
    for (int64_t i = 0; i < body->count; i++) {
        Vector normal = turned(body->normals[i], c, s);
        double offset = body->offsets[i] + normal.x * pose[0] + normal.y * pose[1];
        best = fmax(best, lowest(normal, other->corners, other->count) - offset);
    }
    return best;
}

/* Distance of a point to a box. */
static double to_box(const double *point, const double *lower, const double *upper)
{
    double x = fmax(fmax(lower[0] - point[0], point[0] - upper[0]), 0.0);
    double y = fmax(fmax(lower[1] - point[1], point[1] - upper[1]), 0.0);
    return sqrt(x * x + y * y);
}

/* Compute the distances.
 *
 *   n, m, bodies, q   numbers of poses, obstacles, convex pieces of the footprint, and corners of an obstacle
 *   reach             distance of the origin to the bounding box of an obstacle from which on it is left out [m]
 *   sizes, numbers    the footprint, see `PackedFootprint`
 *   poses             (n, 3)
 *   vertices, normals, offsets, lower, upper   the obstacles: (m, q, 2), (m, q, 2), (m, q), (m, 2), (m, 2)
 *   out               out, (n, m)
 *   work              (most corners of a body, 2)
 *
 * Return n. */
int64_t optdock_near_distances(int64_t n, int64_t m, int64_t bodies, int64_t q, double reach, const int64_t *sizes,
                               const double *numbers, const double *poses, const double *vertices,
                               const double *normals, const double *offsets, const double *lower, const double *upper,
                               double *out, double *work)
{
    for (int64_t i = 0; i < n * m; i++)
        out[i] = INFINITY;
    for (int64_t k = 0; k < bodies; k++) {
        int64_t count = sizes[2 * k];
        const Vector *corners = (const Vector *)(numbers + 2);
        Polygon body = {count, corners, corners + count, (const double *)(corners + 2 * count)};
        Vector *mine = (Vector *)work;
        for (int64_t i = 0; i < n; i++) {
            const double *pose = poses + 3 * i;
            double c = cos(pose[2]), s = sin(pose[2]);
            for (int64_t j = 0; j < count; j++) {
                Vector corner = turned(corners[j], c, s);
                mine[j] = (Vector){pose[0] + corner.x, pose[1] + corner.y};
            }
            for (int64_t o = 0; o < m; o++) {
                if (!(to_box(pose, lower + 2 * o, upper + 2 * o) < reach))
                    continue;
                Polygon other = {q, (const Vector *)vertices + q * o, (const Vector *)normals + q * o, offsets + q * o};
                out[i * m + o] = fmin(out[i * m + o], distance_to(&body, mine, pose, c, s, &other));
            }
        }
        numbers += 2 + 5 * count + 2 * sizes[2 * k + 1];
    }
    return n;
}
