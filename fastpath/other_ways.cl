/* Other ways to read the same probes, to hold beside sampler.cl. Specifications: reference/volume/other_ways*.py.
 *
 *   -D WAY=0  fixed point   the plain sampler with fractions of FRACTION_BITS bits
 *          1  chebyshev     eight texels, each weighted by facing and by what its probe sees (octahedral maps of SIDE² texels)
 *          2  ratio         16 bytes a texel: three halves of L0, nine bytes of L1 / L0 times weight, one of weight; filtered, then decoded
 *          3  light         what is at a place, as radiance SH: for one sample per mesh
 *
 * Tiles are packed (common.clh). All level decisions are the plain sampler's: the finest tile whose trilinear weight is MIN_WEIGHT or more.
 * Contraction is off where the plain twin would see the difference.
 */
#include "common.clh"
#include "voxels.clh"
#include "reconstruct.clh"

#pragma OPENCL FP_CONTRACT OFF

/* Number of the texel at the voxel's lower corner, tile by tile. */
INLINE long first_texel(Voxel v, int4 cache) {
    return (long)slot_of(v.offset, cache) * TEXELS + v.voxel.x * 9 + v.voxel.y * 3 + v.voxel.z;
}

INLINE float share_of(float3 f, int corner) {
    const float x = corner & 4 ? f.x : 1.0f - f.x, y = corner & 2 ? f.y : 1.0f - f.y, z = corner & 1 ? f.z : 1.0f - f.z;
    return (x * y) * z;
}

INLINE int corner_texel(int corner) { return (corner >> 2) * 9 + ((corner >> 1) & 1) * 3 + (corner & 1); }

#if WAY == 0 || WAY == 3
#define WAY_PARAMETERS CACHE
#define WAY_ARGS CACHE_ARGS
INLINE float fixed(float f) {
#ifdef FRACTION_BITS
    return (float)(int)(f * (float)(1 << FRACTION_BITS) + 0.5f) * (1.0f / (float)(1 << FRACTION_BITS));
#else
    return f;
#endif
}
INLINE Texel read_voxel(WAY_PARAMETERS, Voxel v, int4 cache, float3 n, float *plain) {
    const float3 f = (float3)(fixed(v.f.x), fixed(v.f.y), fixed(v.f.z));
    const Texel t = interpolated(CACHE_ARGS, v.offset, v.voxel, f, cache);
    *plain = t.sc;
    return t;
}
#endif

#if WAY == 1
#define WAY_PARAMETERS CACHE, global const half *restrict moments, global const int *restrict numbers
#define WAY_ARGS CACHE_ARGS, moments, numbers
#if defined(__clang__) && defined(__has_builtin)
#if __has_builtin(__builtin_convertvector)
typedef half Half2 __attribute__((ext_vector_type(2)));
#define MOMENTS(at) __builtin_convertvector(*(global const Half2 *)(at), float2)
#endif
#endif
#ifndef MOMENTS
#define MOMENTS(at) vload_half2(0, at)
#endif
INLINE float absolute(float x) { return as_float(as_int(x) & 0x7fffffff); }

/* Mean and mean squared distance towards (x, y, z), between the texels of an octahedral map with a border. */
INLINE float2 distances(global const half *restrict map, float x, float y, float z) {
    const float sum = (absolute(x) + absolute(y)) + absolute(z);
    float u = x / sum, v = y / sum;
    if (z / sum < 0.0f) {
        const float a = (1.0f - absolute(v)) * (u >= 0.0f ? 1.0f : -1.0f);
        v = (1.0f - absolute(u)) * (v >= 0.0f ? 1.0f : -1.0f);
        u = a;
    }
    u = (u * 0.5f + 0.5f) * (float)(SIDE - 2) + 0.5f;
    v = (v * 0.5f + 0.5f) * (float)(SIDE - 2) + 0.5f;
    const int i = (int)u, j = (int)v;
    const float fu = u - (float)i, fv = v - (float)j, gu = 1.0f - fu, gv = 1.0f - fv;
    global const half *at = map + 2 * (i * SIDE + j);
    const float2 low = MOMENTS(at) * gv + MOMENTS(at + 2) * fv;
    const float2 high = MOMENTS(at + 2 * SIDE) * gv + MOMENTS(at + 2 * SIDE + 2) * fv;
    return low * gu + high * fu;
}

/* Weight of a probe that lies (x, y, z) voxels from the sample. */
INLINE float visibility(global const half *restrict map, float x, float y, float z, float3 n) {
    const float distance = sqrt((x * x + y * y) + z * z);
    const bool near = distance < 1e-6f;
    const float along = (x * n.x + y * n.y) + z * n.z;
    const float facing = (along / (near ? 1.0f : distance) + 1.0f) * 0.5f;
    const float2 seen = distances(map, near ? 0.0f : -x, near ? 0.0f : -y, near ? 1.0f : -z);
    const float mean = seen.x, square = mean * mean, beyond = distance - mean;
    const float spread = seen.y - square, least = square * LEAST_VARIANCE;
    const float variance = spread > least ? spread : least;
    const float bound = beyond > 0.0f ? variance / (variance + beyond * beyond) : 1.0f;
    const float cubed = (bound * bound) * bound;
    const float u = (facing * facing + 0.2f) * (cubed > 0.05f ? cubed : 0.05f);
    return u < 0.2f ? u * (u * u) / (0.2f * 0.2f) : u;
}

INLINE Texel read_voxel(WAY_PARAMETERS, Voxel v, int4 cache, float3 n, float *plain) {
    const long first = first_texel(v, cache);
    Texel sum = (Texel)(0.0f);
    float weight = 0.0f;
    for (int corner = 0; corner < 8; ++corner) {
        const long number = first + corner_texel(corner);
        const float share = share_of(v.f, corner);
        const Texel t = texel_at(CACHE_ARGS, number * PACKED_SIZE);
        const float weighted = t.sc * share;
        weight += weighted;
        if (weighted > 0.0f) {
            global const half *map = moments + (long)numbers[number] * (2 * SIDE * SIDE);
            const float x = (corner & 4 ? 1.0f : 0.0f) - v.f.x, y = (corner & 2 ? 1.0f : 0.0f) - v.f.y;
            const float z = (corner & 1 ? 1.0f : 0.0f) - v.f.z;
            sum += t * (share * visibility(map, x, y, z, n));
        }
    }
    *plain = weight;
    return sum;
}
#endif

#if WAY == 2
#define WAY_PARAMETERS global const uchar *restrict texels
#define WAY_ARGS texels
#define ROOT_3 1.7320508075688772f
typedef uchar Bytes16 __attribute__((ext_vector_type(16)));
#if defined(__clang__) && defined(__has_builtin)
#if __has_builtin(__builtin_convertvector)
typedef half Half4b __attribute__((ext_vector_type(4)));
#define BASE(at) __builtin_convertvector(*(global const Half4b *)(at), float4)
#define BYTES(at) __builtin_convertvector(*(global const Bytes16 *)(at), float16)
#endif
#endif
#ifndef BASE
#define BASE(at) vload_half4(0, (global const half *)(at))
#define BYTES(at) convert_float16(*(global const uchar16 *)(at))
#endif
/* The fourth "half" and the first six "bytes" are the other's: their lanes are not looked at. */
INLINE Texel read_voxel(WAY_PARAMETERS, Voxel v, int4 cache, float3 n, float *plain) {
    const long first = first_texel(v, cache);
    float4 base = (float4)(0.0f);
    float16 bytes = (float16)(0.0f), zero = (float16)(128.0f);
    zero.sf = 0.0f; /* the weight's */
    for (int corner = 0; corner < 8; ++corner) {
        global const uchar *at = texels + 16 * (first + corner_texel(corner));
        const float share = share_of(v.f, corner);
        base += BASE(at) * share;
        bytes += (BYTES(at) - zero) * share;
    }
    *plain = bytes.sf * (1.0f / 255.0f);
    const float16 ratio = bytes * (*plain >= MIN_WEIGHT ? ROOT_3 / (127.0f * *plain) : 0.0f);
    return (Texel)(base.x, base.x * ratio.s6, base.x * ratio.s7, base.x * ratio.s8, base.y, base.y * ratio.s9, base.y * ratio.sa,
                   base.y * ratio.sb, base.z, base.z * ratio.sc, base.z * ratio.sd, base.z * ratio.se, *plain, 0.0f, 0.0f, 0.0f);
}
#endif

#ifdef WAY
kernel void sample(WAY_PARAMETERS, global const uint *restrict indirection, global const int4 *restrict lods, Grid grid,
                   global const float *restrict positions, global const float *restrict normals, global float *restrict out,
                   global int *restrict levels, global float *restrict weights, int count) {
    const size_t id = get_global_id(0);
    if (id >= (size_t)count) return;
    const float3 p = (float3)(positions[3 * id], positions[3 * id + 1], positions[3 * id + 2]);
    const bool missing = p.x != p.x || p.y != p.y || p.z != p.z;
    const float3 n = (float3)(normals[3 * id], normals[3 * id + 1], normals[3 * id + 2]);
    Texel found = (Texel)(0.0f);
    int level = 0;
    if (!missing) {
        const Place at = placed(&grid, p);
        for (int ask = grid.anchor_cell.w; ask >= 1;) {
            const Voxel v = voxel_at(&grid, at, pointer(tile_of(&grid, at, ask), ask, indirection, lods, grid.cache));
            float plain;
            const Texel t = read_voxel(WAY_ARGS, v, grid.cache, n, &plain);
            if (plain >= MIN_WEIGHT) {
                found = t;
                level = v.level;
                break;
            }
            ask = v.level - 1;
        }
    }
    const float scale = level > 0 ? grid.scale.x / found.sc : 0.0f;
#if WAY == 3
    for (int i = 0; i < 12; ++i) out[12 * id + i] = missing ? NAN : ((const float *)&found)[i] * scale;
#else
    const float3 e = reconstructed(found, found, scale, n.x, n.y, n.z);
    out[3 * id] = missing ? NAN : e.x;
    out[3 * id + 1] = missing ? NAN : e.y;
    out[3 * id + 2] = missing ? NAN : e.z;
#endif
    levels[id] = level;
    weights[id] = found.sc;
}
#endif

/* Pixels that take the light (12 coefficients) of their mesh. */
kernel void per_mesh(global const float4 *restrict light, global const int *restrict meshes, global const float *restrict normals,
                     global float *restrict out, int count) {
    const size_t id = get_global_id(0);
    if (id >= (size_t)count) return;
    global const float4 *at = light + 3 * meshes[id];
    const Texel t = (Texel)(at[0], at[1], at[2], (float4)(0.0f));
    const float3 e = reconstructed(t, t, 1.0f, normals[3 * id], normals[3 * id + 1], normals[3 * id + 2]);
    out[3 * id] = e.x;
    out[3 * id + 1] = e.y;
    out[3 * id + 2] = e.z;
}
