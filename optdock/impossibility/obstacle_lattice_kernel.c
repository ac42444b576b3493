/* Distances on a lattice: the functions `_distances` and `least_and_most` of `obstacle_lattice.py` in C.
 *
 * Only the search for a proof depends on this file; the checker has code of its own. Sums and products are evaluated in
 * the order of the twins, so the results are equal to the last bit. */

#include <math.h>
#include <stdint.h>

enum { FREE = 0, SITE = 1, INSIDE = 2 }; /* marks of nodes; a site inside an obstacle may also be at an outline */

static int64_t absolute(int64_t a) { return a < 0 ? -a : a; }

/* Squared distance in steps from column x to the column of a site, whose rows differ by `apart`. */
static int64_t squared(int64_t x, int64_t column, int64_t apart)
{
    return (x - column) * (x - column) + apart * apart;
}

/* Row of the nearest site in the column of every node, the upper one of two; -1 without one. `nearest`: (n, n). */
static void within_columns(int64_t n, const int64_t *marks, int64_t *nearest)
{
    for (int64_t i = 0; i < n * n; i++)
        nearest[i] = marks[i] != FREE ? i / n : (i >= n ? nearest[i - n] : -1);
    for (int64_t row = n - 2; row >= 0; row--) {
        for (int64_t column = 0; column < n; column++) {
            int64_t above = nearest[row * n + column], below = nearest[(row + 1) * n + column];
            if (below > row && (above < 0 || below - row < row - above))
                nearest[row * n + column] = below;
        }
    }
}

/* Column of the nearest site of every node of a row, the left one of two: lower envelope of parabolas.
 *
 *   apart     (n,), rows between the nodes and the nearest sites in their columns; -1 without one
 *   columns   (n,), room for the columns of the envelope; first: (n,), room for the first nodes of their parts
 *   found     out, (n,)
 *
 * Returns whether there is a site. */
static int along_row(int64_t n, const int64_t *apart, int64_t *columns, int64_t *first, int64_t *found)
{
    int64_t last = -1;
    for (int64_t u = 0; u < n; u++) {
        if (apart[u] < 0)
            continue;
        while (last >= 0 && squared(first[last], columns[last], apart[columns[last]]) >
                                squared(first[last], u, apart[u]))
            last--;
        int64_t begin = 0;
        if (last >= 0) {
            int64_t i = columns[last];
            begin = 1 + (u * u - i * i + apart[u] * apart[u] - apart[i] * apart[i]) / (2 * (u - i));
        }
        if (begin < n) {
            last++;
            columns[last] = u;
            first[last] = begin;
        }
    }
    if (last < 0)
        return 0;
    for (int64_t x = n - 1; x >= 0; x--) {
        found[x] = columns[last];
        if (x == first[last])
            last--;
    }
    return 1;
}

/* A lattice of n x n nodes: spacing [m], and position of the first node relative to the origin [m]. */
typedef struct {
    int64_t n;
    double step, corner[2];
} Lattice;

/* Nodes at obstacles: marks (n, n), and the obstacle point of each site, (n, n, 2) [m]. */
typedef struct {
    int64_t *marks;
    double *points;
} Sites;

static double clipped(double x, double low, double high) { return x < low ? low : (x > high ? high : x); }

static double smaller(double a, double b) { return a < b ? a : b; }

static double larger(double a, double b) { return a > b ? a : b; }

/* Mark the nodes in a convex polygon with q edges and the bounding box (lower, upper). */
static void mark_inside(const Lattice *lattice, int64_t q, const double *normals, const double *offsets,
                        const double *lower, const double *upper, Sites *sites)
{
    int64_t n = lattice->n;
    double low[2], high[2], last = (double)(n - 1), step = lattice->step;
    for (int i = 0; i < 2; i++) {
        low[i] = (lower[i] - lattice->corner[i]) / step;
        high[i] = (upper[i] - lattice->corner[i]) / step;
        if (!(high[i] >= 0.0 && low[i] <= last))
            return;
    }
    for (int64_t row = (int64_t)ceil(clipped(low[1], 0.0, last)); row <= (int64_t)floor(clipped(high[1], 0.0, last));
         row++) {
        double until = INFINITY, since = -INFINITY;
        for (int64_t e = 0; e < q; e++) {
            double nx = normals[2 * e], ny = normals[2 * e + 1], steep = step * nx;
            double offset = offsets[e] - (nx * lattice->corner[0] + ny * lattice->corner[1]);
            double room = offset - ny * (step * (double)row);
            /* An edge with its normal along y admits all or none of a row. */
            double bound = nx != 0.0 ? room / steep : (room < 0.0 ? -INFINITY : INFINITY);
            if (steep > 0.0 || nx == 0.0)
                until = smaller(until, bound);
            if (steep < 0.0)
                since = larger(since, bound);
        }
        int64_t stop = (int64_t)floor(clipped(until, -1.0, last)) + 1;
        for (int64_t column = (int64_t)ceil(clipped(since, 0.0, (double)n)); column < stop; column++) {
            int64_t node = row * n + column;
            sites->marks[node] = INSIDE;
            sites->points[2 * node] = step * (double)column;
            sites->points[2 * node + 1] = step * (double)row;
        }
    }
}

/* Mark the nodes next to points of an edge from `start` to `end`, (2,) [m], clipped to the lattice ([Liang1984]). */
static void mark_edge(const Lattice *lattice, const double *start, const double *end, Sites *sites)
{
    double extent = lattice->step * (double)(lattice->n - 1), enter = 0.0, leave = 1.0, from[2];
    double along[2] = {end[0] - start[0], end[1] - start[1]};
    if (start[0] == end[0] && start[1] == end[1])
        return; /* a repeated corner */
    for (int i = 0; i < 2; i++) {
        if (!(smaller(start[i], end[i]) <= lattice->corner[i] + extent && larger(start[i], end[i]) >= lattice->corner[i]))
            return;
        from[i] = start[i] - lattice->corner[i];
        if (along[i] != 0.0) {
            double first = -from[i] / along[i], second = (extent - from[i]) / along[i];
            enter = larger(enter, smaller(first, second));
            leave = smaller(leave, larger(first, second));
        }
    }
    if (!(enter <= leave))
        return;
    double parts = ceil((leave - enter) * hypot(along[0], along[1]) / (0.5 * lattice->step));
    for (double rank = 0.0; rank <= parts; rank += 1.0) {
        double share = enter + rank / larger(parts, 1.0) * (leave - enter);
        double x = clipped(from[0] + share * along[0], 0.0, extent);
        double y = clipped(from[1] + share * along[1], 0.0, extent);
        int64_t node = (int64_t)rint(y / lattice->step) * lattice->n + (int64_t)rint(x / lattice->step);
        sites->marks[node] |= SITE;
        sites->points[2 * node] = x;
        sites->points[2 * node + 1] = y;
    }
}

/* Compute upper bounds of the distances of nodes from the obstacles.
 *
 *   n, m, q          nodes along each side; obstacles and their corners
 *   step             spacing of the nodes [m]; corner_x, corner_y: first node [m]
 *   normals, offsets (m, q, 2), (m, q) [m]; lower, upper: (m, 2) [m], bounding boxes
 *   vertices         (m, q, 2) [m]
 *   points           room for (n, n, 2); room: (3, n, n) for marks, nearest rows and columns; more: (3, n)
 *   found            out, (n, n) [m] */
int64_t optdock_lattice_distances(int64_t n, int64_t m, int64_t q, double step, double corner_x, double corner_y,
                                  const double *normals, const double *offsets, const double *lower,
                                  const double *upper, const double *vertices, double *points, int64_t *room,
                                  int64_t *more, double *found)
{
    Lattice lattice = {n, step, {corner_x, corner_y}};
    Sites sites = {room, points};
    int64_t *rows = room + n * n, *columns = room + 2 * n * n;
    for (int64_t i = 0; i < n * n; i++)
        sites.marks[i] = FREE;
    for (int64_t o = 0; o < m; o++)
        mark_inside(&lattice, q, normals + 2 * q * o, offsets + q * o, lower + 2 * o, upper + 2 * o, &sites);
    for (int64_t e = 0; e < m * q; e++)
        mark_edge(&lattice, vertices + 2 * e, vertices + 2 * ((e + 1) % q != 0 ? e + 1 : e + 1 - q), &sites);
    within_columns(n, sites.marks, rows);
    for (int64_t row = 0; row < n; row++) {
        for (int64_t column = 0; column < n; column++) {
            int64_t site = rows[row * n + column];
            more[column] = site < 0 ? -1 : absolute(row - site);
        }
        int any = along_row(n, more, more + n, more + 2 * n, columns + row * n);
        for (int64_t column = 0; column < n; column++) {
            int64_t node = row * n + column;
            if (!any || sites.marks[node] & INSIDE) {
                found[node] = any ? 0.0 : INFINITY;
                continue;
            }
            const double *point = points + 2 * (rows[row * n + columns[node]] * n + columns[node]);
            double dx = step * (double)column - point[0], dy = step * (double)row - point[1];
            found[node] = sqrt(dx * dx + dy * dy);
        }
    }
    return 0;
}

/* Compute for each heading and cell the smallest clearance of the discs of a body, and an upper bound of it.
 *
 *   headings, cells, discs, nodes   numbers
 *   at             (cells,), nodes at the middles of the cells; shift: (headings, discs), from there to the discs
 *   distance       (nodes,) [m]; radius, moved: (discs,), radii and largest displacements within a cell [m]
 *   least, most    out, (headings, cells) [m]
 *
 * Returns 1 if a node is not in the lattice. */
int64_t optdock_lattice_clearances(int64_t headings, int64_t cells, int64_t discs, int64_t nodes, const int64_t *at,
                                   const int64_t *shift, const double *distance, const double *radius,
                                   const double *moved, double *least, double *most)
{
    for (int64_t h = 0; h < headings; h++) {
        for (int64_t c = 0; c < cells; c++) {
            double low = INFINITY, high = INFINITY;
            for (int64_t d = 0; d < discs; d++) {
                int64_t node = at[c] + shift[h * discs + d];
                if (node < 0 || node >= nodes)
                    return 1;
                double clearance = distance[node] - radius[d], bound = clearance + moved[d];
                low = clearance < low ? clearance : low;
                high = bound < high ? bound : high;
            }
            least[h * cells + c] = low;
            most[h * cells + c] = high;
        }
    }
    return 0;
}
