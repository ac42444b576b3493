/* Clearances of poses for the search: the function `_clearances` of `free_space.py` in C.
 *
 * The signed distance of convex polygons is the largest gap over the edge normals of both and the direction between the
 * nearest vertices, as in `geometry/separation.py`. Only guesses depend on this file; the certificate has code of its
 * own. */

#include <math.h>
#include <stdint.h>

/* A polygon in the world: corners and outward normals (count, 2), offsets (count,). */
typedef struct {
    int64_t count;
    const double *corners, *normals, *offsets;
} Polygon;

/* A body in its own frame and its circles: centres (circles, 2), and their radius [m]. */
typedef struct {
    Polygon outline;
    int64_t circles;
    const double *centres;
    double radius;
} Body;

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

/* Signed distance of a body, whose corners in the world are given, (count, 2). local: work, corners of the piece. */
static double signed_distance(Polygon body, Pose at, const double *corners, Polygon piece, double *local)
{
    for (int64_t k = 0; k < piece.count; k++) { /* the corners of the piece in the frame of the body */
        double x = piece.corners[2 * k] - at.x, y = piece.corners[2 * k + 1] - at.y;
        local[2 * k] = at.c * x + at.s * y;
        local[2 * k + 1] = at.c * y - at.s * x;
    }
    double best = larger(gap_along_normals(piece, body.count, corners), gap_along_normals(body, piece.count, local));
    return larger(best, gap_of_vertices(body.count, corners, piece.count, piece.corners));
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

/* Compute the clearances of one body at n poses, as far as they are below those known so far.
 *
 *   n, m, v, k, circles   numbers of poses, obstacles, corners of the body and of an obstacle, and circles
 *   radius                of the circles [m]
 *   body                  vertices, normals (v, 2), offsets (v,), centres (circles, 2)
 *   poses                 (n, 3); turned: (n, 2), cosine and sine of the headings
 *   vertices, normals     (m, k, 2); offsets: (m, k); low, high: (m, 2), bounding boxes of the obstacles
 *   clearances            in and out, (n,) [m]
 *   work                  2 (v + k + circles) numbers */
int64_t optdock_pose_clearances(int64_t n, int64_t m, int64_t v, int64_t k, int64_t circles, double radius,
                                const double *body, const double *poses, const double *turned, const double *vertices,
                                const double *normals, const double *offsets, const double *low, const double *high,
                                double *clearances, double *work)
{
    Body moving = {{v, body, body + 2 * v, body + 4 * v}, circles, body + 5 * v, radius};
    double *corners = work, *local = work + 2 * v, *centres = local + 2 * k;
    for (int64_t i = 0; i < n; i++) {
        Pose at = {poses[3 * i], poses[3 * i + 1], turned[2 * i], turned[2 * i + 1]};
        for (int64_t j = 0; j < circles; j++) {
            double x = moving.centres[2 * j], y = moving.centres[2 * j + 1];
            centres[2 * j] = at.x + at.c * x - at.s * y;
            centres[2 * j + 1] = at.y + at.s * x + at.c * y;
        }
        for (int64_t j = 0; j < v; j++) {
            double x = moving.outline.corners[2 * j], y = moving.outline.corners[2 * j + 1];
            corners[2 * j] = at.x + (at.c * x - at.s * y);
            corners[2 * j + 1] = at.y + (at.s * x + at.c * y);
        }
        for (int64_t o = 0; o < m; o++) {
            double apart = broad_gap(circles, centres, radius, low + 2 * o, high + 2 * o);
            if (apart >= clearances[i] && apart > 0.0)
                continue;
            Polygon piece = {k, vertices + 2 * k * o, normals + 2 * k * o, offsets + k * o};
            clearances[i] = smaller(clearances[i], signed_distance(moving.outline, at, corners, piece, local));
        }
    }
    return 0;
}
