/* Speeds of the models of a delayed drive: the function `advanced` of `delay_estimate.py` in C.
 *
 * Exponentials are those of the C library, so the results are equal to those of the twin up to rounding. */

#include <math.h>
#include <stdint.h>

/* The last of `count` ascending times before `time`, or also at it if `inclusive`; -1 if there is none. */
static int64_t last_until(const double *times, int64_t count, double time, int inclusive)
{
    int64_t found = count - 1;
    while (found >= 0 && (inclusive ? times[found] > time : times[found] >= time))
        found--;
    return found;
}

/* Advance the speeds by a period.
 *
 *   latencies, lags   numbers of latencies and of lags
 *   given             number of commands, > 0
 *   begin, period     begin and duration of the period [s]
 *   speeds            (latencies, lags), at the begin
 *   history           (2 given,): times since which the commands are in force, ascending, and the commands
 *   models            (latencies + lags,): the latencies and the lags [s]
 *   out               out, (latencies, lags)
 *
 * Return the number of models. */
int64_t optdock_delayed_speeds(int64_t latencies, int64_t lags, int64_t given, double begin, double period,
                               const double *speeds, const double *history, const double *models, double *out)
{
    for (int64_t i = 0; i < latencies * lags; i++)
        out[i] = speeds[i];
    for (int64_t i = 0; i < latencies; i++) {
        double at = begin - models[i], end = begin - models[i] + period;
        int64_t first = last_until(history, given, at, 1), last = last_until(history, given, end, 0);
        for (int64_t row = first < 0 ? 0 : first; row <= last; row++) {
            double until = row == last ? end : history[row + 1], time = until - at, command = history[given + row];
            for (int64_t j = 0; time > 0.0 && j < lags; j++) {
                double decay = exp(-time / models[latencies + j]);
                out[i * lags + j] = decay * out[i * lags + j] + (1.0 - decay) * command;
            }
            at = until;
        }
    }
    return latencies * lags;
}
