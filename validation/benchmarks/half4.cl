/* The sampler as one writes it by the book: three half4 textures and a 16-bit weight, eight vload_half4 from each, seven lerps, positions in
 * float from the origin. What sampler.cl is compared with; same results to a few ulp of its half floats, near the origin.
 */
#define MIN_WEIGHT (1.0f / 1024.0f)

typedef struct { float4 red, green, blue; float weight; } Texel;

typedef struct {
    float4 origin_inverse; /* origin, m, and 1 / finest voxel, 1/m */
    float4 extent;         /* finest voxels, and the exposure that stored light is multiplied by */
    int4 cache_level;      /* tiles per axis of the cache, and L */
} Grid;

#define CACHE global const half *red, global const half *green, global const half *blue, global const ushort *weight
#define CACHE_ARGS red, green, blue, weight

static Texel load(CACHE, int i) {
    Texel t = {vload_half4(i, red), vload_half4(i, green), vload_half4(i, blue), (float)weight[i] / 65535.0f};
    return t;
}

static Texel mixed(Texel a, Texel b, float f) {
    Texel t = {mix(a.red, b.red, f), mix(a.green, b.green, f), mix(a.blue, b.blue, f), mix(a.weight, b.weight, f)};
    return t;
}

static Texel interpolated(CACHE, int3 v, float3 f, int4 cache) {
    int dy = cache.x * 3, dz = dy * cache.y * 3;
    int i = v.x + v.y * dy + v.z * dz;
    Texel face[2];
    for (int x = 0; x < 2; ++x) {
        Texel a = mixed(load(CACHE_ARGS, i + x), load(CACHE_ARGS, i + x + dz), f.z);
        Texel b = mixed(load(CACHE_ARGS, i + x + dy), load(CACHE_ARGS, i + x + dy + dz), f.z);
        face[x] = mixed(a, b, f.y);
    }
    return mixed(face[0], face[1], f.x);
}

static int3 tile_cell(float3 q, float edge, int3 dims) {
    return min(convert_int3_rtz(q / edge), dims - 1);
}

kernel void sample_half4(CACHE, global const uint *indirection, global const int *lods, Grid grid, global const float *positions,
                         global const float *normals, global float *irradiance, global int *levels, global float *weights) {
    int id = get_global_id(0);
    float3 n = vload3(id, normals);
    float3 q = clamp((vload3(id, positions) - grid.origin_inverse.xyz) * grid.origin_inverse.w, 0.0f, grid.extent.xyz);
    int finest = grid.cache_level.w, level = 0;
    Texel t;
    for (int ask = finest; ask >= 1; ask = level - 1) {
        int4 l = vload4(ask - 1, lods);
        int3 cell = tile_cell(q, (float)(1 << (finest - ask + 1)), l.yzw);
        uint texel = indirection[l.x + (cell.x * l.z + cell.y) * l.w + cell.z];
        level = texel >> 24;
        int3 offset = (int3)(texel & 255, (texel >> 8) & 255, (texel >> 16) & 255);
        float size = (float)(1 << (finest - level));
        float3 base = convert_float3(tile_cell(q, 2.0f * size, vload4(level - 1, lods).yzw)) * (2.0f * size);
        float3 voxel = clamp(floor((q - base) / size), 0.0f, 1.0f);
        float3 f = clamp((q - base) / size - voxel, 0.0f, 1.0f);
        t = interpolated(CACHE_ARGS, offset * 3 + convert_int3(voxel), f, grid.cache_level);
        if (t.weight >= MIN_WEIGHT) break;
        if (level == 1) { level = 0; break; }
    }
    float4 w = (float4)(IRRADIANCE_W0, IRRADIANCE_W1 * n.y, IRRADIANCE_W1 * n.z, IRRADIANCE_W1 * n.x);
    float3 e = (float3)(dot(w, t.red), dot(w, t.green), dot(w, t.blue));
    vstore3(level > 0 ? e * grid.extent.w / t.weight : (float3)(0.0f), id, irradiance);
    levels[id] = level;
    weights[id] = level > 0 ? t.weight : 0.0f;
}

/* The floor: what any sampler reads and writes for a sample, and nothing between. */
kernel void stream(global const float *positions, global const float *normals, global float *irradiance, global int *levels,
                   global float *weights) {
    const size_t id = get_global_id(0);
    const float x = positions[3 * id] + normals[3 * id], y = positions[3 * id + 1] + normals[3 * id + 1],
                z = positions[3 * id + 2] + normals[3 * id + 2];
    irradiance[3 * id] = x;
    irradiance[3 * id + 1] = y;
    irradiance[3 * id + 2] = z;
    levels[id] = (int)x;
    weights[id] = y;
}
