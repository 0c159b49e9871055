/* One sample of the 3D virtual texture per work item: the kernel whose specification is reference/volume/sampler.py.
 *
 *   cell, fraction = position on the lattice of finest voxels, integer and rest
 *   texel = indirection[lod][cell / tile edge]      8 bits of tile offset per axis, 8 bits of level
 *   (light, weight) = trilinear                     light is premultiplied by the weight
 *   E(n) = reconstruction(light / weight, n)
 *
 * -D LOD_ALL | LOD_OWN | LOD_DISTANCE: all samples ask for one level of detail, each for its own, or by distance from the viewer;
 * -D BLEND: mixed with the next coarser one near the far end of each ring. -D CLIPMAP: the indirection is a window of 2^n texels per axis
 * and level of detail that wraps around (see clipmap.cl), otherwise one texture over the whole extent. -D OWNERS: the number of samples
 * whose tile belongs to another place is counted per work item into `wrong`. Layouts: common.clh.
 *
 * Floor, CPU, packed half: 44 bytes of position, normal and result stream through memory, 8 texels of 32 bytes come from caches;
 * 16 conversions and 16 multiply-adds of eight numbers, about 50 cycles. Measured: README, "The fast path".
 */
#include "common.clh"
#include "reconstruct.clh"

#pragma OPENCL FP_CONTRACT ON
#define MIN_WEIGHT (1.0f / 1024.0f)

#ifdef CLIPMAP
/* lods: per level of detail the first tile cell of its window. */
INLINE bool covered(int3 tile, int lod, global const int4 *restrict lods, int4 cache) {
    const int4 window = lods[lod - 1];
    const uint side = 1u << cache.w;
    return (uint)(tile.x - window.x) < side && (uint)(tile.y - window.y) < side && (uint)(tile.z - window.z) < side;
}

INLINE uint pointer(int3 tile, int lod, global const uint *restrict indirection, global const int4 *restrict lods, int4 cache) {
    const int mask = (1 << cache.w) - 1;
    const int row = (((lod - 1) << cache.w | (tile.x & mask)) << cache.w | (tile.y & mask)) << cache.w;
    return indirection[row | (tile.z & mask)];
}
#else
/* lods: per level of detail the first texel and the dimensions. */
INLINE uint pointer(int3 tile, int lod, global const uint *restrict indirection, global const int4 *restrict lods, int4 cache) {
    const int4 l = lods[lod - 1];
    return indirection[l.x + (tile.x * l.z + tile.y) * l.w + tile.z];
}
#endif

typedef struct {
    Texel light;
    Texel band2;
    int level; /* that answered; 0: none did */
    int wrong;
} Found;

#ifdef BAND2
#define SAMPLED CACHE, global const LIGHT *restrict more
#define SAMPLED_ARGS CACHE_ARGS, more
#else
#define SAMPLED CACHE
#define SAMPLED_ARGS CACHE_ARGS
#endif

#ifdef OWNERS
#define OWNERS_PARAMETER , global const int4 *restrict owners, global int *restrict wrong
#define OWNERS_ARGS , owners
#define OWNERS_OF , global const int4 *restrict owners
#else
#define OWNERS_PARAMETER
#define OWNERS_ARGS
#define OWNERS_OF
#endif

INLINE Found found_at(SAMPLED, const Grid *grid, Place at, int lod, global const uint *restrict indirection,
                      global const int4 *restrict lods OWNERS_OF) {
    const int finest = grid->anchor_cell.w;
    Found found;
    found.light = found.band2 = (Texel)(0.0f);
    found.level = found.wrong = 0;
    for (int ask = lod; ask >= 1;) {
        const int up = finest - ask + 1;
        const int3 asked = (int3)(at.cell.x >> up, at.cell.y >> up, at.cell.z >> up);
#ifdef CLIPMAP
        if (!covered(asked, ask, lods, grid->cache)) {
            ask -= 1;
            continue;
        }
#endif
        const uint texel = pointer(asked, ask, indirection, lods, grid->cache);
        const int level = texel >> 24;
#ifdef CLIPMAP
        if (level == 0) break; /* nothing is resident here */
#endif
        const int s = finest - level;
        const int3 offset = (int3)(texel & 255, (texel >> 8) & 255, (texel >> 16) & 255);
        const int3 voxel = (int3)((at.cell.x >> s) & 1, (at.cell.y >> s) & 1, (at.cell.z >> s) & 1);
        const float size = as_float((127 - s) << 23);
        const int mask = (1 << s) - 1;
        const float3 f = (float3)(((float)(at.cell.x & mask) + at.fraction.x) * size,
                                  ((float)(at.cell.y & mask) + at.fraction.y) * size,
                                  ((float)(at.cell.z & mask) + at.fraction.z) * size);
        const Texel t = interpolated(CACHE_ARGS, offset, voxel, f, grid->cache);
#ifdef OWNERS
        const int4 owner = owners[offset.x + grid->cache.x * (offset.y + grid->cache.y * offset.z)];
        found.wrong += owner.w != level || owner.x != at.cell.x >> (s + 1) || owner.y != at.cell.y >> (s + 1) ||
                       owner.z != at.cell.z >> (s + 1);
#endif
        if (t.sc >= MIN_WEIGHT) {
            found.light = t;
#ifdef BAND2
            found.band2 = interpolated(more, offset, voxel, f, grid->cache); /* packed layout only */
#endif
            found.level = level;
            break;
        }
        ask = level - 1;
    }
    return found;
}

INLINE float3 irradiance_of(Found found, float scale, float3 n) {
    if (found.level == 0) return (float3)(0.0f);
    return reconstructed(found.light, found.band2, 1.0f / found.light.sc, n.x, n.y, n.z) * scale;
}

kernel void sample(SAMPLED, global const uint *restrict indirection, global const int4 *restrict lods, Grid grid,
#ifdef LOD_OWN
                   global const int *restrict own_lods,
#endif
                   global const float *restrict positions, global const float *restrict normals,
                   global float *restrict irradiance, global int *restrict levels,
                   global float *restrict weights OWNERS_PARAMETER) {
    const size_t id = get_global_id(0);
    const float3 p = (float3)(positions[3 * id], positions[3 * id + 1], positions[3 * id + 2]);
    if (p.x != p.x || p.y != p.y || p.z != p.z) {
        irradiance[3 * id] = irradiance[3 * id + 1] = irradiance[3 * id + 2] = NAN;
        levels[id] = 0;
        weights[id] = 0.0f;
#ifdef OWNERS
        wrong[id] = 0;
#endif
        return;
    }
    const float3 n = (float3)(normals[3 * id], normals[3 * id + 1], normals[3 * id + 2]);
    const Place at = placed(&grid, p);
#if defined(LOD_OWN)
    const int lod = own_lods[id];
#elif defined(LOD_DISTANCE)
    const float square = ring_square(&grid, p);
    const int ring = ring_of(square);
    const int lod = grid.anchor_cell.w - ring < 1 ? 1 : grid.anchor_cell.w - ring;
#else
    const int lod = grid.extent.w;
#endif
    Found found = found_at(SAMPLED_ARGS, &grid, at, lod, indirection, lods OWNERS_ARGS);
    float3 e = irradiance_of(found, grid.scale.x, n);
#ifdef BLEND
    const float t = lod > 1 ? blended(&grid, square, ring) : 0.0f;
    if (t > 0.0f && found.level > 0) {
        const Found next = found_at(SAMPLED_ARGS, &grid, at, lod - 1, indirection, lods OWNERS_ARGS);
        found.wrong += next.wrong;
        if (next.level > 0) e = e * (1.0f - t) + irradiance_of(next, grid.scale.x, n) * t;
    }
#endif
    irradiance[3 * id] = e.x;
    irradiance[3 * id + 1] = e.y;
    irradiance[3 * id + 2] = e.z;
    levels[id] = found.level;
    weights[id] = found.light.sc;
#ifdef OWNERS
    wrong[id] = found.wrong;
#endif
}
