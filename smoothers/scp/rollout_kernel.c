/* The roll-out of the smoother, its sensitivity and the goal projection: the functions `roll_out` and `sensitivity` of
 * `rollout.py`, and `onto_goal` and `project_and_roll_out` of `goal_projection.py` in C.
 *
 * Equation numbers are those of docs/theory/smoother.md. Sums and products are evaluated in the order of the twins, with
 * the sines and cosines of the C library; where NumPy uses the same, results are equal to the last bit. A search for a
 * path uses them; the certificate does not. */

#include <math.h>
#include <stdint.h>

typedef struct {
    double x, y;
} Vector;

/* Numbers of gears, knots, nodes and intervals, and arrays that depend only on these numbers, see `Basis`. */
typedef struct {
    int64_t gears, knots, nodes, intervals, size; /* size: knots and gears */
    const int64_t *divisions;                     /* (gears, 2), spans and intervals of each gear */
    const double *gauss;                          /* (2 intervals, knots), headings at the Gauss points */
    const double *headings, *hats;                /* (nodes, knots), headings and curvatures at the nodes */
} Basis;

static Basis basis_of(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals, const double *packed,
                      const int64_t *divisions)
{
    const double *headings = packed + 2 * intervals * knots;
    return (Basis){gears, knots, nodes, intervals, knots + gears, divisions, packed, headings, headings + nodes * knots};
}

/* Sum of products, in the order of the index. */
static double dot(const double *a, const double *b, int64_t count)
{
    double sum = a[0] * b[0];
    for (int64_t i = 1; i < count; i++)
        sum += a[i] * b[i];
    return sum;
}

/* A sum of products of a row of heading integrals in the order of the index. The integrals of hats before the knot
 * `count` have their last values, so the part of the sum up to there is the same for all later rows. */
typedef struct {
    int64_t count;
    double sum;
} Passed;

/* Sum of products of a row up to the hats of the span that begins at `knot`; the integrals of later hats are 0. */
static double row_sum(Passed *passed, const double *row, const double *factors, int64_t knot)
{
    for (; passed->count < knot; passed->count++)
        passed->sum += row[passed->count] * factors[passed->count];
    return passed->sum + row[knot] * factors[knot] + row[knot + 1] * factors[knot + 1];
}

/* ---- Roll-out ---- */

/* Curvatures of the variables z times the lengths of their gears. */
static void turn(const Basis *b, const double *z, double *turned)
{
    for (int64_t m = 0, j = 0; m < b->gears; m++)
        for (int64_t end = j + b->divisions[2 * m]; j <= end; j++)
            turned[j] = z[b->knots + m] * z[j];
}

/* Displacements (S4) by the Gauss points, with the headings (S3). */
static void displace(const Basis *b, const double *z, const double *turned, const double *start, const double *signs,
                     Vector *moves)
{
    Passed passed = {0, 0.0};
    for (int64_t m = 0, i = 0, knot = 0; m < b->gears; m++) {
        int64_t spans = b->divisions[2 * m], cells = b->divisions[2 * m + 1];
        double weight = 0.5 / (double)cells * (z[b->knots + m] * signs[m]);
        for (int64_t cell = 0; cell < cells; cell++) {
            for (int64_t end = i + 2; i < end; i++) {
                double yaw = start[2] + row_sum(&passed, b->gauss + i * b->knots, turned, knot + cell * spans / cells);
                moves[i] = (Vector){weight * cos(yaw), weight * sin(yaw)};
            }
        }
        knot += spans + 1;
    }
}

/* The last pose and the displacements that lead to it. turned: work, (knots,). */
static void end_pose(const Basis *b, const double *z, const double *start, const double *signs, double *turned,
                     Vector *moves, double pose[3])
{
    turn(b, z, turned);
    displace(b, z, turned, start, signs, moves);
    pose[0] = start[0];
    pose[1] = start[1];
    for (int64_t k = 0; k < b->intervals; k++) {
        pose[0] += moves[2 * k].x + moves[2 * k + 1].x;
        pose[1] += moves[2 * k].y + moves[2 * k + 1].y;
    }
    pose[2] = start[2] + dot(b->headings + (b->nodes - 1) * b->knots, turned, b->knots);
}

/* The roll-out, in the order of `Rollout.packed`. is_displaced: whether its moves and `turned` are given.
 * turned: work, (knots,). */
static void roll_out(const Basis *b, const double *z, const double *start, const double *signs, int is_displaced,
                     double *packed, double *turned)
{
    double *poses = packed, *kappa = poses + 3 * b->nodes, *rate = kappa + b->nodes, *steps = rate + b->intervals;
    Vector *moves = (Vector *)(steps + b->intervals), place = {start[0], start[1]};
    Passed passed = {0, 0.0};
    if (!is_displaced) {
        turn(b, z, turned);
        displace(b, z, turned, start, signs, moves);
    }
    for (int64_t m = 0, node = 0, interval = 0, first = 0; m < b->gears; m++) {
        int64_t spans = b->divisions[2 * m], cells = b->divisions[2 * m + 1];
        double length = z[b->knots + m];
        for (int64_t i = 0; i <= cells; i++, node++) {
            int64_t knot = first + (i < cells ? i * spans / cells : spans - 1);
            poses[3 * node] = place.x;
            poses[3 * node + 1] = place.y;
            poses[3 * node + 2] = start[2] + row_sum(&passed, b->headings + node * b->knots, turned, knot);
            kappa[node] = dot(b->hats + node * b->knots + knot, z + knot, 2) + 0.0; /* no negative zeros */
            if (i == cells)
                continue;
            rate[interval] = (double)spans * (z[knot + 1] - z[knot]) / length;
            steps[interval] = length / (double)cells;
            place.x += moves[2 * interval].x + moves[2 * interval + 1].x;
            place.y += moves[2 * interval].y + moves[2 * interval + 1].y;
            interval++;
        }
        first += spans + 1;
    }
}

/* Compute a roll-out.
 *
 *   gears, knots, nodes, intervals, packed, divisions   see `Basis`
 *   given    curvatures and lengths (knots + gears,), start pose (3,), signs (gears,)
 *   out      out, (4 nodes + 6 intervals,), see `Rollout.packed`
 *   work     (knots,) */
int64_t optdock_roll_out(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals, const double *packed,
                         const int64_t *divisions, const double *given, double *out, double *work)
{
    Basis b = basis_of(gears, knots, nodes, intervals, packed, divisions);
    roll_out(&b, given, given + b.size, given + b.size + 3, 0, out, work);
    return 0;
}

/* ---- Sensitivity ---- */

/* Derivatives of a heading on the span of gear m that begins at `knot`, from its row of integrals; those by later knots
 * and gears, which are 0, are not written. (size,) */
static void heading_derivatives(const Basis *b, const double *z, const double *row, int64_t m, int64_t knot, double *out)
{
    for (int64_t gear = 0, first = 0; gear <= m; gear++) {
        int64_t next = first + b->divisions[2 * gear] + 1, end = gear < m ? next : knot + 2;
        for (int64_t j = first; j < end; j++)
            out[j] = row[j] * z[b->knots + gear];
        out[b->knots + gear] = dot(row + first, z + first, end - first);
        first = next;
    }
}

/* Add the displacements a and c, turned by the derivatives of their headings, and `stretched`, to those of the position;
 * columns begin to end - 1. */
static void add_turns(int64_t begin, int64_t end, const double *first, const double *second, Vector a, Vector c,
                      Vector stretched, double *by_x, double *by_y)
{
    for (int64_t j = begin; j < end; j++) {
        by_x[j] += -a.y * first[j] + -c.y * second[j] + stretched.x;
        by_y[j] += a.x * first[j] + c.x * second[j] + stretched.y;
    }
}

/* Compute the derivatives (S5) of the poses at all nodes with respect to the variables.
 *
 *   gears ... divisions   see `Basis`
 *   z        curvatures and lengths, (knots + gears,) = (size,)
 *   moved    displacements by the Gauss points, (2 intervals, 2)
 *   out      out, (3, nodes, size): derivatives of x, y and yaw
 *   work     (4, size) */
int64_t optdock_sensitivity(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals, const double *packed,
                            const int64_t *divisions, const double *z, const double *moved, double *out, double *work)
{
    Basis b = basis_of(gears, knots, nodes, intervals, packed, divisions);
    const Vector *moves = (const Vector *)moved;
    double *by_x = work, *by_y = by_x + b.size, *first = by_y + b.size, *second = first + b.size;
    double *out_x = out, *out_y = out + nodes * b.size, *out_yaw = out + 2 * nodes * b.size;
    for (int64_t j = 0; j < b.size; j++)
        by_x[j] = by_y[j] = first[j] = second[j] = 0.0;
    for (int64_t i = 0; i < nodes * b.size; i++)
        out_yaw[i] = 0.0;
    for (int64_t m = 0, node = 0, interval = 0, begin = 0; m < gears; m++, node++) {
        int64_t spans = divisions[2 * m], cells = divisions[2 * m + 1], own = knots + m;
        double inverse = 1.0 / z[own];
        for (int64_t cell = 0;; cell++, node++, interval++) {
            int64_t knot = begin + (cell < cells ? cell * spans / cells : spans - 1);
            for (int64_t j = 0; j < b.size; j++) {
                out_x[node * b.size + j] = by_x[j];
                out_y[node * b.size + j] = by_y[j];
            }
            heading_derivatives(&b, z, b.headings + node * knots, m, knot, out_yaw + node * b.size);
            if (cell == cells)
                break;
            Vector a = moves[2 * interval], c = moves[2 * interval + 1];
            heading_derivatives(&b, z, b.gauss + 2 * interval * knots, m, knot, first);
            heading_derivatives(&b, z, b.gauss + (2 * interval + 1) * knots, m, knot, second);
            Vector still = {0.0, 0.0}, stretched = {(a.x + c.x) * inverse, (a.y + c.y) * inverse};
            add_turns(0, knot + 2, first, second, a, c, still, by_x, by_y);
            add_turns(knots, own, first, second, a, c, still, by_x, by_y);
            add_turns(own, own + 1, first, second, a, c, stretched, by_x, by_y);
        }
        begin += spans + 1;
    }
    return 0;
}

/* ---- Goal projection ---- */

/* Start, gears and target of the path, bounds of the variables, and the settings of the projection. */
typedef struct {
    const double *start, *signs, *target;
    const double *lower, *upper, *inner_lower, *inner_upper; /* (size,), bounds of results and tighter ones */
    double rate, inner_rate;                                 /* bounds of the curvature rate */
    double tolerance, renew, contraction, reach;             /* see `GoalProjectionSettings` and `Ends.reach` */
    int64_t most_steps;
} Goal;

/* Work arrays, each of `size` numbers; jacobian: three of them. moves: (2 intervals,). */
typedef struct {
    double *turned, *trial, *jacobian;
    Vector *moves;
} Work;

static double clip(double value, double lower, double upper)
{
    value = value > lower || value != value ? value : lower;
    return value < upper || value != value ? value : upper;
}

/* The largest absolute value of three numbers, or NaN if one of them is. */
static double largest(const double error[3])
{
    double found = fabs(error[0]);
    for (int i = 1; i < 3; i++)
        found = found > fabs(error[i]) || found != found ? found : fabs(error[i]);
    return found;
}

/* Derivatives of the last pose, (3, size), as the function `end_sensitivity`. */
static void end_sensitivity(const Basis *b, const double *z, const Vector *moves, double *jacobian)
{
    double *x = jacobian, *y = x + b->size, *yaw = y + b->size;
    const double *last = b->headings + (b->nodes - 1) * b->knots;
    for (int64_t j = 0; j < b->knots; j++)
        x[j] = y[j] = 0.0;
    for (int64_t m = 0, i = 0, begin = 0; m < b->gears; m++) {
        int64_t spans = b->divisions[2 * m], cells = b->divisions[2 * m + 1];
        for (int64_t end = i + 2 * cells, at = 0; i < end; i++, at++) {
            const double *row = b->gauss + i * b->knots;
            for (int64_t j = 0; j < begin + at / 2 * spans / cells + 2; j++) {
                x[j] += moves[i].y * row[j];
                y[j] += moves[i].x * row[j];
            }
        }
        begin += spans + 1;
    }
    for (int64_t m = 0, first = 0, i = 0; m < b->gears; m++) {
        int64_t count = b->divisions[2 * m] + 1, end = i + 2 * b->divisions[2 * m + 1], own = b->knots + m;
        Vector moved = moves[i++];
        for (; i < end; i++)
            moved = (Vector){moved.x + moves[i].x, moved.y + moves[i].y};
        for (int64_t j = first; j < first + count; j++) {
            x[j] = -x[j];
            yaw[j] = last[j];
        }
        x[own] = dot(x + first, z + first, count) + moved.x / z[own];
        y[own] = dot(y + first, z + first, count) + moved.y / z[own];
        yaw[own] = dot(yaw + first, z + first, count);
        for (int64_t j = first; j < first + count; j++) {
            x[j] *= z[own];
            y[j] *= z[own];
            yaw[j] *= z[own];
        }
        first += count;
    }
}

/* Compute the derivatives of the last pose alone.
 *
 *   gears ... divisions   see `Basis`
 *   z        curvatures and lengths, (knots + gears,) = (size,)
 *   moved    displacements by the Gauss points, (2 intervals, 2)
 *   out      out, (3, size): derivatives of x, y and yaw */
int64_t optdock_end_sensitivity(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals, const double *packed,
                                const int64_t *divisions, const double *z, const double *moved, double *out)
{
    Basis b = basis_of(gears, knots, nodes, intervals, packed, divisions);
    end_sensitivity(&b, z, (const Vector *)moved, out);
    return 0;
}

/* Solve the normal equations of the step of least norm, as the functions `_least_norm` and `_solved`: the step is the
 * sum of the rows times `factors`. */
static void least_norm(const double *jacobian, int64_t size, const double error[3], double factors[3])
{
    const double *rows[3] = {jacobian, jacobian + size, jacobian + 2 * size};
    double a = dot(rows[0], rows[0], size) + 1e-12, b = dot(rows[1], rows[0], size);
    double c = dot(rows[1], rows[1], size) + 1e-12, d = dot(rows[2], rows[0], size);
    double e = dot(rows[2], rows[1], size), f = dot(rows[2], rows[2], size) + 1e-12;
    double first = b / a, second = d / a;
    c = c - first * b;
    e = e - second * b;
    double third = c > 0.0 ? e / c : 0.0;
    f = f - second * d - third * e;
    factors[0] = factors[1] = factors[2] = 0.0;
    if (!(a > 0.0 && c > 0.0 && f > 0.0))
        return;
    double y = error[1] - first * error[0], z = error[2] - second * error[0] - third * y;
    factors[2] = z / f;
    factors[1] = y / c - third * factors[2];
    factors[0] = error[0] / a - first * factors[1] - second * factors[2];
}

static double step_of(const double *jacobian, int64_t size, const double factors[3], int64_t j)
{
    return jacobian[j] * factors[0] + jacobian[size + j] * factors[1] + jacobian[2 * size + j] * factors[2];
}

/* Set the columns of variables that are fixed, or would leave their bounds, to zero. */
static void restrict_columns(const Goal *goal, const double *z, int64_t size, const double error[3], double *jacobian)
{
    double factors[3];
    for (int64_t j = 0; j < size; j++)
        for (int64_t row = 0; row < 3; row++)
            jacobian[row * size + j] *= goal->upper[j] > goal->lower[j] ? 1.0 : 0.0;
    least_norm(jacobian, size, error, factors);
    for (int64_t j = 0; j < size; j++) {
        double moved = z[j] - step_of(jacobian, size, factors, j);
        if (goal->upper[j] > goal->lower[j] && (moved < goal->lower[j] || moved > goal->upper[j]))
            for (int64_t row = 0; row < 3; row++)
                jacobian[row * size + j] *= 0.0;
    }
}

/* Move the end of the path onto the target by Newton steps (S6) as long as the error contracts. Return whether the work
 * arrays belong to the result. */
static int onto_goal(const Basis *b, const Goal *goal, double *z, Work work)
{
    double pose[3], error[3], found[3], factors[3];
    int is_renewed = 0;
    end_pose(b, z, goal->start, goal->signs, work.turned, work.moves, pose);
    for (int i = 0; i < 3; i++)
        error[i] = pose[i] - goal->target[i];
    for (int64_t step = 0; step < goal->most_steps; step++) {
        double size = largest(error);
        if (!(goal->tolerance <= size && size <= goal->reach))
            return 1;
        if (!is_renewed || size > goal->renew) {
            end_sensitivity(b, z, work.moves, work.jacobian);
            restrict_columns(goal, z, b->size, error, work.jacobian);
            is_renewed = 1;
        }
        least_norm(work.jacobian, b->size, error, factors);
        for (int64_t j = 0; j < b->size; j++)
            work.trial[j] = clip(z[j] - step_of(work.jacobian, b->size, factors, j), goal->lower[j], goal->upper[j]);
        end_pose(b, work.trial, goal->start, goal->signs, work.turned, work.moves, pose);
        for (int i = 0; i < 3; i++)
            found[i] = pose[i] - goal->target[i];
        if (!(largest(found) <= goal->contraction * size))
            return 0;
        for (int64_t j = 0; j < b->size; j++)
            z[j] = work.trial[j];
        for (int i = 0; i < 3; i++)
            error[i] = found[i];
    }
    return 1;
}

/* Limit the curvatures to the largest rate (S7). values: work, (knots,). */
static void limit_rate(const Basis *b, const Goal *goal, double *z, double *values)
{
    if (!isfinite(goal->inner_rate))
        return;
    for (int64_t m = 0, first = 0; m < b->gears; m++) {
        int64_t spans = b->divisions[2 * m];
        double slope = (1.0 - 1e-12) * goal->inner_rate * z[b->knots + m] / (double)spans;
        for (int64_t i = 0; i <= spans; i++)
            values[i] = z[first + i];
        for (int64_t k = 0; k <= spans; k++) {
            double fixed = values[k];
            if (goal->inner_lower[first + k] != goal->inner_upper[first + k])
                continue;
            for (int64_t i = 0; i <= spans; i++) {
                double change = slope * (double)(i > k ? i - k : k - i);
                values[i] = clip(values[i], fixed - change, fixed + change);
            }
        }
        for (int64_t i = 0; i <= spans; i++) {
            double low = INFINITY, high = -INFINITY;
            for (int64_t k = 0; k <= spans; k++) {
                double change = slope * (double)(i > k ? i - k : k - i);
                double above = values[k] + change, below = values[k] - change;
                low = low < above || low != low ? low : above;
                high = high > below || high != high ? high : below;
            }
            z[first + i] = 0.5 * (low + high);
        }
        first += spans + 1;
    }
}

static int rate_is_kept(const Basis *b, const Goal *goal, const double *z)
{
    for (int64_t m = 0, knot = 0; m < b->gears; m++, knot++) {
        int64_t spans = b->divisions[2 * m];
        double most = goal->rate * z[b->knots + m] * (1.0 + 1e-12);
        for (int64_t end = knot + spans; knot < end; knot++)
            if (!(fabs((double)spans * (z[knot + 1] - z[knot])) <= most))
                return 0;
    }
    return 1;
}

/* Project variables onto the goal, or limit their rate if that is impossible, and roll the result out.
 *
 *   gears ... divisions   see `Basis`
 *   most_steps            of Newton
 *   alternations          between the goal and the rate; negative: only the Newton steps, from the given variables, and
 *                         no roll-out
 *   tolerance ... inner_rate   see `Goal`
 *   given    curvatures and lengths (size,), start (3,), signs (gears,), target (3,), then lower and upper bounds and
 *            tighter lower and upper bounds (size,) each
 *   out      out and work, (4 nodes + 6 intervals + 7 size,): `Rollout.packed`, variables (size,), work */
int64_t optdock_project_and_roll_out(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals,
                                     int64_t most_steps, int64_t alternations, double tolerance, double renew,
                                     double contraction, double reach, double rate, double inner_rate,
                                     const double *packed, const int64_t *divisions, const double *given, double *out)
{
    Basis b = basis_of(gears, knots, nodes, intervals, packed, divisions);
    int64_t size = b.size;
    const double *start = given + size, *signs = start + 3, *target = signs + gears, *lower = target + 3;
    Goal goal = {start, signs, target, lower, lower + size, lower + 2 * size, lower + 3 * size, rate, inner_rate,
                 tolerance, renew, contraction, reach, most_steps};
    double *z = out + 4 * nodes + 6 * intervals, *clipped = z + size;
    Work work = {z + 2 * size, z + 3 * size, z + 4 * size, (Vector *)(z - 4 * intervals)};
    for (int64_t j = 0; j < size; j++)
        z[j] = clipped[j] = alternations < 0 ? given[j] : clip(given[j], goal.lower[j], goal.upper[j]);
    int is_displaced = onto_goal(&b, &goal, z, work);
    if (alternations < 0)
        return 0;
    for (int64_t i = 0; i < alternations && !rate_is_kept(&b, &goal, z); i++) {
        limit_rate(&b, &goal, z, work.trial);
        is_displaced = onto_goal(&b, &goal, z, work);
    }
    if (!rate_is_kept(&b, &goal, z)) {
        for (int64_t j = 0; j < size; j++)
            z[j] = clipped[j];
        limit_rate(&b, &goal, z, work.trial);
        is_displaced = 0;
    }
    roll_out(&b, z, start, signs, is_displaced, out, work.turned);
    return 0;
}
