/* Components and cheapest routes: the functions `connected_cells` and `_predecessors` of `connectivity_graph.py` in C.
 *
 * Only the search for a proof depends on this file; the checker has code of its own. */

#include <math.h>
#include <stdint.h>

/* Number the connected components of cells of one kind, cells that share faces, in the order of their first cells.
 *
 *   layers, rows, columns   shape of the grid
 *   kinds    (layers, rows, columns), 1 or 2; other cells are omitted
 *   stack    (cells,), room
 *   labels   out, (layers, rows, columns), all components of kind 1 before those of kind 2; -1 for omitted cells
 *   counts   out, (2,), numbers of components of either kind */
int64_t optdock_connected_cells(int64_t layers, int64_t rows, int64_t columns, const int64_t *kinds, int64_t *stack,
                                int64_t *labels, int64_t *counts)
{
    int64_t cells = layers * rows * columns, layer = rows * columns, next = 0;
    for (int64_t i = 0; i < cells; i++)
        labels[i] = -1;
    for (int64_t kind = 1; kind <= 2; kind++) {
        int64_t before = next;
        for (int64_t i = 0; i < cells; i++) {
            if (kinds[i] != kind || labels[i] >= 0)
                continue;
            int64_t waiting = 1;
            stack[0] = i;
            labels[i] = next;
            while (waiting > 0) {
                int64_t cell = stack[--waiting], row = cell / columns % rows, column = cell % columns;
                const int64_t beside[6] = {cell - layer, cell + layer, cell - columns, cell + columns, cell - 1,
                                           cell + 1};
                const int exists[6] = {cell >= layer, cell + layer < cells,     row > 0,
                                       row + 1 < rows, column > 0, column + 1 < columns};
                for (int k = 0; k < 6; k++) {
                    if (exists[k] && kinds[beside[k]] == kind && labels[beside[k]] < 0) {
                        labels[beside[k]] = next;
                        stack[waiting++] = beside[k];
                    }
                }
            }
            next++;
        }
        counts[kind - 1] = next - before;
    }
    return 0;
}

/* Whether entry a of a heap comes before entry b: lower key, then lower node. */
static int is_before(double key, int64_t node, double other_key, int64_t other_node)
{
    return key < other_key || (key == other_key && node < other_node);
}

static void push(double *keys, int64_t *nodes, int64_t size, double key, int64_t node)
{
    int64_t i = size;
    while (i > 0 && is_before(key, node, keys[(i - 1) / 2], nodes[(i - 1) / 2])) {
        keys[i] = keys[(i - 1) / 2];
        nodes[i] = nodes[(i - 1) / 2];
        i = (i - 1) / 2;
    }
    keys[i] = key;
    nodes[i] = node;
}

/* Remove the first of `size` entries; the last one takes its place and sinks. */
static void pop(double *keys, int64_t *nodes, int64_t size)
{
    double key = keys[size - 1];
    int64_t node = nodes[size - 1], i = 0, last = size - 1;
    for (;;) {
        int64_t child = 2 * i + 1;
        if (child >= last)
            break;
        if (child + 1 < last && is_before(keys[child + 1], nodes[child + 1], keys[child], nodes[child]))
            child++;
        if (!is_before(keys[child], nodes[child], key, node))
            break;
        keys[i] = keys[child];
        nodes[i] = nodes[child];
        i = child;
    }
    keys[i] = key;
    nodes[i] = node;
}

/* Compute the predecessor of every node on the best route from a start until the goal is reached.
 *
 *   n, joints, start, goal   numbers of nodes and joints; nodes
 *   is_minimax   0: sum of the costs of the nodes after the start; 1: tree whose routes have the lowest highest cost
 *   pairs        (joints, 2), adjacent nodes; cost: (n,)
 *   offsets      (n + 1,), room; beside: (2 joints,), room
 *   nodes, keys  (2 joints + 1,), room for the heap
 *   best         (n,), room
 *   before       out, (n,); -1 for the start and for nodes that were not reached
 *
 * Returns 1 if a pair names no node. */
int64_t optdock_predecessors(int64_t n, int64_t joints, int64_t start, int64_t goal, int64_t is_minimax,
                             const int64_t *pairs, const double *cost, int64_t *offsets, int64_t *beside,
                             int64_t *nodes, double *keys, double *best, int64_t *before)
{
    for (int64_t i = 0; i <= n; i++)
        offsets[i] = 0;
    for (int64_t k = 0; k < 2 * joints; k++) {
        if (pairs[k] < 0 || pairs[k] >= n)
            return 1;
        offsets[pairs[k]]++;
    }
    for (int64_t i = 1; i <= n; i++)
        offsets[i] += offsets[i - 1];
    for (int64_t k = 0; k < 2 * joints; k++)
        beside[--offsets[pairs[k]]] = pairs[k ^ 1];
    for (int64_t i = 0; i < n; i++) {
        best[i] = INFINITY;
        before[i] = -1;
    }
    int64_t size = 1;
    best[start] = keys[0] = -INFINITY;
    nodes[0] = start;
    while (size > 0) {
        double key = keys[0];
        int64_t node = nodes[0];
        pop(keys, nodes, size--);
        if (node == goal)
            break;
        if (key > best[node])
            continue; /* reached on a better route since */
        double spent = node == start ? 0.0 : key;
        best[node] = -INFINITY;
        for (int64_t k = offsets[node]; k < offsets[node + 1]; k++) {
            int64_t other = beside[k];
            double reached = is_minimax ? (cost[node] > cost[other] ? cost[node] : cost[other]) : spent + cost[other];
            if (reached < best[other]) {
                best[other] = reached;
                before[other] = node;
                push(keys, nodes, size++, reached, other);
            }
        }
    }
    return 0;
}
