/* Terms at the nodes of a path: the functions `term_points`, `terms_along` and `linearized_terms` of `term_rows.py` in C.
 *
 * CasADi evaluates the terms between the first two kernels. A search for a path uses these functions; the certificate does
 * not. */

#include <math.h>
#include <stdint.h>

int64_t optdock_wrap_headings(int64_t n, double *points);
int64_t optdock_sensitivity(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals, const double *packed,
                            const int64_t *divisions, const double *z, const double *moved, double *out, double *work);

enum { SYMBOLS = 7, DERIVATIVES = 6 }; /* see `SYMBOLS` in terms.py; there is no derivative by the last one */

/* Compute the symbols at the nodes of a path, as the function `term_points`.
 *
 *   gears, nodes     numbers
 *   before, after    distances driven before the first node, and to be driven after the last one [m]
 *   divisions        (gears, 2), spans and intervals of each gear
 *   lengths, signs   (gears,), lengths [m] and directions
 *   rollout          see `Rollout.packed`
 *   points           out, (nodes, 7) */
int64_t optdock_term_points(int64_t gears, int64_t nodes, double before, double after, const int64_t *divisions,
                            const double *lengths, const double *signs, const double *rollout, double *points)
{
    double passed = 0.0, left = 0.0, *point = points;
    for (int64_t m = 0; m < gears; m++)
        left += lengths[m];
    for (int64_t m = 0, node = 0; m < gears; m++) {
        int64_t cells = divisions[2 * m + 1];
        left -= lengths[m];
        for (int64_t i = 0; i <= cells; i++, node++, point += SYMBOLS) {
            double share = (double)i / (double)cells;
            point[0] = rollout[3 * node];
            point[1] = rollout[3 * node + 1];
            point[2] = rollout[3 * node + 2];
            point[3] = rollout[3 * nodes + node];
            point[4] = before + (passed + share * lengths[m]);
            point[5] = after + ((1.0 - share) * lengths[m] + left);
            point[6] = signs[m];
        }
        passed += lengths[m];
    }
    return optdock_wrap_headings(nodes, points);
}

/* Whether hard term k can change its sign within a step at a node with this row of the table, or is not a number; see
 * `TermBound`. */
static int is_near(const double *row, int64_t count, int64_t k, double reach, double bend)
{
    const double *slopes = row + count + k;
    double change = 0.0;
    for (int64_t j = 0; j < DERIVATIVES; j++)
        change += (j == 3 ? bend : reach) * fabs(slopes[j * count]);
    return !(row[k] >= change);
}

/* Weight of the trapezoidal rule at a node, as a share of the length of its gear. */
static double share_of(int64_t node, int64_t cells)
{
    return (node > 0 && node < cells ? 1.0 : 0.5) / (double)cells;
}

/* Reduce the terms at the nodes to their cost and shortfalls.
 *
 *   gears, hard, soft    numbers; margins: 0, or nodes times `hard`
 *   reach, bend          see `TermBound`
 *   divisions, lengths   see `optdock_term_points`
 *   weights              (soft + margins,), weights [1/m], and values subtracted from the hard terms (nodes, hard)
 *   table                (nodes, 7 terms), values of the hard and the soft terms and their derivatives by each symbol;
 *                        margins are subtracted, and derivatives that are not finite set to 0
 *   out                  out, (nodes + 2,): largest shortfall of the hard terms at each node, infinite where one is not
 *                        a number; cost of the soft terms; largest of the shortfalls
 *
 * Return whether a term acts, see `TermsAlong`. */
int64_t optdock_terms_along(int64_t gears, int64_t hard, int64_t soft, int64_t margins, double reach, double bend,
                            const int64_t *divisions, const double *weights, const double *lengths, double *table,
                            double *out)
{
    int64_t count = hard + soft, acts = 0;
    double cost = 0.0, worst = -INFINITY;
    const double *margin = weights + soft;
    for (int64_t m = 0; m < gears; m++) {
        for (int64_t i = 0; i <= divisions[2 * m + 1]; i++, table += (1 + DERIVATIVES) * count, out++) {
            double *slopes = table + count, lowest = INFINITY;
            int is_number = 1;
            for (int64_t j = 0; j < DERIVATIVES * count; j++)
                slopes[j] = isfinite(slopes[j]) ? slopes[j] : 0.0;
            for (int64_t k = 0; k < hard; k++) {
                table[k] -= margins > 0 ? *margin++ : 0.0;
                acts |= is_near(table, count, k, reach, bend);
                is_number &= !isnan(table[k]);
                lowest = table[k] < lowest ? table[k] : lowest;
            }
            *out = is_number ? -lowest : INFINITY;
            worst = *out > worst ? *out : worst;
            for (int64_t k = 0; k < soft; k++) {
                double residual = table[hard + k];
                acts |= residual != 0.0;
                cost += share_of(i, divisions[2 * m + 1]) * lengths[m] * (weights[k] * (residual * residual));
            }
        }
    }
    out[0] = isfinite(cost) ? cost : INFINITY;
    out[1] = worst;
    return acts;
}

/* The part of each gear that is driven at the nodes of a path, as the function `_done`. */
static double done(int64_t gear, int64_t own, double share) { return gear == own ? share : gear < own ? 1.0 : 0.0; }

/* The derivatives of a term at a node by the variables.
 *
 *   size, knots, nodes   numbers
 *   by                   (3, nodes, size), see `optdock_sensitivity`
 *   hats                 (knots,), derivatives of the curvature at the node
 *   node, gear, share    of the node; share: of the length of its gear that is driven
 *   slopes               of the term by the symbols, each `count` numbers after the one before
 *   out                  out, (size,) */
static void by_variables(int64_t size, int64_t knots, int64_t nodes, const double *by, const double *hats, int64_t node,
                         int64_t gear, double share, const double *slopes, int64_t count, double *out)
{
    const double *by_x = by + node * size, *by_y = by_x + nodes * size, *by_yaw = by_y + nodes * size;
    for (int64_t j = 0; j < size; j++)
        out[j] = slopes[0] * by_x[j] + slopes[count] * by_y[j] + slopes[2 * count] * by_yaw[j];
    for (int64_t j = 0; j < knots; j++)
        out[j] += slopes[3 * count] * hats[j];
    for (int64_t j = knots; j < size; j++) {
        double part = done(j - knots, gear, share);
        out[j] += slopes[4 * count] * part + slopes[5 * count] * (1.0 - part);
    }
}

/* The last of the `most` near nodes with the lowest values of term k, of equal values the first nodes; -1 if there are not
 * more near nodes.
 *
 *   lowest   work, (min(most, nodes),) */
static int64_t last_low(int64_t nodes, int64_t count, int64_t k, double reach, double bend, const double *table,
                        int64_t most, int64_t *lowest)
{
    int64_t width = (1 + DERIVATIVES) * count, near = 0;
    for (int64_t i = 0; i < nodes; i++) {
        const double *row = table + i * width;
        if (!is_near(row, count, k, reach, bend))
            continue;
        int64_t at = near < most ? near : most;
        for (near++; at > 0 && row[k] < table[lowest[at - 1] * width + k]; at--)
            if (at < most)
                lowest[at] = lowest[at - 1];
        if (at < most)
            lowest[at] = i;
    }
    return near > most ? lowest[most - 1] : -1;
}

/* Linearize the terms at a path.
 *
 *   gears ... intervals, basis, divisions   see `Basis` in rollout_kernel.c
 *   hard, soft, reach, bend, table          see `optdock_terms_along`
 *   most, flat   most rows per term, and largest derivative of a row that is left out
 *   z            curvatures and lengths, (knots + gears,) = (size,)
 *   moves        displacements by the Gauss points, (2 intervals, 2)
 *   weights      (soft,) [1/m]
 *   costs        out, (size + size^2,), gradient and Hessian of the soft terms; nothing if there are none
 *   rows, node   out, (hard min(most, nodes), 1 + size), gap and gradient of each row, and their nodes
 *   work         (3 nodes size + 5 size,)
 *
 * Return the number of rows. */
int64_t optdock_linearized_terms(int64_t gears, int64_t knots, int64_t nodes, int64_t intervals, int64_t hard,
                                 int64_t soft, int64_t most, double reach, double bend, double flat,
                                 const double *basis, const int64_t *divisions, const double *z, const double *moves,
                                 const double *table, const double *weights, double *costs,
                                 double *rows, int64_t *node, double *work)
{
    int64_t size = knots + gears, count = hard + soft, width = (1 + DERIVATIVES) * count, found = 0;
    double *by = work, *moved = by + 3 * nodes * size, *hessian = costs + size;
    const double *hats = basis + (2 * intervals + nodes) * knots;
    optdock_sensitivity(gears, knots, nodes, intervals, basis, divisions, z, moves, by, moved + size);
    for (int64_t j = 0; soft > 0 && j < size + size * size; j++)
        costs[j] = 0.0;
    for (int64_t k = 0; k < count; k++) {
        int64_t last = k < hard ? last_low(nodes, count, k, reach, bend, table, most, node + found) : -1;
        double highest = last < 0 ? INFINITY : table[last * width + k];
        for (int64_t m = 0, i = 0; m < gears; m++) {
            int64_t cells = divisions[2 * m + 1];
            for (int64_t cell = 0; cell <= cells; cell++, i++) {
                const double *at = table + i * width;
                int is_row = k < hard && is_near(at, count, k, reach, bend) &&
                             (at[k] < highest || (at[k] == highest && i <= last));
                if (!is_row && (k < hard || at[k] == 0.0))
                    continue;
                by_variables(size, knots, nodes, by, hats + i * knots, i, m, (double)cell / (double)cells,
                             at + count + k, count, moved);
                double steepest = 0.0;
                for (int64_t j = 0; j < size; j++)
                    steepest = fabs(moved[j]) > steepest ? fabs(moved[j]) : steepest;
                if (is_row && steepest > flat) {
                    double *row = rows + found * (1 + size);
                    node[found++] = i;
                    row[0] = at[k];
                    for (int64_t j = 0; j < size; j++)
                        row[1 + j] = moved[j];
                }
                if (is_row)
                    continue;
                double weight = weights[k - hard] * share_of(cell, cells), scale = 2.0 * weight * z[knots + m];
                costs[knots + m] += weight * (at[k] * at[k]);
                for (int64_t j = 0; j < size; j++) {
                    double factor = scale * moved[j], *row = hessian + j * size;
                    if (factor == 0.0) /* of later knots, which do not move the node */
                        continue;
                    costs[j] += factor * at[k];
                    for (int64_t l = 0; l <= j; l++)
                        row[l] += factor * moved[l];
                }
            }
        }
    }
    for (int64_t j = 0; soft > 0 && j < size; j++)
        for (int64_t l = 0; l < j; l++)
            hessian[l * size + j] = hessian[j * size + l];
    return found;
}
