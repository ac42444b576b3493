/* The required view along a path: the function `_seen_along` of `visibility_constraint.py` in C. A search for a path uses
 * it; the certificate does not. */

#include <math.h>
#include <stdint.h>

enum { MOST_EDGES = 4 }; /* two edges of the cone, and the smallest and the largest distance */

typedef struct {
    double x, y;
} Vector;

/* `ViewBound.packed`: stretch of the path [m], marker, camera on the robot, and limits of the view. */
typedef struct {
    double far, near, after; /* distances to the goal: of both ends of the stretch, and of the last node */
    Vector marker, mount;
    double yaw, half_angle, min_range, max_range; /* sees all around if half_angle >= pi */
} View;

/* The marker in the frame of a robot, and the inward normals and margins of the edges of the view, in this frame. */
typedef struct {
    Vector seen, normals[MOST_EDGES];
    double margins[MOST_EDGES];
} Edges;

static Vector turned(Vector v, double c, double s) { return (Vector){c * v.x - s * v.y, s * v.x + c * v.y}; }

/* The function `_edges` for one pose. */
static Edges edges_at(const View *view, const double pose[3])
{
    const double pi = 3.141592653589793;
    double c = cos(pose[2]), s = sin(pose[2]), mount_c = cos(view->yaw), mount_s = sin(view->yaw);
    Vector mount = view->mount, normals[MOST_EDGES];
    Vector camera = {pose[0] + c * mount.x - s * mount.y, pose[1] + s * mount.x + c * mount.y}; /* rounded as in NumPy */
    Vector ahead = {view->marker.x - camera.x, view->marker.y - camera.y};
    double camera_c = cos(pose[2] + view->yaw), camera_s = sin(pose[2] + view->yaw);
    Vector point = turned(ahead, camera_c, -camera_s);
    double length = hypot(point.x, point.y), distance = length < 1e-9 ? 1e-9 : length; /* NaN is kept */
    Vector outward = {point.x / distance, point.y / distance};
    Edges found;
    int count = 0;
    if (view->half_angle <= 0.5 * pi) {
        for (double side = 1.0; side >= -1.0; side -= 2.0)
            normals[count++] = (Vector){sin(view->half_angle), side * cos(view->half_angle)};
    } else if (view->half_angle < pi) {
        double most = view->half_angle - 0.5 * pi, bearing = atan2(point.y, point.x);
        bearing = bearing < -most ? -most : bearing > most ? most : bearing;
        normals[count++] = (Vector){cos(bearing), sin(bearing)};
    }
    for (int k = 0; k < count; k++)
        found.margins[k] = normals[k].x * point.x + normals[k].y * point.y;
    if (view->min_range > 0.0) {
        normals[count] = outward;
        found.margins[count++] = distance - view->min_range;
    }
    if (isfinite(view->max_range)) {
        normals[count] = (Vector){-outward.x, -outward.y};
        found.margins[count++] = view->max_range - distance;
    }
    for (int k = 0; k < count; k++)
        found.normals[k] = turned(normals[k], mount_c, mount_s);
    found.seen = turned(point, mount_c, mount_s);
    found.seen.x += view->mount.x;
    found.seen.y += view->mount.y;
    return found;
}

/* Compute the view at the positions along a path where it is required.
 *
 *   gears, nodes, edges   numbers; edges: of the view, at most 4
 *   same                  rounding of the places where the stretch begins and ends [m]
 *   divisions             (gears, 2), spans and intervals of each gear
 *   view                  see `View`
 *   signs, lengths        (gears,), directions and lengths [m]
 *   rollout               see `Rollout.packed`
 *   node                  out, (nodes + 2,), node before each of the p positions
 *   out                   out, (6 + 3 edges) (nodes + 2): distances after the nodes (p,), poses (p, 3), marker in the
 *                         frame of the robot (p, 2), inward normals (edges, p, 2), and margins minus what is lost
 *                         between the nodes (edges, p)
 *   work                  ((3 + edges) nodes,)
 *
 * Return p. */
int64_t optdock_seen_along(int64_t gears, int64_t nodes, int64_t edges, double same, const int64_t *divisions,
                           const double *view, const double *signs, const double *lengths, const double *rollout,
                           int64_t *node, double *out, double *work)
{
    const View *v = (const View *)view;
    double *left = work, *sign = left + nodes, *share = sign + nodes, *margins = share + nodes, later = 0.0;
    int64_t p = 0;
    for (int64_t m = gears - 1, i = nodes - 1; m >= 0; m--) {
        int64_t cells = divisions[2 * m + 1];
        for (int64_t cell = cells; cell >= 0; cell--, i--) {
            share[i] = (double)cell / (double)cells;
            left[i] = (1.0 - share[i]) * lengths[m] + later + v->after;
            sign[i] = signs[m];
        }
        later += lengths[m];
    }
    for (int64_t i = 0; i < nodes; i++) {
        Edges at = edges_at(v, rollout + 3 * i);
        for (int64_t k = 0; k < edges; k++)
            margins[k * nodes + i] = at.margins[k];
        if (left[i] <= v->far + same && left[i] >= v->near - same)
            node[p++] = i;
    }
    int64_t inside = p;
    double ahead[2];
    for (int end = 0; end < 2; end++) {
        double place = end == 0 ? v->far : v->near;
        if (!(left[nodes - 1] < place && place < left[0]))
            continue;
        int64_t before = nodes - 1;
        while (left[before] < place)
            before--;
        ahead[p - inside] = left[before] - place;
        node[p++] = before;
    }
    double *pose = out + p, *seen = pose + 3 * p, *normal = seen + 2 * p, *margin = normal + 2 * edges * p;
    for (int64_t j = 0; j < p; j++) {
        int64_t i = node[j];
        int is_inner = share[i] > 0.0 && share[i] < 1.0; /* not at an end of a gear */
        double further = j < inside ? 0.0 : ahead[j - inside], turn = further * rollout[3 * nodes + i];
        double middle = rollout[3 * i + 2] + 0.5 * turn, moved = sign[i] * further;
        out[j] = further;
        pose[3 * j] = rollout[3 * i] + moved * cos(middle);
        pose[3 * j + 1] = rollout[3 * i + 1] + moved * sin(middle);
        pose[3 * j + 2] = rollout[3 * i + 2] + turn;
        Edges at = edges_at(v, pose + 3 * j);
        seen[2 * j] = at.seen.x;
        seen[2 * j + 1] = at.seen.y;
        for (int64_t k = 0; k < edges; k++) {
            const double *m = margins + k * nodes + i;
            double sag = is_inner ? (m[-1] - 2.0 * m[0] + m[1]) / 8.0 : 0.0;
            normal[2 * (k * p + j)] = at.normals[k].x;
            normal[2 * (k * p + j) + 1] = at.normals[k].y;
            margin[k * p + j] = at.margins[k] - (sag < 0.0 ? 0.0 : sag);
        }
    }
    return p;
}
