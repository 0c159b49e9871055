/* One sample of the 3D virtual texture per work item: the kernel whose specification is reference/volume/sampler.py.
 *
 *   q = (p - origin) / h, clamped          position in finest voxels
 *   texel = indirection[lod][q / edge]     8 bits of tile offset per axis, 8 bits of level
 *   (light, weight) = trilinear            light is premultiplied by the weight
 *   E(n) = sum_k w_k(n) light_k / weight
 *
 * -D LIGHT=float|half, WEIGHT=float|ushort|uchar, WEIGHT_SCALE: storage. -D IMAGES: the tile cache as three RGBA
 * images read through the linear sampler (what a GPU's texture units do), otherwise as buffers with eight loads.
 */
#pragma OPENCL FP_CONTRACT OFF

#define MIN_WEIGHT (1.0f / 1024.0f)

typedef struct { float4 red, green, blue; float weight; } Texel;

typedef struct {
    float4 origin_inverse;   /* origin, m, and 1 / finest voxel, 1/m */
    float4 extent;           /* finest voxels, and the exposure that stored light is multiplied by */
    int4 cache_level;        /* tiles per axis of the cache, and L */
} Grid;

#ifdef IMAGES
#define CACHE read_only image3d_t red, read_only image3d_t green, read_only image3d_t blue, \
    read_only image3d_t weight, sampler_t linear
#define CACHE_ARGS red, green, blue, weight, linear
#else
#define CACHE global const LIGHT *red, global const LIGHT *green, global const LIGHT *blue, global const WEIGHT *weight
#define CACHE_ARGS red, green, blue, weight
#endif

#ifndef IMAGES
static float4 load_light(global const LIGHT *texture, int i) {
#ifdef HALF_LIGHT
    return vload_half4(i, texture);
#else
    return vload4(i, texture);
#endif
}

static Texel load(CACHE, int i) {
    Texel t;
    t.red = load_light(red, i);
    t.green = load_light(green, i);
    t.blue = load_light(blue, i);
    t.weight = (float)weight[i] / WEIGHT_SCALE;
    return t;
}

static Texel mixed(Texel a, Texel b, float f) {
    Texel t;
    float g = 1.0f - f;
    t.red = a.red * g + b.red * f;
    t.green = a.green * g + b.green * f;
    t.blue = a.blue * g + b.blue * f;
    t.weight = a.weight * g + b.weight * f;
    return t;
}
#endif

/* Trilinear texel at tile coordinate x in [0, 2]^3 of the tile at `offset` in the cache. */
static Texel interpolate(CACHE, int3 offset, float3 voxel, float3 f, int4 cache) {
#ifdef IMAGES
    float3 at = convert_float3(offset * 3) + voxel + f + 0.5f;
    Texel t;
    t.red = read_imagef(red, linear, (float4)(at, 0.0f));
    t.green = read_imagef(green, linear, (float4)(at, 0.0f));
    t.blue = read_imagef(blue, linear, (float4)(at, 0.0f));
    t.weight = read_imagef(weight, linear, (float4)(at, 0.0f)).x;
    return t;
#else
    int3 v = offset * 3 + convert_int3(voxel);
    int dy = cache.x * 3, dz = dy * cache.y * 3;
    int i = v.x + v.y * dy + v.z * dz;
    Texel face[2];
    for (int x = 0; x < 2; ++x) {
        Texel a = mixed(load(CACHE_ARGS, i + x), load(CACHE_ARGS, i + x + dz), f.z);
        Texel b = mixed(load(CACHE_ARGS, i + x + dy), load(CACHE_ARGS, i + x + dy + dz), f.z);
        face[x] = mixed(a, b, f.y);
    }
    return mixed(face[0], face[1], f.x);
#endif
}

static int3 tile_cell(float3 q, float edge, int3 dims) {
    return min(convert_int3_rtz(q / edge), dims - 1);
}

kernel void sample(CACHE, global const uint *indirection, global const int *lods, Grid grid, int lod,
                   global const int *own_lods, global const float *positions, global const float *normals,
                   global float *irradiance, global int *levels, global float *weights) {
    int id = get_global_id(0);
    float3 p = vload3(id, positions);
    if (any(isnan(p))) {
        vstore3((float3)(NAN), id, irradiance);
        levels[id] = 0;
        weights[id] = 0.0f;
        return;
    }
    float3 n = vload3(id, normals);
    float3 q = clamp((p - grid.origin_inverse.xyz) * grid.origin_inverse.w, 0.0f, grid.extent.xyz);
    int finest = grid.cache_level.w;
    int level = 0;
    Texel t;
    t.red = t.green = t.blue = (float4)(0.0f);
    t.weight = 0.0f;
    /* own_lods: each sample's level of detail, null where all share `lod` */
    for (int ask = own_lods ? own_lods[id] : lod; ask >= 1; ask = level - 1) {
        /* lods holds, per LOD, the first texel and the dimensions */
        int4 l = vload4(ask - 1, lods);
        int3 cell = tile_cell(q, (float)(1 << (finest - ask + 1)), l.yzw);
        uint texel = indirection[l.x + (cell.x * l.z + cell.y) * l.w + cell.z];
        level = texel >> 24;
        int3 offset = (int3)(texel & 255, (texel >> 8) & 255, (texel >> 16) & 255);
        float half_edge = (float)(1 << (finest - level));
        int3 tile = tile_cell(q, 2.0f * half_edge, vload4(level - 1, lods).yzw);
        float3 base = convert_float3(tile) * (2.0f * half_edge);
        float3 voxel = clamp(floor((q - base) / half_edge), 0.0f, 1.0f);
        float3 f = clamp((q - base) / half_edge - voxel, 0.0f, 1.0f);
        t = interpolate(CACHE_ARGS, offset, voxel, f, grid.cache_level);
        if (t.weight >= MIN_WEIGHT) break;
        if (level == 1) { level = 0; break; }
    }
    float4 w = (float4)(IRRADIANCE_W0, IRRADIANCE_W1 * n.y, IRRADIANCE_W1 * n.z, IRRADIANCE_W1 * n.x);
    float3 e = (float3)(w.x * t.red.x + w.y * t.red.y + w.z * t.red.z + w.w * t.red.w,
                        w.x * t.green.x + w.y * t.green.y + w.z * t.green.z + w.w * t.green.w,
                        w.x * t.blue.x + w.y * t.blue.y + w.z * t.blue.z + w.w * t.blue.w);
    vstore3(level > 0 ? e * grid.extent.w / t.weight : (float3)(0.0f), id, irradiance);
    levels[id] = level;
    weights[id] = level > 0 ? t.weight : 0.0f;
}
