/* Iterations of the smoother: the functions `evaluated` and `linearized` of `loop.py` and `solve_step` of `qp_step.py` in
 * C.
 *
 * They call the kernels of their parts. Sums and products are evaluated in the order of the twins, with the sines and
 * cosines of the C library; where NumPy uses the same, results are equal to the last bit. A search for a path uses
 * them; the certificate does not. */

#include <math.h>
#include <stdint.h>

int64_t optdock_project_and_roll_out(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals,
                                     int64_t most_steps, int64_t alternations, double tolerance, double renew,
                                     double contraction, double reach, double rate, double inner_rate,
                                     const double *packed, const int64_t *divisions, const double *given, double *out);
int64_t optdock_clearance_along(int64_t parts, int64_t v, int64_t obstacles, int64_t k, int64_t nodes,
                                int64_t intervals, int64_t few, int64_t nearest, int64_t nearest_close,
                                int64_t together, int64_t lowest_vertices, int64_t facing_edges, double radius,
                                double near, double close, double lowest_slope, const double *scene_arrays,
                                const double *rollout, const double *signs, const int64_t *left, int64_t *pairs,
                                double *out, double *work, int64_t *indices);
int64_t optdock_sensitivity(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals, const double *packed,
                            const int64_t *divisions, const double *z, const double *moved, double *out, double *work);
int64_t optdock_separating_plane_rows(int64_t p, int64_t chosen, int64_t v2, int64_t k, int64_t nodes,
                                      int64_t intervals, int64_t size, int64_t lowest_vertices, double support_slope,
                                      double same_witness, double lowest_slope, const int64_t *index,
                                      const int64_t *interval, const int64_t *left, const double *table,
                                      const double *poses, const double *required, const double *by_x,
                                      const double *by_y, const double *by_yaw, int64_t *node, double *rows);
int64_t optdock_term_points(int64_t gears, int64_t nodes, double before, double after, const int64_t *divisions,
                            const double *lengths, const double *signs, const double *rollout, double *points);
int64_t optdock_minimizer(int64_t n, int64_t m, int64_t leading, int64_t guessed, int64_t rounds, double unbounded,
                          double tolerance, double attained, const double *h, const double *g, const double *a,
                          const double *bounds, const int64_t *guess, int64_t *ints, double *doubles);

/* Counts and other integers, the first ones of `PackedProgram.counts`, then the arrays of `Program` that are integers. */
typedef struct {
    int64_t gears, knots, nodes, intervals, parts, v, obstacles, k;
    int64_t few, nearest, nearest_close, together, lowest_vertices, facing_edges; /* see `CollisionSettings` */
    int64_t few_planes, thins, discs_per_node, discs;                             /* discs: most of a part */
    int64_t most_steps, alternations, zones, trusted, is_limited, most;           /* most: rows of clearance */
    int64_t has_terms;
} Counts;

/* The first numbers of `PackedProgram.numbers`, then the arrays of `Program` that are doubles. */
typedef struct {
    double radius, width, required, close, lowest_slope; /* body, rule and `CollisionSettings` [m] */
    double clear, deep, very_deep, near_deep, support_slope, same_witness;
    double tolerance, renew, contraction, goal_reach, rate, inner_rate; /* see `Goal` in rollout_kernel.c */
    double reach, most_reach, reach_per_motion, least_reach, end_allowance; /* see `LoopSettings` */
    double length, tracking;                                                /* weights of the cost */
    double taper, yaw_motion, curved_goal, curved_clearance, ridge;         /* see `StepSettings` */
    double before, after;                                                   /* see `TermBound` */
} Numbers;

/* The constants of a program. */
typedef struct {
    Counts n;
    Numbers is;
    int64_t size;                       /* knots and gears */
    const int64_t *divisions, *left;    /* (gears, 2); (intervals,) */
    const int64_t *trusted, *is_small;  /* (trusted,), nodes; (obstacles,) */
    const int64_t *discs;               /* (parts,), numbers of discs */
    const double *ends, *start, *signs, *target; /* ends: all from start to inner_upper; (3,), (gears,), (3,) */
    const double *inner_lower, *inner_upper;     /* (size,) */
    const double *bend, *jerk, *turning;         /* (knots, knots), Hessians of the cost: elements next to the diagonal */
    const double *positions, *normals;           /* (nodes, 2), input path */
    const double *disc_radius, *disc_centres;    /* (parts,); (parts, discs, 2) */
} Program;

static Program program_of(const int64_t *counts, const double *numbers)
{
    Program p = {.n = *(const Counts *)counts, .is = *(const Numbers *)numbers};
    int64_t size = p.size = p.n.knots + p.n.gears, square = p.n.knots * p.n.knots;
    p.divisions = counts + sizeof(Counts) / sizeof(int64_t);
    p.left = p.divisions + 2 * p.n.gears;
    p.trusted = p.left + p.n.intervals;
    p.is_small = p.trusted + p.n.trusted;
    p.discs = p.is_small + p.n.obstacles;
    p.ends = p.start = numbers + sizeof(Numbers) / sizeof(double);
    p.signs = p.start + 3;
    p.target = p.signs + p.n.gears;
    p.inner_lower = p.target + 3 + 2 * size;
    p.inner_upper = p.inner_lower + size;
    p.bend = p.inner_upper + size;
    p.jerk = p.bend + square;
    p.turning = p.jerk + square;
    p.positions = p.turning + square;
    p.normals = p.positions + 2 * p.n.nodes;
    p.disc_radius = p.normals + 2 * p.n.nodes;
    p.disc_centres = p.disc_radius + p.n.parts;
    return p;
}

static double least(double a, double b) { return a < b || a != a ? a : b; }

static double most(double a, double b) { return a > b || a != a ? a : b; }

static void copy(double *to, const double *from, int64_t count)
{
    for (int64_t i = 0; i < count; i++)
        to[i] = from[i];
}

static double sum_of(const double *values, int64_t count)
{
    double sum = values[0];
    for (int64_t i = 1; i < count; i++)
        sum += values[i];
    return sum;
}

static double dot(const double *a, const double *b, int64_t count)
{
    double sum = a[0] * b[0];
    for (int64_t i = 1; i < count; i++)
        sum += a[i] * b[i];
    return sum;
}

static int64_t zone_of(const Program *p, int64_t node)
{
    int64_t zone = node * p->n.zones / p->n.nodes;
    return zone < p->n.zones - 1 ? zone : p->n.zones - 1;
}

/* Element `knot` of a product of a matrix whose other elements than those next to the diagonal are 0. */
static double banded(const Program *p, const double *matrix, int64_t knot, const double *curvature)
{
    int64_t first = knot > 0 ? knot - 1 : 0, end = knot + 2 < p->n.knots ? knot + 2 : p->n.knots;
    return dot(matrix + knot * p->n.knots + first, curvature + first, end - first);
}

/* ---- Evaluation ---- */

static double lateral(const Program *p, const double *poses, int64_t node)
{
    const double *place = p->positions + 2 * node, *normal = p->normals + 2 * node;
    return (poses[3 * node] - place[0]) * normal[0] + (poses[3 * node + 1] - place[1]) * normal[1];
}

static double squared_laterals(const Program *p, const double *poses)
{
    double sum = 0.0;
    for (int64_t i = 0; i < p->n.nodes; i++)
        sum += lateral(p, poses, i) * lateral(p, poses, i);
    return sum;
}

/* The function `CostModel.value`. */
static double cost_of(const Program *p, const double *z, const double *poses)
{
    double total = sum_of(z + p->n.knots, p->n.gears), bent = 0.0;
    for (int64_t m = 0, j = 0; m < p->n.gears; m++) {
        double length = z[p->n.knots + m];
        for (int64_t end = j + p->divisions[2 * m]; j <= end; j++) {
            double by = length * banded(p, p->bend, j, z) + banded(p, p->jerk, j, z) / length +
                        banded(p, p->turning, j, z);
            bent += z[j] * by;
        }
    }
    double tracked = p->is.tracking * total / (double)p->n.intervals * squared_laterals(p, poses);
    return p->is.length * total + 0.5 * bent + tracked;
}

/* The largest change of a heading [rad] or length [m] since an earlier iterate. */
static double moved_from(const Program *p, const double *poses, const double *z, const double *poses_before,
                         const double *lengths_before)
{
    double turned = 0.0, stretched = 0.0;
    for (int64_t i = 0; i < p->n.nodes; i++)
        turned = most(turned, fabs(poses[3 * i + 2] - poses_before[3 * i + 2]));
    for (int64_t m = 0; m < p->n.gears; m++)
        stretched = most(stretched, fabs(z[p->n.knots + m] - lengths_before[m]));
    return most(turned, stretched);
}

/* The array of an iterate, see `Iterate.values`. */
typedef struct {
    double *z, *rollout, *error, *zones; /* (size,), see `Rollout.packed`, (3,), (zones,) */
    double *cost, *shortfall, *short_of, *missed, *off, *moved; /* one number each */
    double *required, *slope, *table; /* requirement (nodes,), its gradient (nodes, 2); see `Clearance.table` */
} Values;

static Values values_of(const Program *p, double *values)
{
    double *error = values + p->size + 4 * p->n.nodes + 6 * p->n.intervals, *found = error + 3 + p->n.zones;
    double *required = found + 6;
    return (Values){values,    values + p->size, error,     error + 3, found,    found + 1,
                    found + 2, found + 3,        found + 4, found + 5, required, required + p->n.nodes,
                    required + 4 * p->n.nodes};
}

/* Evaluate variables, as the function `evaluated`.
 *
 *   has_before   whether the change is measured
 *   counts, numbers   see `PackedProgram`; basis, scene: `Basis.packed` and `Scene.packed`
 *   given        variables (size,)
 *   before       array of the iterate before, see `Iterate.values`, if there is one
 *   pairs        out, see `optdock_clearance_along`
 *   out          out, see `Iterate.values`
 *   work         12 size + gears + 6 + 4 nodes + 6 intervals, or those of `optdock_clearance_along` if more
 *   indices      work, see `optdock_clearance_along`
 *
 * Return the number of pairs. */
int64_t optdock_evaluate(int64_t has_before, const int64_t *counts, const double *numbers, const double *basis,
                         const double *scene, const double *given, const double *before, int64_t *pairs, double *out,
                         double *work, int64_t *indices)
{
    Program p = program_of(counts, numbers);
    Values to = values_of(&p, out);
    int64_t size = p.size, nodes = p.n.nodes, length = 4 * nodes + 6 * p.n.intervals, bounds = 4 * size + p.n.gears + 6;
    double *found = work + size + bounds, reach = p.is.reach;
    copy(work, given, size);
    copy(work + size, p.ends, bounds);
    optdock_project_and_roll_out(p.n.gears, p.n.knots, nodes, p.n.intervals, p.n.most_steps, p.n.alternations,
                                 p.is.tolerance, p.is.renew, p.is.contraction, p.is.goal_reach, p.is.rate,
                                 p.is.inner_rate, basis, p.divisions, work, found);
    copy(to.rollout, found, length);
    copy(to.z, found + length, size);
    *to.moved = 0.0;
    if (has_before) {
        *to.moved = moved_from(&p, to.rollout, to.z, before + size, before + p.n.knots);
        reach = least(p.is.most_reach, p.is.reach_per_motion * *to.moved + p.is.least_reach);
    }
    int64_t count = optdock_clearance_along(p.n.parts, p.n.v, p.n.obstacles, p.n.k, nodes, p.n.intervals, p.n.few,
                                            p.n.nearest, p.n.nearest_close, p.n.together, p.n.lowest_vertices,
                                            p.n.facing_edges, p.is.radius, reach + p.is.required, p.is.close,
                                            p.is.lowest_slope, scene, to.rollout, p.signs, p.left, pairs, to.required,
                                            work, indices);
    const double *margin = to.table + (6 * p.n.v + 2 * p.n.k + 3) * count;
    const int64_t *interval = pairs + nodes;
    for (int64_t i = 0; i < p.n.zones; i++)
        to.zones[i] = 0.0;
    for (int64_t i = 0; i < count; i++) {
        double *zone = to.zones + zone_of(&p, p.left[interval[i]]);
        int is_end = interval[i] == 0 || interval[i] == p.n.intervals - 1;
        *zone = most(*zone, (is_end ? -p.is.end_allowance : 0.0) - margin[i]);
    }
    *to.shortfall = *to.off = *to.missed = 0.0;
    for (int64_t i = 0; i < p.n.zones; i++)
        *to.shortfall = most(*to.shortfall, to.zones[i]);
    for (int64_t i = 0; i < 3; i++) {
        to.error[i] = to.rollout[3 * (nodes - 1) + i] - p.target[i];
        *to.missed += fabs(to.error[i]);
        *to.off = most(*to.off, fabs(to.error[i]));
    }
    *to.cost = cost_of(&p, to.z, to.rollout);
    *to.short_of = sum_of(to.zones, p.n.zones);
    if (p.n.has_terms)
        optdock_term_points(p.n.gears, nodes, p.is.before, p.is.after, p.divisions, to.z + p.n.knots, p.signs,
                            to.rollout, to.table + (6 * p.n.v + 2 * p.n.k + 4) * count);
    return count;
}

/* ---- Linearization ---- */

/* The iterate, see `Iterate`. */
typedef struct {
    const double *z, *rollout, *required, *slope; /* slope: gradient of the requirement, (nodes, 2) */
    int64_t p;                                            /* number of pairs */
    const int64_t *interval, *part, *obstacle;            /* (p,) */
    const double *table, *margin;                         /* margin: (p,), the last row of the table */
} Iterate;

/* Derivatives of the poses, (nodes, size) each. */
typedef struct {
    const double *x, *y, *yaw;
} Sensitivity;

/* Derivatives at a node: of x and y, of the yaw times the root of its weight, and of the lateral motion. */
typedef struct {
    const double *x, *y, *yaw, *across;
} NodeRows;

/* Add the products of a node's derivatives in row i and the columns first to end - 1. */
static void add_products(const NodeRows *at, int64_t size, int64_t i, int64_t first, int64_t end, double *motion,
                         double *lateral)
{
    double x = at->x[i], y = at->y[i], yaw = at->yaw[i], across = at->across[i];
    for (int64_t j = first; j < end; j++) {
        motion[i * size + j] += x * at->x[j] + y * at->y[j] + yaw * at->yaw[j];
        lateral[i * size + j] += across * at->across[j];
    }
}

/* Sums over the nodes: lower triangles of squared motion and squared lateral motion, (size, size) each, and the gradient
 * of the squared laterals times `scale`. Of a node's derivatives, those by later knots and gears are 0. rows: work,
 * (2, size). */
static void sum_over_nodes(const Program *p, const Sensitivity *by, const double *poses, double scale, double *motion,
                           double *squares, double *gradient, double *rows)
{
    int64_t size = p->size;
    double *across = rows, *turned = rows + size, weight = sqrt(p->is.yaw_motion);
    for (int64_t j = 0; j < size; j++)
        gradient[j] = 0.0;
    for (int64_t j = 0; j < size * size; j++)
        motion[j] = squares[j] = 0.0;
    for (int64_t m = 0, node = 0, first = 0; m < p->n.gears; m++) {
        int64_t spans = p->divisions[2 * m], cells = p->divisions[2 * m + 1];
        for (int64_t i = 0; i <= cells; i++, node++) {
            const double *normal = p->normals + 2 * node;
            NodeRows at = {by->x + node * size, by->y + node * size, turned, across};
            int64_t knots = first + (i < cells ? i * spans / cells : spans - 1) + 2;
            double away = scale * lateral(p, poses, node);
            for (int64_t j = 0; j < size; j++) {
                across[j] = normal[0] * at.x[j] + normal[1] * at.y[j];
                turned[j] = weight * by->yaw[node * size + j];
                gradient[j] += away * across[j];
            }
            for (int64_t row = 0; row < knots; row++)
                add_products(&at, size, row, 0, row + 1, motion, squares);
            for (int64_t row = p->n.knots; row <= p->n.knots + m; row++) {
                add_products(&at, size, row, 0, knots, motion, squares);
                add_products(&at, size, row, p->n.knots, row + 1, motion, squares);
            }
        }
        first += spans + 1;
    }
}

/* The functions `squared_motion` and `CostModel.quadratic`. out: gradient (size,), Hessian and motion (size, size).
 * work: (2, size). */
static void quadratic_model(const Program *p, const Iterate *at, const Sensitivity *by, double *out, double *work)
{
    int64_t size = p->size, knots = p->n.knots, square = size * size;
    double *gradient = out, *hessian = gradient + size, *motion = hessian + square;
    const double *z = at->z;
    double total = sum_of(z + knots, p->n.gears), share = total / (double)p->n.intervals;
    double tracking = p->is.tracking / (double)p->n.intervals, scale = 2.0 * tracking * total;
    double tracked = tracking * squared_laterals(p, at->rollout);
    sum_over_nodes(p, by, at->rollout, scale, motion, hessian, gradient, work);
    for (int64_t i = 0; i < size; i++) {
        for (int64_t j = 0; j <= i; j++) {
            int64_t e = i * size + j;
            motion[e] = motion[j * size + i] = share * motion[e];
            hessian[e] = hessian[j * size + i] = scale * hessian[e];
        }
    }
    for (int64_t m = 0, j = 0; m < p->n.gears; m++) {
        double length = z[knots + m], bends = 0.0, jerks = 0.0;
        for (int64_t end = j + p->divisions[2 * m]; j <= end; j++) {
            double by_bend = banded(p, p->bend, j, z), by_jerk = banded(p, p->jerk, j, z);
            gradient[j] += length * by_bend + by_jerk / length + banded(p, p->turning, j, z);
            bends += 0.5 * (z[j] * by_bend);
            jerks += 0.5 * (z[j] * by_jerk);
            for (int64_t i = j > 0 ? j - 1 : 0; i < knots && i <= j + 1; i++) {
                int64_t e = i * knots + j;
                hessian[i * size + j] += length * p->bend[e] + p->jerk[e] / length + p->turning[e];
            }
        }
        gradient[knots + m] += p->is.length + bends - jerks / (length * length) + tracked;
        hessian[(knots + m) * (size + 1)] += 2.0 * jerks / (length * length * length);
    }
}

/* The element of index `rank` in ascending order. values: changed. */
static double select(double *values, int64_t count, int64_t rank)
{
    for (int64_t low = 0, high = count - 1; low < high;) {
        double pivot = values[rank];
        int64_t i = low, j = high;
        while (i <= j) {
            while (values[i] < pivot)
                i++;
            while (pivot < values[j])
                j--;
            if (i <= j) {
                double swapped = values[i];
                values[i++] = values[j];
                values[j--] = swapped;
            }
        }
        if (j < rank)
            low = i;
        if (rank < i)
            high = j;
    }
    return values[rank];
}

/* Keep the indices of the `limit` smallest values, of equal ones the first. work: (count,). Return their number. */
static int64_t keep_smallest(const double *values, int64_t *index, int64_t count, int64_t limit, double *work)
{
    int64_t kept = 0, below = 0;
    if (count <= limit)
        return count;
    for (int64_t i = 0; i < count; i++)
        work[i] = values[index[i]];
    double last = select(work, count, limit - 1);
    for (int64_t i = 0; i < count; i++)
        below += values[index[i]] < last;
    for (int64_t i = 0, equal = limit - below; i < count; i++)
        if (values[index[i]] < last || (values[index[i]] == last && equal-- > 0))
            index[kept++] = index[i];
    return kept;
}

/* The function `active_pairs`: write the columns of pairs with planes and set is_deep (p,) for those with discs.
 * latest: work, (parts obstacles,); work: (p,). Return the number of planes. */
static int64_t choose_pairs(const Program *p, const Iterate *at, int64_t *planes, int64_t *is_deep, int64_t *is_lowest,
                            int64_t *latest, double *work)
{
    double worst = INFINITY, deep = -INFINITY;
    int64_t shallow = 0, count = 0, limit = p->n.few_planes > p->n.intervals ? p->n.few_planes : p->n.intervals;
    limit = limit < p->n.most / 3 ? limit : p->n.most / 3;
    for (int64_t i = 0; i < at->p; i++)
        worst = least(worst, at->margin[i]);
    if (!(worst >= -p->is.deep * p->is.width))
        deep = (worst >= -p->is.very_deep ? -p->is.deep : p->is.near_deep) * p->is.width;
    for (int64_t i = 0; i < at->p; i++) {
        is_deep[i] = at->margin[i] < deep;
        shallow += !is_deep[i];
    }
    int is_thinned = p->n.thins && worst < -p->is.clear && shallow > limit;
    for (int64_t i = 0; is_thinned && i < p->n.parts * p->n.obstacles; i++)
        latest[i] = -1;
    for (int64_t i = 0; is_thinned && i < at->p; i++) { /* intervals of a part and an obstacle are in ascending order */
        int64_t *before = latest + at->part[i] * p->n.obstacles + at->obstacle[i];
        is_lowest[i] = 1;
        if (*before >= 0 && at->interval[*before] + 1 == at->interval[i]) {
            is_lowest[*before] &= at->margin[*before] <= at->margin[i];
            is_lowest[i] = at->margin[i] <= at->margin[*before];
        }
        *before = i;
    }
    for (int64_t i = 0; i < at->p; i++)
        if (!is_deep[i] && !(is_thinned && p->is_small[at->obstacle[i]] && !is_lowest[i]))
            planes[count++] = i;
    return keep_smallest(at->margin, planes, count, limit, work);
}

/* Signed distance of a point to an obstacle and its gradient, as the function `_signed_distance`. */
static double signed_distance(const double point[2], const double *outline, const double *edges, int64_t k,
                              double gradient[2])
{
    double nearest = INFINITY, deepest = -INFINITY, toward[2] = {0.0, 0.0};
    int64_t side = 0;
    for (int64_t i = 0; i < k; i++) {
        const double *a = outline + 2 * i, *b = outline + 2 * (i + 1 < k ? i + 1 : 0), *normal = edges + 2 * i;
        double edge[2] = {b[0] - a[0], b[1] - a[1]}, away[2] = {point[0] - a[0], point[1] - a[1]};
        double along = (away[0] * edge[0] + away[1] * edge[1]) / most(edge[0] * edge[0] + edge[1] * edge[1], 1e-18);
        along = least(most(along, 0.0), 1.0);
        double rest[2] = {away[0] - along * edge[0], away[1] - along * edge[1]}, length = hypot(rest[0], rest[1]);
        double depth = away[0] * normal[0] + away[1] * normal[1];
        if (length < nearest) {
            nearest = length;
            toward[0] = rest[0];
            toward[1] = rest[1];
        }
        if (depth > deepest) {
            deepest = depth;
            side = i;
        }
    }
    for (int i = 0; i < 2; i++)
        gradient[i] = deepest < 0.0 ? edges[2 * side + i] : toward[i] / most(nearest, 1e-9);
    return deepest < 0.0 ? deepest : nearest;
}

/* Rows of clearance: gradients (count, size), gaps (count,) and nodes (count,). */
typedef struct {
    double *gradient, *gap;
    int64_t *node, count;
} Rows;

/* Append the rows of the deepest discs of a part at a node, as the function `_part_rows`. distance: work, (discs,);
 * gradients: work, (discs, 2). */
static void add_discs(const Program *p, const Iterate *at, const Sensitivity *by, const double *outlines, int64_t part,
                      int64_t node, int64_t obstacle, double *distance, double *gradients, Rows *rows)
{
    const double *outline = outlines + 2 * p->n.k * obstacle, *pose = at->rollout + 3 * node;
    const double *edges = outlines + 2 * p->n.k * (p->n.obstacles + obstacle);
    const double *centres = p->disc_centres + 2 * p->n.discs * part;
    double c = cos(pose[2]), s = sin(pose[2]);
    for (int64_t i = 0; i < p->discs[part]; i++) {
        double x = c * centres[2 * i] - s * centres[2 * i + 1], y = s * centres[2 * i] + c * centres[2 * i + 1];
        double point[2] = {pose[0] + x, pose[1] + y};
        distance[i] = signed_distance(point, outline, edges, p->n.k, gradients + 2 * i);
    }
    for (int64_t found = 0; found < p->n.discs_per_node && found < p->discs[part]; found++, rows->count++) {
        int64_t disc = 0;
        for (int64_t i = 1; i < p->discs[part]; i++)
            if (distance[i] < distance[disc])
                disc = i;
        double x = c * centres[2 * disc] - s * centres[2 * disc + 1];
        double y = s * centres[2 * disc] + c * centres[2 * disc + 1];
        double along_x = gradients[2 * disc], along_y = gradients[2 * disc + 1], turn = along_y * x - along_x * y;
        double *row = rows->gradient + rows->count * p->size;
        for (int64_t j = 0; j < p->size; j++) {
            int64_t e = node * p->size + j;
            row[j] = along_x * by->x[e] + along_y * by->y[e] + turn * by->yaw[e];
        }
        rows->gap[rows->count] = distance[disc] - p->disc_radius[part] - at->required[node];
        rows->node[rows->count] = node;
        distance[disc] = INFINITY;
    }
}

/* Append the rows of all deep pairs. is_met: work, (nodes obstacles,). */
static void add_deep(const Program *p, const Iterate *at, const Sensitivity *by, const double *outlines,
                     const int64_t *is_deep, int64_t *is_met, double *work, Rows *rows)
{
    for (int64_t part = 0; part < p->n.parts; part++) {
        for (int64_t i = 0; i < p->n.nodes * p->n.obstacles; i++)
            is_met[i] = 0;
        for (int64_t i = 0; i < at->p; i++) {
            int64_t *met = is_met + p->left[at->interval[i]] * p->n.obstacles + at->obstacle[i];
            if (is_deep[i] && at->part[i] == part)
                met[0] = met[p->n.obstacles] = 1;
        }
        for (int64_t i = 0; i < p->n.nodes * p->n.obstacles; i++)
            if (is_met[i])
                add_discs(p, at, by, outlines, part, i / p->n.obstacles, i % p->n.obstacles, work,
                          work + p->n.discs, rows);
    }
}

/* Whether a row depends on more than the given start pose. */
static int can_change(const Rows *rows, int64_t row, int64_t size)
{
    double largest = 0.0;
    for (int64_t j = 0; rows->node[row] == 0 && j < size; j++)
        largest = most(largest, fabs(rows->gradient[row * size + j]));
    return rows->node[row] > 0 || largest >= 1e-9;
}

/* The buffer at a node, which vanishes at the ends, where the pose cannot move. */
static double buffer_at(const Program *p, const double *pose, double buffer)
{
    double from_start = hypot(pose[0] - p->start[0], pose[1] - p->start[1]);
    double to_target = hypot(pose[0] - p->target[0], pose[1] - p->target[1]);
    return buffer * least(1.0, least(from_start, to_target) / p->is.taper);
}

/* Write the rows of the active pairs to `out`, each a gap and a gradient, (rows, 1 + size), and their nodes. Return their
 * number. ints, work: see `optdock_linearize`. */
static int64_t clearance_rows(const Program *p, const Iterate *at, const Sensitivity *by, double buffer,
                              const double *scene, int64_t *node, double *out, int64_t *ints, double *work)
{
    int64_t size = p->size, pairs = at->p, room = (3 + 2 * p->n.discs_per_node) * pairs, count = 0;
    int64_t *planes = ints, *is_deep = planes + pairs, *is_lowest = is_deep + pairs, *latest = is_lowest + pairs;
    int64_t *is_met = latest + p->n.parts * p->n.obstacles, *kept = is_met + p->n.nodes * p->n.obstacles;
    double *chosen_from = work, *of_discs = work + room, *next = of_discs + 3 * p->n.discs;
    Rows rows = {next + room, next, kept + room, 0};
    int64_t chosen = choose_pairs(p, at, planes, is_deep, is_lowest, latest, chosen_from);
    rows.count = optdock_separating_plane_rows(pairs, chosen, 2 * p->n.v, p->n.k, p->n.nodes, p->n.intervals, size,
                                               p->n.lowest_vertices, p->is.support_slope, p->is.same_witness,
                                               p->is.lowest_slope, planes, at->interval, p->left, at->table,
                                               at->rollout, at->slope, by->x, by->y, by->yaw, rows.node, rows.gradient);
    copy(rows.gap, rows.gradient + 3 * chosen * size, rows.count);
    add_deep(p, at, by, scene + p->n.parts * (5 * p->n.v + 4), is_deep, is_met, of_discs, &rows);
    for (int64_t i = 0; i < rows.count; i++)
        if (can_change(&rows, i, size))
            kept[count++] = i;
    count = keep_smallest(rows.gap, kept, count, p->n.most, chosen_from);
    for (int64_t i = 0; i < count; i++) {
        node[i] = rows.node[kept[i]];
        out[i * (1 + size)] = rows.gap[kept[i]] - buffer_at(p, at->rollout + 3 * node[i], buffer);
        copy(out + i * (1 + size) + 1, rows.gradient + kept[i] * size, size);
    }
    return count;
}

/* The array of a linearization, see `Linearization.values`. */
typedef struct {
    double *z, *error, *gradient, *hessian, *motion, *jacobian, *headings, *rows;
} Model;

static Model model_of(const Program *p, double *values)
{
    int64_t size = p->size;
    double *gradient = values + size + 3, *motion = gradient + size + size * size, *jacobian = motion + size * size;
    double *headings = jacobian + 3 * size;
    return (Model){values, values + size, gradient, gradient + size,
                   motion, jacobian,      headings, headings + p->n.trusted * size};
}

/* Linearize at an iterate, as the function `linearized`.
 *
 *   count        number of pairs p
 *   buffer       clearance [m] above the requirement
 *   counts, numbers   see `PackedProgram`; basis, scene: `Basis.packed` and `Scene.packed`
 *   values       array of the iterate, see `Iterate.values`
 *   pairs        see `optdock_clearance_along`
 *   node         out, (most,), nodes of the rows
 *   out          out, see `Linearization.values`, with space for all rows, at most `most`
 *   ints         work: 3 p + (parts + nodes) obstacles + 2 room + 12 p, room = (3 + 2 discs_per_node) p
 *   work         3 nodes size + 4 size + room (size + 2) + 3 discs + 9 p + 4 (2 v + k)
 *
 * Return the number of rows. */
int64_t optdock_linearize(int64_t count, double buffer, const int64_t *counts, const double *numbers,
                          const double *basis, const double *scene, double *values, const int64_t *pairs,
                          int64_t *node, double *out, int64_t *ints, double *work)
{
    Program p = program_of(counts, numbers);
    Values from = values_of(&p, values);
    Model to = model_of(&p, out);
    int64_t size = p.size, nodes = p.n.nodes, last = (nodes - 1) * size;
    const int64_t *interval = pairs + nodes;
    Iterate at = {from.z, from.rollout, from.required, from.slope, count, interval, interval + count,
                  interval + 2 * count, from.table, from.table + (6 * p.n.v + 2 * p.n.k + 3) * count};
    const Sensitivity by = {work, work + nodes * size, work + 2 * nodes * size};
    double *next = work + 3 * nodes * size;
    optdock_sensitivity(p.n.gears, p.n.knots, nodes, p.n.intervals, basis, p.divisions, from.z,
                        from.rollout + 4 * nodes + 2 * p.n.intervals, work, next);
    copy(to.z, from.z, size);
    copy(to.error, from.error, 3);
    quadratic_model(&p, &at, &by, to.gradient, next);
    copy(to.jacobian, by.x + last, size);
    copy(to.jacobian + size, by.y + last, size);
    copy(to.jacobian + 2 * size, by.yaw + last, size);
    for (int64_t i = 0; i < p.n.trusted; i++)
        copy(to.headings + i * size, by.yaw + p.trusted[i] * size, size);
    return clearance_rows(&p, &at, &by, buffer, scene, node, to.rows, ints, next);
}

/* ---- Step ---- */

/* Trust region [rad], largest change of a length [m], weight of the squared motion, and penalties. */
typedef struct {
    double trust, stretch, proximal, of_clearance, of_goal, unbounded;
} Bounds;

/* A quadratic program of n variables and m rows, see `optdock_minimizer`. */
typedef struct {
    int64_t n, m;
    double *h, *g, *a, *lower, *upper;
} Quadratic;

/* Append a row with bounds, and return its elements, of which the first `count` are given and the others 0. */
static double *append_row(Quadratic *q, const double *elements, int64_t count, double lower, double upper)
{
    double *row = q->a + q->m * q->n;
    copy(row, elements, count);
    q->lower[q->n + q->m] = lower;
    q->upper[q->n + q->m++] = upper;
    return row;
}

static void fill_cost_and_box(const Program *p, const Model *at, Bounds within, Quadratic *q)
{
    int64_t size = p->size;
    for (int64_t i = 0; i < size; i++) {
        double lower = p->inner_lower[i] - at->z[i], upper = p->inner_upper[i] - at->z[i];
        for (int64_t j = 0; j < size; j++)
            q->h[i * q->n + j] = at->hessian[i * size + j] + within.proximal * at->motion[i * size + j];
        q->h[i * (q->n + 1)] += p->is.ridge;
        q->g[i] = at->gradient[i];
        if (i >= p->n.knots) {
            lower = most(lower, -within.stretch);
            upper = least(upper, within.stretch);
        }
        q->lower[i] = least(lower, upper);
        q->upper[i] = most(lower, upper);
    }
    for (int64_t i = size; i < q->n; i++) {
        int is_goal = i < size + 6;
        q->h[i * (q->n + 1)] = is_goal ? p->is.curved_goal : p->is.curved_clearance;
        q->g[i] = is_goal ? within.of_goal : within.of_clearance;
        q->lower[i] = 0.0;
        q->upper[i] = within.unbounded;
    }
}

/* Append the rows of the curvature rate, or those of its negative. */
static void append_rates(const Program *p, const Model *at, double sign, double unbounded, Quadratic *q)
{
    for (int64_t m = 0, knot = 0; m < p->n.gears; m++, knot++) {
        double spans = (double)p->divisions[2 * m], allowed = p->is.inner_rate * at->z[p->n.knots + m];
        for (int64_t end = knot + p->divisions[2 * m]; knot < end; knot++) {
            double slope = spans * (at->z[knot + 1] - at->z[knot]);
            double *row = append_row(q, at->headings, 0, -unbounded, sign > 0.0 ? allowed - slope : allowed + slope);
            row[knot] = -sign * spans;
            row[knot + 1] = sign * spans;
            row[p->n.knots + m] = -p->is.inner_rate;
        }
    }
}

static void fill(const Program *p, const Model *at, int64_t rows, const int64_t *node, Bounds within, Quadratic *q)
{
    fill_cost_and_box(p, at, within, q);
    for (int64_t i = 0; i < 3; i++) {
        double *row = append_row(q, at->jacobian + i * p->size, p->size, -at->error[i], -at->error[i]);
        row[p->size + i] = 1.0;
        row[p->size + 3 + i] = -1.0;
    }
    for (int64_t i = 0; i < p->n.trusted; i++)
        append_row(q, at->headings + i * p->size, p->size, -within.trust, within.trust);
    if (p->n.is_limited) {
        append_rates(p, at, 1.0, within.unbounded, q);
        append_rates(p, at, -1.0, within.unbounded, q);
    }
    for (int64_t i = 0; i < rows; i++) {
        const double *row = at->rows + i * (1 + p->size);
        append_row(q, row + 1, p->size, -row[0], within.unbounded)[p->size + 6 + zone_of(p, node[i])] = 1.0;
    }
}

/* Solve the program of a step, as the function `solve_step`.
 *
 *   rows         number of rows of clearance
 *   guessed, last, rounds   number of guessed constraints, of which those after `last` are left out, and of rounds
 *   trust ... of_goal       see `Bounds`
 *   unbounded, tolerance, attained   see `optdock_minimizer`
 *   counts, numbers   see `PackedProgram`
 *   values, node   see `Linearization`
 *   guess        (guessed,)
 *   ints         out and work: attained constraints, see `optdock_minimizer`, 5 n + 6 m + 1, then guessed
 *   doubles      out and work: change of the variables (size,), predicted gain of the cost, and work of
 *                `optdock_minimizer`, (n + 1) (2 n + 7) + 16 n + 2 m + 9 n^2 in all, then n^2 + n + m n + 2 (n + m)
 *
 * n = size + 6 + zones; m = 3 + trusted + 2 (knots - gears, or 0 for an unlimited rate) + rows. Return the number of
 * attained constraints, or -1 if no minimizer is found. */
int64_t optdock_step(int64_t rows, int64_t guessed, int64_t last, int64_t rounds, double trust, double stretch,
                     double proximal, double of_clearance, double of_goal, double unbounded, double tolerance,
                     double attained, const int64_t *counts, const double *numbers, double *values,
                     const int64_t *node, const int64_t *guess, int64_t *ints, double *doubles)
{
    Program p = program_of(counts, numbers);
    Model at = model_of(&p, values);
    int64_t rates = p.n.is_limited ? p.n.knots - p.n.gears : 0, kept = 0;
    int64_t n = p.size + 6 + p.n.zones, m = 3 + p.n.trusted + 2 * rates + rows;
    int64_t *guesses = ints + 5 * n + 6 * m + 1;
    double *h = doubles + (n + 1) * (2 * n + 7) + 16 * n + 2 * m + 9 * n * n;
    Quadratic q = {n, 0, h, h + n * n, h + n * n + n, h + n * n + n + m * n, h + n * n + n + m * n + n + m};
    for (int64_t i = 0; i < n * n + n + m * n; i++)
        h[i] = 0.0;
    fill(&p, &at, rows, node, (Bounds){trust, stretch, proximal, of_clearance, of_goal, unbounded}, &q);
    for (int64_t i = 0; i < n + m; i++)
        if (!(q.lower[i] <= q.upper[i]))
            return -1;
    for (int64_t i = 0; i < guessed; i++)
        if (guess[i] <= last && -guess[i] <= last)
            guesses[kept++] = guess[i];
    int64_t found = optdock_minimizer(n, m, p.n.knots, kept, rounds, unbounded, tolerance, attained, h, q.g, q.a,
                                      q.lower, guesses, ints, doubles);
    double model = 0.0;
    for (int64_t i = 0; i < n; i++)
        if (!isfinite(doubles[i]))
            found = -1;
    if (found < 0)
        return -1;
    for (int64_t i = 0; i < p.size; i++)
        model += doubles[i] * dot(at.hessian + i * p.size, doubles, p.size);
    doubles[p.size] = -(dot(at.gradient, doubles, p.size) + 0.5 * model);
    return found;
}

/* Add costs and rows to a linearization with `count` rows, of which the `most` with the smallest gaps remain.
 *
 *   costs        gradient and Hessian, (size + size^2,), if has_costs
 *   nodes, rows  nodes, (more,), and gap and gradient of each row, (more, 1 + size)
 *   node         nodes of all rows, with space for count + more
 *   ints, work   work: count + more, and twice as many
 *
 * Return the number of rows. */
static int64_t add(const Program *p, int64_t count, int64_t has_costs, const double *costs, int64_t more,
                   const int64_t *nodes, const double *rows, int64_t *node, Model *to, int64_t *ints, double *work)
{
    int64_t width = 1 + p->size, all = count + more;
    for (int64_t i = 0; has_costs && i < p->size * width; i++)
        to->gradient[i] += costs[i];
    if (more == 0)
        return count;
    for (int64_t i = 0; i < more; i++)
        node[count + i] = nodes[i];
    copy(to->rows + count * width, rows, more * width);
    for (int64_t i = 0; i < all; i++) {
        ints[i] = i;
        work[i] = to->rows[i * width];
    }
    count = keep_smallest(work, ints, all, p->n.most, work + all);
    for (int64_t i = 0; i < count; i++) {
        node[i] = node[ints[i]];
        if (ints[i] != i)
            copy(to->rows + i * width, to->rows + ints[i] * width, width);
    }
    return count;
}

/* Linearize at an iterate and solve the program of a step, as the function `linearized_step`.
 *
 *   pairs, guessed ... guess   see `optdock_linearize` and `optdock_step`
 *   costs, more ... more_rows  what the required view and terms add, see `add`
 *   node         out, (most + more + 1,), nodes of the rows; the last element is the number of rows
 *   model        out, see `Linearization.values`, with space for all rows, those that are added and at most `most`
 *   ints, doubles   out and work, see `optdock_step` for `most` rows; at least as large as those of `optdock_linearize`
 *                   and `add`
 *
 * Return the result of `optdock_step`. */
int64_t optdock_linearized_step(int64_t pairs, int64_t has_costs, int64_t more, int64_t guessed, int64_t last,
                                int64_t rounds, double buffer, double trust, double stretch, double proximal,
                                double of_clearance, double of_goal, double unbounded, double tolerance,
                                double attained, const int64_t *counts, const double *numbers, const double *basis,
                                const double *scene, double *values, const int64_t *near, const double *costs,
                                const int64_t *more_nodes, const double *more_rows, const int64_t *guess,
                                int64_t *node, double *model, int64_t *ints, double *doubles)
{
    Program p = program_of(counts, numbers);
    Model to = model_of(&p, model);
    int64_t rows = optdock_linearize(pairs, buffer, counts, numbers, basis, scene, values, near, node, model, ints,
                                     doubles);
    rows = add(&p, rows, has_costs, costs, more, more_nodes, more_rows, node, &to, ints, doubles);
    node[p.n.most + more] = rows;
    return optdock_step(rows, guessed, last, rounds, trust, stretch, proximal, of_clearance, of_goal, unbounded,
                        tolerance, attained, counts, numbers, model, node, guess, ints, doubles);
}
