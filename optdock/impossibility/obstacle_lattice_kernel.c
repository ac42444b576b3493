/* Distances on a lattice: the functions `_to_obstacles` and `_least_and_most` of `obstacle_lattice.py` in C.
 *
 * Only the search for a proof depends on this file; the checker has code of its own. Sums and products are evaluated in
 * the order of the twins, so the results are equal to the last bit. */

#include <math.h>
#include <stdint.h>

enum { FREE = -2, INSIDE = -1 }; /* marks of nodes; all others are rows of samples */

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

/* Compute upper bounds of the distances of nodes from the obstacles.
 *
 *   n, spans, k      nodes along each side; numbers of spans and samples
 *   step             spacing of the nodes [m]
 *   covered          (spans, 3), row, first column, and column behind the last one, of nodes inside obstacles
 *   nodes, samples   (k, 2), column and row of the node next to each point of the outlines, and x, y of the points [m]
 *   room             (3, n, n), for marks and for nearest rows and columns; more: (3, n)
 *   found            out, (n, n) [m] */
int64_t optdock_lattice_distances(int64_t n, int64_t spans, int64_t k, double step, const int64_t *covered,
                                  const int64_t *nodes, const double *samples, int64_t *room, int64_t *more,
                                  double *found)
{
    int64_t *marks = room, *rows = room + n * n, *columns = room + 2 * n * n;
    for (int64_t i = 0; i < n * n; i++)
        marks[i] = FREE;
    for (int64_t i = 0; i < spans; i++)
        for (int64_t column = covered[3 * i + 1]; column < covered[3 * i + 2]; column++)
            marks[covered[3 * i] * n + column] = INSIDE;
    for (int64_t i = 0; i < k; i++)
        marks[nodes[2 * i + 1] * n + nodes[2 * i]] = i;
    within_columns(n, marks, rows);
    for (int64_t row = 0; row < n; row++) {
        for (int64_t column = 0; column < n; column++) {
            int64_t site = rows[row * n + column];
            more[column] = site < 0 ? -1 : absolute(row - site);
        }
        int any = along_row(n, more, more + n, more + 2 * n, columns + row * n);
        for (int64_t column = 0; column < n; column++) {
            if (!any) {
                found[row * n + column] = INFINITY;
                continue;
            }
            int64_t at = columns[row * n + column], site = rows[row * n + at], mark = marks[site * n + at];
            double x = mark == INSIDE ? step * (double)at : samples[2 * mark];
            double y = mark == INSIDE ? step * (double)site : samples[2 * mark + 1];
            double dx = step * (double)column - x, dy = step * (double)row - y;
            found[row * n + column] = sqrt(dx * dx + dy * dy);
        }
    }
    for (int64_t i = 0; i < spans; i++)
        for (int64_t column = covered[3 * i + 1]; column < covered[3 * i + 2]; column++)
            found[covered[3 * i] * n + column] = 0.0;
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
