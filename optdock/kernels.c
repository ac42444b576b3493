/* About the shared library of the kernels: its interface number, its sources, and a test of its floating-point
 * arithmetic. `optdock/kernels.py` calls these functions before it uses any kernel. */

#include <math.h>
#include <stdint.h>

/* The number of the interface between the kernels and the Python modules that call them. */
int64_t optdock_kernels_abi(void) { return 1; }

/* Digest of the sources, and their names. */
const char *optdock_kernels_digest(void) { return OPTDOCK_DIGEST; }

const char *optdock_kernels_sources(void) { return OPTDOCK_SOURCES; }

/* Return 0 if the arithmetic is that of IEEE 754 as NumPy uses it, otherwise the number of the first failure:
 *   1: a product and a sum were contracted, so that the product was not rounded;
 *   2: a comparison with NaN is true;
 *   3: the square root is not correctly rounded;
 *   4: subnormal numbers are flushed to zero;
 *   5: a half is not rounded to the even integer.
 * in, Shape (4,): 1 + 2^-27, NaN, 2, 2^-1040. The values are given so that no compiler can evaluate them. */
int64_t optdock_kernels_self_test(const double *in)
{
    double near_one = in[0], nan = in[1], two = in[2], tiny = in[3];
    double square = 1.0 + ldexp(1.0, -26); /* the rounded square of near_one, which is 1 + 2^-26 + 2^-54 */
    if (near_one * near_one - square != 0.0)
        return 1;
    if (nan == nan || nan < 0.0 || nan >= 0.0 || !(nan != nan))
        return 2;
    if (sqrt(two) != 1.4142135623730951)
        return 3;
    if (tiny * 0.5 == 0.0)
        return 4;
    if (rint(two + 0.5) != 2.0)
        return 5;
    return 0;
}
