"""C code of banded normal equations whose border is in all equations; for sizes of any kind."""

from ....codegen import LANES_TEXT


SOURCE = (
    LANES_TEXT
    + """typedef double four __attribute__((vector_size(32), aligned(8)));
typedef double two __attribute__((vector_size(16), aligned(8)));

/* Rows minus factors times rows so many apart: a part of their columns that registers hold. */
#define ELIMINATED(type, parts)                                                                  \\
    {                                                                                            \\
        type sum[parts];                                                                         \\
        for (int c = 0; c < parts; ++c)                                                          \\
            sum[c] = ((type*)row)[c];                                                            \\
        for (long d = 1; d <= most; ++d) {                                                       \\
            const double x = factor[d * step];                                                   \\
            const type* const other = (const type*)(row + d * apart);                            \\
            for (int c = 0; c < parts; ++c)                                                      \\
                sum[c] -= x * other[c];                                                          \\
        }                                                                                        \\
        for (int c = 0; c < parts; ++c)                                                          \\
            ((type*)row)[c] = sum[c] * inverse;                                                  \\
        row += parts * sizeof(type) / sizeof(double);                                            \\
        left -= parts * sizeof(type) / sizeof(double);                                           \\
    }

/* A row of the right side; `step` between the factors of rows `apart`. */
static void eliminate(
    const double* factor, long step, double inverse, double* row, long apart, long most, long left)
{
    while (left >= 4 * LANES)
        ELIMINATED(lanes, 4)
    while (left >= LANES)
        ELIMINATED(lanes, 1)
    while (left)
        ELIMINATED(double, 1)
}

/* Solves with the triangle of a banded factorisation, diagonals first, a column after the other;
   or with its transpose. Columns from `first` to before `last` of (size, columns), in place. */
void solve(
    const double* factor, double* right, long size, long width, long columns, long transposed,
    long first, long last)
{
    for (long n = 0; n < size; ++n) {
        const long i = transposed ? size - 1 - n : n;
        const long most = n < width - 1 ? n : width - 1;
        const double* const diagonal = factor + i * width;
        double* const row = right + i * columns + first;
        if (transposed)
            eliminate(diagonal, 1, 1.0 / *diagonal, row, columns, most, last - first);
        else
            eliminate(diagonal, 1 - width, 1.0 / *diagonal, row, -columns, most, last - first);
    }
}

/* Adds a sum of products to so many numbers in a row: `count` factors, `step` apart, times rows
   `apart`, a part of their columns that a register holds. */
#define SUMMED(type)                                                                             \\
    {                                                                                            \\
        type sum = *(type*)to;                                                                   \\
        for (long i = 0; i < count; ++i)                                                         \\
            sum += factors[i * step] * *(const type*)(rows + i * apart);                         \\
        *(type*)to = sum;                                                                        \\
        to += sizeof(type) / sizeof(double);                                                     \\
        rows += sizeof(type) / sizeof(double);                                                   \\
        left -= sizeof(type) / sizeof(double);                                                   \\
    }

static inline void add_sum(
    double* to, const double* factors, long step, const double* rows, long apart, long count,
    long left)
{
    while (left >= LANES)
        SUMMED(lanes)
#if LANES > 4
    if (left >= 4)
        SUMMED(four)
#endif
    if (LANES > 2 && left >= 2)
        SUMMED(two)
    while (left)
        SUMMED(double)
}

/* Adds products to so many rows: of a register of the border's columns, those of so many joints
   that are not 0 there. `factors` and `rows` joint by joint. */
#define ADDED(type, joints, ...)                                                                 \\
    {                                                                                            \\
        const long each[joints] = { __VA_ARGS__ };                                               \\
        type x[joints];                                                                          \\
        const double* of[joints];                                                                \\
        for (int i = 0; i < joints; ++i) {                                                       \\
            x[i] = *(const type*)(rows + each[i] * padded + at);                                 \\
            of[i] = factors + each[i] * stencil;                                                 \\
        }                                                                                        \\
        for (long r = first; r < stencil; ++r) {                                                 \\
            type sum = *(type*)(mixed + targets[r] + at);                                        \\
            for (int i = 0; i < joints; ++i)                                                     \\
                sum += of[i][r] * x[i];                                                          \\
            *(type*)(mixed + targets[r] + at) = sum;                                             \\
        }                                                                                        \\
    }

/* Those of up to three joints at a time. */
#define ALL_ADDED(type)                                                                          \\
    for (long i = from; i < to; i += 3)                                                          \\
        if (to - i == 1)                                                                         \\
            ADDED(type, 1, active[i])                                                            \\
        else if (to - i == 2)                                                                    \\
            ADDED(type, 2, active[i], active[i + 1])                                             \\
        else                                                                                     \\
            ADDED(type, 3, active[i], active[i + 1], active[i + 2])

/* Adds the squares of the equations of instants from `begin` to before `end`, n each. An instant's
   are of positions at `slots` samples; the first of them is `order` before the instant, or missing.

   - firsts: where the n positions of each sample are in the band.
   - weight: (count, n); by_position: (count, n, slots n).
   - values: (count, entries) derivatives by the border that are not 0, of `joints` and `indices`.
   - band: (size, width), diagonals first, a column after the other; mixed: (size, columns).
   - memory: (slots n + columns + 8) n numbers; integers: (n + 1) (columns / 2 + 1) + slots n,
     all 0. */
void add_equations(
    const long* firsts, const double* weight, const double* by_position, const double* values,
    const long* joints, const long* indices, double* band, double* mixed, double* memory,
    long* integers, long begin, long end, long n, long slots, long order, long width, long columns,
    long entries)
{
    const long stencil = slots * n, parts = columns / LANES + 1, padded = parts * LANES;
    double* const factors = memory;
    double* const rows = factors + stencil * n;
    long* const ends = integers;
    long* const active = ends + parts;
    long* const targets = active + parts * n;
    long number = 0;
    for (long c = 0; c < parts; ++c) {
        for (long j = 0; j < n; ++j) {
            long some = 0;
            for (long i = 0; i < entries; ++i)
                some |= joints[i] == j && indices[i] / LANES == c;
            if (some)
                active[number++] = j;
        }
        ends[c] = number;
    }
    for (long e = begin; e < end; ++e) {
        const double* const a = by_position + e * n * stencil;
        const long missing = e < order ? order - e : 0, first = missing * n;
        for (long i = 0; i < entries; ++i)
            rows[joints[i] * padded + indices[i]] = values[e * entries + i];
        for (long j = 0; j < n; ++j)
            for (long r = first; r < stencil; ++r)
                factors[j * stencil + r] = weight[e * n + j] * a[j * stencil + r];
        for (long slot = missing; slot < slots; ++slot)
            for (long m = 0; m < n; ++m) {
                const long r = slot * n + m, column = firsts[e - order + slot] + m;
                targets[r] = column * columns;
                /* Rows of the band one after the other, but for unknowns that are no positions. */
                for (long from = r, to; from < stencil; from = to) {
                    const long row = firsts[e - order + from / n] + from % n;
                    to = (from / n + 1) * n;
                    while (to < stencil && firsts[e - order + to / n] == row + to - from)
                        to += n;
                    add_sum(band + column * width + row - column, factors + r, stencil, a + from,
                            stencil, n, to - from);
                }
            }
        for (long c = 0; c < parts; ++c) {
            const long from = c ? ends[c - 1] : 0, to = ends[c];
            if (c < parts - 1) {
                const long at = c * LANES;
                ALL_ADDED(lanes)
            } else
                for (long at = c * LANES; at < columns; ++at)
                    ALL_ADDED(double)
        }
    }
}

/* The sum of products of so many numbers. */
static double product(const double* one, const double* other, long count)
{
    lanes sums = {0.0};
    double sum = 0.0;
    for (; count >= LANES; count -= LANES, one += LANES, other += LANES)
        sums += *(const lanes*)one * *(const lanes*)other;
    for (; count; --count)
        sum += *one++ * *other++;
    for (int i = 0; i < LANES; ++i)
        sum += sums[i];
    return sum;
}

/* Adds a factor times so many numbers. */
static void add_product(double factor, const double* one, double* sum, long count)
{
    for (; count >= LANES; count -= LANES, one += LANES, sum += LANES)
        *(lanes*)sum += factor * *(const lanes*)one;
    for (; count; --count)
        *sum++ += factor * *one++;
}

/* How equations of instants from `begin` to before `end` change, (count, n).

   - by_position, values: as of `add_equations`; a joint's values begin at `firsts`, (n + 1).
   - position: (count + slots - order - 1, n) changes; border: (entries) those of each value. */
void change_equations(
    const double* by_position, const double* values, const long* firsts, const double* position,
    const double* border, double* change, long begin, long end, long n, long slots, long order)
{
    const long stencil = slots * n, entries = firsts[n];
    for (long e = begin; e < end; ++e) {
        const long first = e < order ? (order - e) * n : 0;
        const double* const near = position + (e - order) * n;
        for (long j = 0; j < n; ++j) {
            const double* const a = by_position + (e * n + j) * stencil;
            const double* const b = values + e * entries;
            change[e * n + j] = product(a + first, near + first, stencil - first)
                + product(b + firsts[j], border + firsts[j], firsts[j + 1] - firsts[j]);
        }
    }
}

/* Adds the derivatives of the same equations times `force`, (count, n), to those by positions and
   by each value. */
void add_gradients(
    const double* by_position, const double* values, const long* firsts, const double* force,
    double* position, double* border, long begin, long end, long n, long slots, long order)
{
    const long stencil = slots * n, entries = firsts[n];
    for (long e = begin; e < end; ++e) {
        const long first = e < order ? (order - e) * n : 0;
        double* const near = position + (e - order) * n;
        for (long j = 0; j < n; ++j) {
            const double factor = force[e * n + j];
            const double* const a = by_position + (e * n + j) * stencil;
            const double* const b = values + e * entries;
            add_product(factor, a + first, near + first, stencil - first);
            add_product(factor, b + firsts[j], border + firsts[j], firsts[j + 1] - firsts[j]);
        }
    }
}
"""
)
