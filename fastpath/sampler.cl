/* Samples of the 3D virtual texture: the kernel whose specification is reference/volume/sampler.py.
 *
 *   cell, fraction = position on the lattice of finest voxels, integer and rest
 *   texel = indirection[lod][cell / tile edge]      8 bits of tile offset per axis, 8 bits of level
 *   (light, weight) = trilinear                     light is premultiplied by the weight
 *   E(n) = reconstruction(light / weight, n)
 *
 * -D LOD_ALL | LOD_OWN | LOD_DISTANCE: all samples ask for one level of detail, each for its own, or by distance from the viewer;
 * -D BLEND: mixed with the next coarser one near the far end of each ring. -D CLIPMAP: see voxels.clh. -D OWNERS: the number of samples
 * whose tile belongs to another place is counted per work item into `wrong`. Layouts: common.clh.
 *
 * Floor, CPU, packed half: 44 bytes of position, normal and result stream through memory, 8 texels of 32 bytes come from caches;
 * 16 conversions and 16 multiply-adds of eight numbers, about 50 cycles. Measured: README, "The fast path".
 */
#include "common.clh"
#include "voxels.clh"
#include "reconstruct.clh"

#pragma OPENCL FP_CONTRACT ON

#ifndef LANES
#define LANES 1
#endif
#ifndef BATCH
#define BATCH 1 /* groups of LANES samples that a work item takes */
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

/* 1 if the slot that a voxel was read from holds the tile of another place. */
INLINE int belongs_elsewhere(const Grid *grid, Place at, Voxel v, global const int4 *restrict owners) {
    const int4 owner = owners[slot_of(v.offset, grid->cache)];
    const int3 own = tile_of(grid, at, v.level);
    return owner.w != v.level || owner.x != own.x || owner.y != own.y || owner.z != own.z;
}

INLINE Found found_at(SAMPLED, const Grid *grid, Place at, int lod, global const uint *restrict indirection,
                      global const int4 *restrict lods OWNERS_OF) {
    Found found;
    found.light = found.band2 = (Texel)(0.0f);
    found.level = found.wrong = 0;
    for (int ask = lod; ask >= 1;) {
        const int3 asked = tile_of(grid, at, ask);
#ifdef CLIPMAP
        if (!covered(asked, ask, lods, grid->cache)) {
            ask -= 1;
            continue;
        }
#endif
        const Voxel v = voxel_at(grid, at, pointer(asked, ask, indirection, lods, grid->cache));
#ifdef CLIPMAP
        if (v.level == 0) break; /* nothing is resident here */
#endif
        const Texel t = interpolated(CACHE_ARGS, v.offset, v.voxel, v.f, grid->cache);
#ifdef OWNERS
        found.wrong += belongs_elsewhere(grid, at, v, owners);
#endif
        if (t.sc >= MIN_WEIGHT) {
            found.light = t;
#ifdef BAND2
            found.band2 = interpolated(more, v.offset, v.voxel, v.f, grid->cache); /* packed layout only */
#endif
            found.level = v.level;
            break;
        }
        ask = v.level - 1;
    }
    return found;
}

INLINE float3 irradiance_of(Found found, float scale, float3 n) {
    if (found.level == 0) return (float3)(0.0f);
    return reconstructed(found.light, found.band2, 1.0f / found.light.sc, n.x, n.y, n.z) * scale;
}

#ifdef LOD_OWN
#define OWN_LODS_PARAMETER global const int *restrict own_lods,
#define OWN_LODS own_lods,
#else
#define OWN_LODS_PARAMETER
#define OWN_LODS
#endif
#ifdef OWNERS
#define WRONG_ARGS , owners, wrong
#else
#define WRONG_ARGS
#endif
#define OUTPUTS global float *restrict irradiance, global int *restrict levels, global float *restrict weights

#if LANES == 8 && defined(__clang__) && defined(__has_builtin)
#if __has_builtin(__builtin_convertvector)
#define SIDE_BY_SIDE
#include "groups.clh"
#endif
#endif

/* Sample number `id`. */
INLINE void one(SAMPLED, const Grid *grid, global const uint *restrict indirection, global const int4 *restrict lods,
                OWN_LODS_PARAMETER global const float *restrict positions, global const float *restrict normals, size_t id,
                OUTPUTS OWNERS_PARAMETER) {
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
    const Place at = placed(grid, p);
#if defined(LOD_OWN)
    const int lod = own_lods[id];
#elif defined(LOD_DISTANCE)
    const float square = ring_square(grid, p);
    const int ring = ring_of(square);
    const int lod = grid->anchor_cell.w - ring < 1 ? 1 : grid->anchor_cell.w - ring;
#else
    const int lod = grid->extent.w;
#endif
    Found found = found_at(SAMPLED_ARGS, grid, at, lod, indirection, lods OWNERS_ARGS);
    float3 e = irradiance_of(found, grid->scale.x, n);
#ifdef BLEND
    const float t = lod > 1 ? blended(grid, square, ring) : 0.0f;
    if (t > 0.0f && found.level > 0) {
        const Found next = found_at(SAMPLED_ARGS, grid, at, lod - 1, indirection, lods OWNERS_ARGS);
        found.wrong += next.wrong;
        if (next.level > 0) e = e * (1.0f - t) + irradiance_of(next, grid->scale.x, n) * t;
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

/* LANES samples per work item, BATCH times as many side by side; `count` in all. */
kernel void sample(SAMPLED, global const uint *restrict indirection, global const int4 *restrict lods, Grid grid,
                   OWN_LODS_PARAMETER global const float *restrict positions, global const float *restrict normals,
                   OUTPUTS, int count OWNERS_PARAMETER) {
    const size_t begin = get_global_id(0) * (LANES * BATCH);
    if (begin >= (size_t)count) return;
    const int here = begin + LANES * BATCH <= (size_t)count ? LANES * BATCH : (int)((size_t)count - begin);
#ifdef SIDE_BY_SIDE
    Eight groups[BATCH];
    const int whole = here / LANES;
    sample_groups(CACHE_ARGS, groups, whole, &grid, indirection, lods, OWN_LODS positions, normals, begin, count > CACHED, irradiance,
                  levels, weights WRONG_ARGS);
    if (here % LANES) groups[whole].lanes = (1 << here % LANES) - 1;
    for (int i = 0; i < here; i += LANES)
        for (int left = groups[i / LANES].lanes; left; left &= left - 1)
            one(SAMPLED_ARGS, &grid, indirection, lods, OWN_LODS positions, normals, begin + i + __builtin_ctz(left), irradiance, levels,
                weights WRONG_ARGS);
#else
    for (int i = 0; i < here; ++i)
        one(SAMPLED_ARGS, &grid, indirection, lods, OWN_LODS positions, normals, begin + i, irradiance, levels, weights WRONG_ARGS);
#endif
}
