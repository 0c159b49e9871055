/* Products of sparse form-factor rows with light, and one bounce of radiosity: the host side is rows.py, the slow twin is
 * reference/transport/gather.py.
 *
 *   gather:  out_r = sum_j v_rj light_j                     K values v_rj per non-zero, three colours
 *   bounce:  B'_i  = M_i + albedo_i (E_i + sum_j F_ij B_j)
 *
 * -D COMPONENTS=1|4: K. -D LANES: work-items that share a row, one row to a work-group: 1 on a CPU, where one core
 * streams whole rows, 32 on a GPU, where neighbours must read neighbouring words. Light is RGBX, so one 128-bit load
 * serves three colours. A row is summed into ACCUMULATORS partial sums per lane, the tail into the first one, then pairwise:
 * independent chains hide the latency of the multiply-add, and the order never depends on threads.
 *
 * Written as a * b + c, not fma(): PoCL calls its fma() as a function, once per non-zero, which halves the speed; the
 * compiler contracts the plain form to the same instruction.
 *
 * Floor: 4 + 4 K bytes per non-zero, read once. Measured on two cores of an EPYC (Zen 3, PoCL, other work on the
 * machine, best of many interleaved repeats; 600 random columns per row), GB/s of the matrix:
 *
 *     np.copyto of 256 MB on two threads    16.4 copied, 33 read and written; reads alone 22 to 32
 *     K = 1, 20,000 rows                    21.4 from 2,200 columns, 16.0 from 20,200
 *     K = 4, 8,000 rows                     25.8 from 2,200 columns, 21.3 from 20,200
 *     SciPy's CSR product                   1.4 to 2.1 (K = 1), 1.1 to 1.3 (K = 4)
 *
 * The gap at 20,200 columns: the light no longer fits the first cache, so nearly every non-zero fetches a line for it.
 * Regrouping blocks of 128 rows by 2,048 columns won 15 to 20 %, 16-bit columns 5 to 10 %; neither was worth a second layout.
 * More accumulators, prefetches and light packed to 12 bytes won nothing or lost.
 * Memory bounds it: of the probe rows of the house (2.8 M non-zeros, K = 4, 4,835 columns) a kernel that reads and adds up, and
 * gathers nothing, took 2.2 to 2.8 ms, this one 2.0 to 2.5; pages of 2 MiB won nothing, 16 rows per work-group 4 %.
 */
#pragma OPENCL FP_CONTRACT ON

#if COMPONENTS == 1
#define ACCUMULATORS 8
typedef float Value;
typedef struct { float4 rgb; } Sum;
#else
#define ACCUMULATORS 2
typedef float4 Value;
typedef struct { float4 red, green, blue; } Sum; /* four components of each colour */
#endif

static Sum zero(void) {
    Sum s;
#if COMPONENTS == 1
    s.rgb = (float4)(0.0f);
#else
    s.red = s.green = s.blue = (float4)(0.0f);
#endif
    return s;
}

static Sum plus_product(Sum s, Value v, float4 light) {
#if COMPONENTS == 1
    s.rgb = v * light + s.rgb;
#else
    s.red = v * light.x + s.red;
    s.green = v * light.y + s.green;
    s.blue = v * light.z + s.blue;
#endif
    return s;
}

static Sum plus(Sum a, Sum b) {
#if COMPONENTS == 1
    a.rgb += b.rgb;
#else
    a.red += b.red;
    a.green += b.green;
    a.blue += b.blue;
#endif
    return a;
}

/* The part of row `row` that belongs to `lane`: non-zeros begin + lane, begin + lane + LANES, … */
static Sum lane_sum(global const long *restrict indptr, global const int *restrict columns,
                    global const Value *restrict values, global const float4 *restrict light, size_t row, int lane) {
    const long end = indptr[row + 1];
    long i = indptr[row] + lane;
    Sum partial[ACCUMULATORS];
#pragma unroll
    for (int a = 0; a < ACCUMULATORS; ++a) partial[a] = zero();
    for (; i + (ACCUMULATORS - 1) * LANES < end; i += ACCUMULATORS * LANES) {
#pragma unroll
        for (int a = 0; a < ACCUMULATORS; ++a)
            partial[a] = plus_product(partial[a], values[i + a * LANES], light[columns[i + a * LANES]]);
    }
    for (; i < end; i += LANES) partial[0] = plus_product(partial[0], values[i], light[columns[i]]);
#pragma unroll
    for (int half_way = ACCUMULATORS / 2; half_way > 0; half_way /= 2) {
#pragma unroll
        for (int a = 0; a < half_way; ++a) partial[a] = plus(partial[a], partial[a + half_way]);
    }
    return partial[0];
}

/* Sum of a whole row, known to lane 0. */
#if LANES == 1
#define ROW_SUM(total) Sum total = lane_sum(indptr, columns, values, light, get_group_id(0), 0)
#else
#define ROW_SUM(total)                                                                         \
    local Sum shared[LANES];                                                                   \
    const int lane = get_local_id(0);                                                          \
    shared[lane] = lane_sum(indptr, columns, values, light, get_group_id(0), lane);            \
    for (int half_way = LANES / 2; half_way > 0; half_way /= 2) {                              \
        barrier(CLK_LOCAL_MEM_FENCE);                                                          \
        if (lane < half_way) shared[lane] = plus(shared[lane], shared[lane + half_way]);       \
    }                                                                                          \
    if (lane != 0) return;                                                                     \
    const Sum total = shared[0]
#endif

#define ROWS_AND_LIGHT                                                                         \
    global const long *restrict indptr, global const int *restrict columns, global const Value *restrict values, \
    global const float4 *restrict light

/* out (R, K, 3), packed. */
kernel __attribute__((reqd_work_group_size(LANES, 1, 1)))
void gather(ROWS_AND_LIGHT, global float *restrict out) {
    ROW_SUM(total);
    global float *at = out + get_group_id(0) * (3 * COMPONENTS);
#if COMPONENTS == 1
    at[0] = total.rgb.x;
    at[1] = total.rgb.y;
    at[2] = total.rgb.z;
#else
    vstore4((float4)(total.red.x, total.green.x, total.blue.x, total.red.y), 0, at);
    vstore4((float4)(total.green.y, total.blue.y, total.red.z, total.green.z), 1, at);
    vstore4((float4)(total.blue.z, total.red.w, total.green.w, total.blue.w), 2, at);
#endif
}

#if COMPONENTS == 1
/* Row i of the light after one more bounce; everything RGBX. */
kernel __attribute__((reqd_work_group_size(LANES, 1, 1)))
void bounce(ROWS_AND_LIGHT, global const float4 *restrict albedo, global const float4 *restrict exitance,
            global const float4 *restrict direct, global float4 *restrict bounced) {
    ROW_SUM(total);
    const size_t i = get_group_id(0);
    bounced[i] = albedo[i] * (direct[i] + total.rgb) + exitance[i];
}
#endif
