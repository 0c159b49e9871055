/* The indirection clipmap: per level of detail a window of 2^n texels per axis around the viewer, addressed with wrap-around, so that
 * a window that moves keeps what it still covers and only what enters is written. The host side is clipmap.py, the slow twin
 * reference/volume/clipmap.py.
 *
 *   page[l][c]  = pointer of the tile of level l at cell c, 0 where none is resident
 *   texel[l][c] = page[l][c], or else texel[l - 1][c / 2]             the octree, flattened (talk, "Indirection texture")
 *
 * Windows nest: the parent of every cell in the window of l lies in that of l - 1. A texel is therefore found by walking up the pages,
 * all levels in one launch. Work comes as boxes of cells of one level each; an item finds its box by bisection of their starts.
 */

typedef struct {
    int level, x, y, z; /* first cell */
    int nx, ny, nz;     /* cells */
    int start;          /* cells of the boxes before this one */
} Box;

static inline int place_of(int level, int x, int y, int z, int window) {
    const int mask = (1 << window) - 1;
    return ((((level - 1) << window | (x & mask)) << window | (y & mask)) << window) | (z & mask);
}

/* Cell and level of work item i. */
static inline int4 cell_of(global const Box *restrict boxes, int count, int i) {
    int low = 0, high = count;
    while (high - low > 1) {
        const int middle = (low + high) >> 1;
        if (boxes[middle].start <= i) low = middle;
        else high = middle;
    }
    const Box box = boxes[low];
    const int at = i - box.start, row = at / box.nz;
    return (int4)(box.x + row / box.ny, box.y + row % box.ny, box.z + at % box.nz, box.level);
}

kernel void clear(global const Box *restrict boxes, int count, int cells, int window, global uint *restrict pages) {
    const int i = get_global_id(0);
    if (i >= cells) return;
    const int4 c = cell_of(boxes, count, i);
    pages[place_of(c.w, c.x, c.y, c.z, window)] = 0;
}

/* entries: place among the pages, and what goes there. */
kernel void enter(global const uint2 *restrict entries, int count, global uint *restrict pages) {
    const int i = get_global_id(0);
    if (i < count) pages[entries[i].x] = entries[i].y;
}

kernel void flatten(global const Box *restrict boxes, int count, int cells, int window, global const uint *restrict pages,
                    global uint *restrict texels) {
    const int i = get_global_id(0);
    if (i >= cells) return;
    const int4 c = cell_of(boxes, count, i);
    uint found = 0;
    for (int up = 0; up < c.w && found == 0; ++up) found = pages[place_of(c.w - up, c.x >> up, c.y >> up, c.z >> up, window)];
    texels[place_of(c.w, c.x, c.y, c.z, window)] = found;
}
