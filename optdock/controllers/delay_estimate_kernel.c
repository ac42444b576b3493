/* Models of a delayed drive: the function `advanced` of `delay_estimate.py` in C.
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

/* Advance the models by a period, and compare their speeds at its end with the measured one.
 *
 *   latencies, lags        numbers of latencies and of lags
 *   given                  number of commands, > 0
 *   begin, period          begin and duration of the period [s]
 *   speed, kept, weight    measured speed [m/s]; factor on the misfits; duration for which the new errors count [s]
 *   models                 (2, latencies, lags), speeds and misfits at the begin
 *   history                (2 given,): times since which the commands are in force, ascending, and the commands
 *   delays                 (latencies + lags,): the latencies and the lags [s]
 *   out                    out, (2, latencies, lags)
 *
 * Return the number of models. */
int64_t optdock_advance_models(int64_t latencies, int64_t lags, int64_t given, double begin, double period,
                               double speed, double kept, double weight, const double *models, const double *history,
                               const double *delays, double *out)
{
    int64_t count = latencies * lags;
    for (int64_t i = 0; i < count; i++)
        out[i] = models[i];
    for (int64_t i = 0; i < latencies; i++) {
        double at = begin - delays[i], end = begin - delays[i] + period;
        int64_t first = last_until(history, given, at, 1), last = last_until(history, given, end, 0);
        for (int64_t row = first < 0 ? 0 : first; row <= last; row++) {
            double until = row == last ? end : history[row + 1], time = until - at, command = history[given + row];
            for (int64_t j = 0; time > 0.0 && j < lags; j++) {
                double decay = exp(-time / delays[latencies + j]);
                out[i * lags + j] = decay * out[i * lags + j] + (1.0 - decay) * command;
            }
            at = until;
        }
    }
    for (int64_t i = 0; i < count; i++) {
        double error = out[i] - speed;
        out[count + i] = kept * models[count + i] + weight * (error * error);
    }
    return count;
}
