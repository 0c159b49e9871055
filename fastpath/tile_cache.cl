/* Filling tiles of the cache in place: real probes' light where they stand, virtual probes interpolated from the parent tile.
 * The slow twin is fill_tiles in reference/volume/tiles.py; the host side is tile_cache.py.
 *
 *   texel = weight · light(probe)                    real; a probe of which no light is known has weight 0
 *   texel = trilinear of the parent tile's texels    virtual, at (octant + t / 2) of the parent; premultiplied (failure-catalogue D3)
 *   stored = half(texel / exposure)                  a rounded weight takes the light along: their quotient stays the probe's own
 *
 * One work item per texel, one launch per level, coarse to fine. Parents are read as they are stored, so a fine tile's border agrees
 * with what its coarse neighbour holds. Layouts: common.clh. Images cannot be read and written in one launch: -D IMAGES fills a
 * staging buffer, and `place` writes that into the images.
 *
 * -D COMPONENTS=4|9: SH of a probe, three colours each. Light that is not finite counts as unknown: the filters of neighbours may touch
 * any texel with weight 0, and 0 times infinity is not 0 (failure-catalogue E2).
 */
#include "common.clh"

#define VIRTUAL (-1)

typedef struct {
    Texel first;  /* 12 of order 1, then the weight */
    Texel second; /* 15 of order 2 */
} Whole;

INLINE Whole nothing(void) {
    Whole t = {(Texel)(0.0f), (Texel)(0.0f)};
    return t;
}

/* Light of a probe with weight 1, or nothing where it is not known. probes (P, COMPONENTS, 3). */
INLINE Whole real(global const float *restrict probes, int probe, float exposure) {
    if (probe < 0) return nothing();
    global const float *p = probes + (long)probe * (3 * COMPONENTS);
    Whole t = nothing();
    t.first = (Texel)(p[0], p[3], p[6], p[9], p[1], p[4], p[7], p[10], p[2], p[5], p[8], p[11], exposure, 0.0f, 0.0f, 0.0f);
    bool known = isfinite_all(t.first);
#if COMPONENTS == 9
    p += 12;
    t.second = (Texel)(p[0], p[3], p[6], p[9], p[12], p[1], p[4], p[7], p[10], p[13], p[2], p[5], p[8], p[11], p[14], 0.0f);
    known = known && isfinite_all(t.second);
#endif
    if (!known) return nothing();
    t.first /= exposure; /* a power of two; the weight becomes 1 */
    t.second /= exposure;
    return t;
}

/* What storage keeps of a weight. */
INLINE float kept(float weight) {
#pragma OPENCL FP_CONTRACT OFF
#if !defined(HALF_LIGHT)
    return weight;
#elif defined(PACKED) || defined(HALF_WEIGHT)
    const uint bits = as_uint(weight); /* to the nearest half, ties to even; under 2^-14 those are multiples of 2^-24 */
    const float normal = as_float((bits + 0xfff + ((bits >> 13) & 1)) & 0xffffe000u);
    const float subnormal = (weight + 0.75f) - 0.75f;
    return weight >= 6.103515625e-5f ? normal : subnormal;
#else
    const float product = weight * WEIGHT_SCALE; /* to the nearest whole number, ties to even */
    return ((product + 8388608.0f) - 8388608.0f) / WEIGHT_SCALE;
#endif
}

#ifdef PACKED
#define HELD global LIGHT *light, global LIGHT *more
#define HELD_ARGS light, more
INLINE Whole held_texel(HELD, int slot, int texel, int4 cache) {
    Whole t = nothing();
    const long at = ((long)slot * TEXELS + texel) * PACKED_SIZE;
    t.first = load16(light + at);
#if COMPONENTS == 9
    t.second = load16(more + at);
#endif
    return t;
}
#else
#define HELD read_only image3d_t red, read_only image3d_t green, read_only image3d_t blue, read_only image3d_t weight, \
    global float *staging
#define HELD_ARGS red, green, blue, weight, staging
/* Place of a texel in the images. */
INLINE int4 in_images(int slot, int texel, int4 cache) {
    return (int4)(3 * (slot % cache.x) + texel / 9, 3 * (slot / cache.x % cache.y) + texel / 3 % 3,
                  3 * (slot / (cache.x * cache.y)) + texel % 3, 0);
}

INLINE Whole held_texel(HELD, int slot, int texel, int4 cache) {
    const int4 at = in_images(slot, texel, cache);
    Whole t = nothing();
    t.first = (Texel)(read_imagef(red, at), read_imagef(green, at), read_imagef(blue, at), read_imagef(weight, at).x,
                      0.0f, 0.0f, 0.0f);
    return t;
}
#endif

/* One axis of a virtual texel: lower texel and fraction, from its place in halves of the parent's texels, 0 … 4. */
INLINE int lower(int halves) { return halves >= 2 ? 1 : 0; }

/* A virtual probe of the tile in the parent's voxel `octant`; of the root (parent < 0) from its own corners, `sources` (27). */
INLINE Whole interpolated_from(HELD, int parent, int octant, int texel, global const int *restrict sources,
                               global const float *restrict probes, int4 cache, float exposure) {
    const int3 t = (int3)(texel / 9, texel / 3 % 3, texel % 3);
    const int3 voxel = (int3)(octant >> 2, (octant >> 1) & 1, octant & 1);
    const bool root = parent < 0;
    const int3 at = root ? t : 2 * voxel + t; /* halves of the parent's texels, or of the root's corners */
    const int3 base = root ? (int3)(0) : (int3)(lower(at.x), lower(at.y), lower(at.z));
    const float3 f = (float3)(0.5f * (float)(at.x - 2 * base.x), 0.5f * (float)(at.y - 2 * base.y), 0.5f * (float)(at.z - 2 * base.z));
    const int step = root ? 2 : 1;
    Whole sum = nothing();
    for (int corner = 0; corner < 8; ++corner) {
        const int cx = corner >> 2, cy = (corner >> 1) & 1, cz = corner & 1;
        const float share = (cx ? f.x : 1.0f - f.x) * (cy ? f.y : 1.0f - f.y) * (cz ? f.z : 1.0f - f.z);
        if (share == 0.0f) continue;
        const int from = (base.x + step * cx) * 9 + (base.y + step * cy) * 3 + base.z + step * cz;
        const Whole c = root ? real(probes, sources[from], exposure) : held_texel(HELD_ARGS, parent, from, cache);
        sum.first += c.first * share;
        sum.second += c.second * share;
    }
    return sum;
}

/* Largest finite absolute value that each work item meets in the light of the `count` probes that are listed. */
kernel void brightest(global const float *restrict probes, global const int *restrict used, int count,
                      global float *restrict found) {
    float most = 0.0f;
    for (int i = get_global_id(0); i < count; i += get_global_size(0)) {
        global const float *p = probes + (long)used[i] * (3 * COMPONENTS);
        for (int k = 0; k < 3 * COMPONENTS; ++k) {
            const float x = p[k] < 0.0f ? -p[k] : p[k];
            most = x > most && x < INFINITY ? x : most;
        }
    }
    found[get_global_id(0)] = most;
}

/* Tiles `first` … of the lists, all of one level: slot; x: the parent's slot, y: octant; 27 sources; cell and level. */
kernel void fill(HELD, global const int *restrict slots, global const int2 *restrict above,
                 global const int *restrict sources, global const int4 *restrict places, global const float *restrict probes,
                 global int4 *restrict owners, int first, int4 cache, float exposure) {
    const int tile = first + get_global_id(0) / TEXELS, texel = get_global_id(0) % TEXELS, slot = slots[tile];
    global const int *own = sources + (long)tile * TEXELS;
    const int source = own[texel];
    Whole t = source == VIRTUAL ? interpolated_from(HELD_ARGS, above[tile].x, above[tile].y, texel, own, probes, cache, exposure)
                                : real(probes, source, exposure);
    const float exact = t.first.sc, stored = kept(exact), ratio = exact > 0.0f ? stored / exact : 1.0f;
    t.first *= ratio;
    t.second *= ratio;
    t.first.sc = stored;
#ifdef PACKED
    const long at = ((long)slot * TEXELS + texel) * PACKED_SIZE;
    store16(light + at, t.first);
#if COMPONENTS == 9
    store16(more + at, t.second);
#endif
#else
    *(global float16 *)(staging + (long)get_global_id(0) * PACKED_SIZE) = t.first;
#endif
    if (texel == 0) owners[slot] = places[tile];
}

#ifdef IMAGES
/* Staged texels (n, 27, 16) into the images. */
kernel void place(write_only image3d_t red, write_only image3d_t green, write_only image3d_t blue, write_only image3d_t weight,
                  global const float *restrict staging, global const int *restrict slots, int first, int4 cache) {
    const size_t id = get_global_id(0);
    const int4 at = in_images(slots[first + id / TEXELS], id % TEXELS, cache);
    const float16 t = *(global const float16 *)(staging + id * PACKED_SIZE);
    write_imagef(red, at, t.s0123);
    write_imagef(green, at, t.s4567);
    write_imagef(blue, at, t.s89ab);
    write_imagef(weight, at, (float4)(t.sc));
}
#endif
