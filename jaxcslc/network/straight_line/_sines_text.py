#: C of sines and cosines of rows of numbers, of which compilers make instructions on several at
#: once; the C library's take one at a time. It needs `LANES`, the type `lanes` of so many numbers,
#: and rows whose lengths are multiples of it.
#:
#: x = n pi/2 + r with n to 20 bits: pi/2 in parts of 33, 33 and 53 bits, so that the first two
#: products are exact and r is a sum of two numbers. The polynomials are those of FreeBSD's
#: `__kernel_sin` and `__kernel_cos` (S. Moshier, Sun Microsystems), within 0.6 units of the last
#: digit for |r| <= pi/4. Larger numbers, and those that are not finite, go to the C library.
SINES_TEXT = """
typedef long long integers __attribute__((vector_size(8 * LANES), aligned(8)));

static void sines_and_cosines(const double* x, double* sines, double* cosines, int length)
{
    int large = 0;
    for (int i = 0; i < length; ++i)
        large |= !(fabs(x[i]) <= 1e6);
    if (large) {
        for (int i = 0; i < length; ++i) {
            const double angle = x[i];
            sines[i] = sin(angle);
            cosines[i] = cos(angle);
        }
        return;
    }
    for (int i = 0; i < length; i += LANES) {
        const lanes angle = *(const lanes*)(x + i);
        /* Adding 3 * 2^51 leaves a whole number of quarter turns in the last digits. */
        const lanes shifted = angle * 0x1.45f306dc9c883p-1 + 0x1.8p52;
        const lanes turns = shifted - 0x1.8p52;
        const integers quadrant = (integers)shifted;
        const lanes first = angle - turns * 0x1.921fb544p+0;
        const lanes second = turns * 0x1.0b4611a6p-34;
        const lanes high = first - second, change = high - first;
        const lanes low = ((first - (high - change)) - (second + change))
            - turns * 0x1.3198a2e037073p-69;
        const lanes r = high + low, tail = (high - r) + low;
        const lanes z = r * r, zr = z * r, zz = z * z;
        const lanes s = 8.33333333332248946124e-03
            + z * (-1.98412698298579493134e-04 + z * 2.75573137070700676789e-06)
            + z * zz * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10);
        const lanes sine = r - ((z * (0.5 * tail - zr * s) - tail)
            - zr * -1.66666666666666324348e-01);
        const lanes c = z * (4.16666666666666019037e-02
            + z * (-1.38888888888741095749e-03 + z * 2.48015872894767294178e-05))
            + zz * zz * (-2.75573143513906633035e-07
            + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11));
        const lanes half = 0.5 * z, one = 1.0 - half;
        const lanes cosine = one + (((1.0 - one) - half) + (z * c - r * tail));
        const integers odd = -(quadrant & 1);
        const integers sine_bits = (integers)sine, cosine_bits = (integers)cosine;
        const integers of_sine = (odd & cosine_bits) | (~odd & sine_bits);
        const integers of_cosine = (odd & sine_bits) | (~odd & cosine_bits);
        *(lanes*)(sines + i) = (lanes)(of_sine ^ ((quadrant & 2) << 62));
        *(lanes*)(cosines + i) = (lanes)(of_cosine ^ (((quadrant + 1) & 2) << 62));
    }
}
"""
