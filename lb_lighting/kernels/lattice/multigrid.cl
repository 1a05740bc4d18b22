// SPDX-License-Identifier: GPL-3.0-or-later
// Between a lattice and the coarser one of half its resolution: `restrict` and `prolongate` of the
// twin, transport/lattice/lattice_numpy.py. Built after lattice/layout.cl and lattice/lattice.cl.
//
// Both use two kernels, along z and across it, so that loads are contiguous. They process a few
// planes of the coarser lattice at a time, from `begin`, so that the buffer between the kernels,
// `parts`, stays in caches: (18 or more) x planes x ny_2 x nz.

#define PLACE                                                                              \
    const size_t z = get_global_id(0), y = get_global_id(1), layer = get_global_id(2)

// The light that has streamed from a cell along m.
#define FLOWED(m, back, cell, step) HERE(swapped ? (back) : (m), swapped ? (cell) : (cell) + (step))

// Odd parts, relative to those of the light that crosses the voxel: (axes, diagonals).
#define FLOWS(of, first, depth)                                                            \
    const float of##_axis = 1.0f + 0.5f * (first) * (depth),                               \
                of##_diagonal = 1.0f + 0.5f * DIAGONAL * (first) * (depth);
#define FLOW(of, cx, cy, cz) (IS_DIAGONAL(cx, cy, cz) ? of##_diagonal : of##_axis)

// --- Restriction -------------------------------------------------------------------------------

// One of four adjacent voxels; odd numbers of voxels along an edge end in cells outside.
#define CHILD(n, dx, dy)                                                                   \
    const size_t cell_##n = origin + STEP(2 * (begin + layer) + dx, 2 * y + dy, z);        \
    const float live_##n = depths[cell_##n] < 0.0f ? 0.0f : 1.0f;                          \
    FLOWS(flow_##n, first, live_##n * depths[cell_##n])                                    \
    float power_##n = 0.0f;

#define ADD_CHILD(n, m, back, cx, cy, cz)                                                  \
    {                                                                                      \
        const float ahead = live_##n * FLOWED(m, back, cell_##n, STEP(cx, cy, cz));        \
        const float behind = live_##n * FLOWED(back, m, cell_##n, -STEP(cx, cy, cz));      \
        power_##n += ahead + behind;                                                       \
        even += 0.5f * (ahead + behind);                                                   \
        odd += 0.5f * (ahead - behind) * FLOW(flow_##n, cx, cy, cz);                       \
    }
#define SUM_PAIR(m, back, cx, cy, cz)                                                      \
    {                                                                                      \
        float even = 0.0f, odd = 0.0f;                                                     \
        ADD_CHILD(0, m, back, cx, cy, cz)                                                  \
        ADD_CHILD(1, m, back, cx, cy, cz)                                                  \
        ADD_CHILD(2, m, back, cx, cy, cz)                                                  \
        ADD_CHILD(3, m, back, cx, cy, cz)                                                  \
        parts[at + (m)*all] = even;                                                        \
        parts[at + (back)*all] = odd;                                                      \
    }

// Sums over the four: the even parts under m and the odd ones under back, then the power, and its
// moments along x and y from their middle. origin: of the fine lattice
__kernel void sum_across(GRID, __global const float *light, const int swapped,
                         __global const float *depths, const ulong origin, const float first,
                         const ulong begin, __global float *parts)
{
    PLACE;
    const size_t all = get_global_size(0) * get_global_size(1) * get_global_size(2);
    const size_t at = (layer * get_global_size(1) + y) * get_global_size(0) + z;
    CHILD(0, 0, 0)
    CHILD(1, 0, 1)
    CHILD(2, 1, 0)
    CHILD(3, 1, 1)
    FOR_EACH_PAIR(SUM_PAIR)
    parts[at + 18 * all] = power_0 + power_1 + power_2 + power_3;
    parts[at + 19 * all] = 0.25f * (power_2 + power_3 - power_0 - power_1);
    parts[at + 20 * all] = 0.25f * (power_1 + power_3 - power_0 - power_2);
}

#define OF_TWO(part) (parts[lower + (part)*all] + live * parts[upper + (part)*all])
#define GIVE(m, back, cx, cy, cz)                                                          \
    {                                                                                      \
        const float length = IS_DIAGONAL(cx, cy, cz) ? DIAGONAL : 1.0f;                    \
        const float pushed = WEIGHT(cx, cy, cz) * length / SECOND_MOMENT;                  \
        const float drift = pushed * ((cx)*gx + (cy)*gy + (cz)*gz);                        \
        const float even = OF_TWO(m);                                                      \
        const float odd = (OF_TWO(back) + drift) / FLOW(flow, cx, cy, cz);                 \
        given[(m)*stride + guard + cell] += 0.25f * factor * (even + odd);                 \
        given[(back)*stride + guard + cell] += 0.25f * factor * (even - odd);              \
    }

// given: the source of the coarser lattice, whose grid this is, laid out like its light
__kernel void restrict_light(GRID, __global const float *depths, const ulong origin, const float first,
                        const ulong begin, const ulong nz, __global const float *parts,
                        const float factor, __global float *given)
{
    PLACE;
    const size_t all = nz * get_global_size(1) * get_global_size(2);
    const size_t lower = (layer * get_global_size(1) + y) * nz + 2 * z;
    const float live = 2 * z + 1 < nz ? 1.0f : 0.0f;
    const size_t upper = 2 * z + 1 < nz ? lower + 1 : lower;
    const size_t cell = origin + STEP(begin + layer, y, z);
    const float depth = depths[cell];
    FLOWS(flow, first, depth)
    const float gx = first * depth * OF_TWO(19), gy = first * depth * OF_TWO(20);
    const float gz = first * depth * 0.25f *
                     (live * parts[upper + 18 * all] - parts[lower + 18 * all]);
    FOR_EACH_PAIR(GIVE)
}

// --- Prolongation ------------------------------------------------------------------------------

// The coarse voxel around each fine one, and the nearest neighbour of that.
#define NEARER(place) ((place) / 2)
#define FARTHER(place) ((place) / 2 + ((place) % 2 ? 1 : -1))
static size_t clamped(const long place, const ulong count)
{
    return place < 0 ? 0 : place >= (long)count ? count - 1 : (size_t)place;
}

#define KEEP_BETWEEN(m, back, cx, cy, cz)                                                  \
    {                                                                                      \
        const float ahead_1 = ARRIVED(m, back, near, STEP(cx, cy, cz));                    \
        const float behind_1 = ARRIVED(back, m, near, -STEP(cx, cy, cz));                  \
        const float ahead_2 = ARRIVED(m, back, far, STEP(cx, cy, cz));                     \
        const float behind_2 = ARRIVED(back, m, far, -STEP(cx, cy, cz));                   \
        parts[at + (m)*all] = 0.375f * (ahead_1 + behind_1) + 0.125f * (ahead_2 + behind_2); \
        parts[at + (back)*all] = 0.375f * (ahead_1 - behind_1) + 0.125f * (ahead_2 - behind_2); \
    }

// Interpolates the light of the voxels (nx, ny, nz) of the coarser lattice, whose grid this is, along z:
// even parts under m, odd ones under back. Begins one plane before `begin`.
__kernel void interpolate(GRID, __global const float *light, const int swapped, const ulong origin,
                          const ulong begin, const ulong nx, const ulong nz, __global float *parts)
{
    PLACE;
    const size_t all = get_global_size(0) * get_global_size(1) * get_global_size(2);
    const size_t at = (layer * get_global_size(1) + y) * get_global_size(0) + z;
    const size_t x = clamped((long)(begin + layer) - 1, nx);
    const size_t near = origin + STEP(x, y, NEARER(z));
    const size_t far = origin + STEP(x, y, clamped(FARTHER((long)z), nz));
    FOR_EACH_PAIR(KEEP_BETWEEN)
}

#define BETWEEN(part)                                                                      \
    (0.5625f * parts[at_11 + (part)*all] +                                                 \
     0.1875f * (parts[at_12 + (part)*all] + parts[at_21 + (part)*all]) +                   \
     0.0625f * parts[at_22 + (part)*all])
#define ADD_BETWEEN(m, back, cx, cy, cz)                                                   \
    {                                                                                      \
        const float even = factor * BETWEEN(m);                                            \
        const float odd = factor * BETWEEN(back) * FLOW(flow, cx, cy, cz) /                \
                          FLOW(flow_2, cx, cy, cz);                                        \
        ARRIVED(m, back, cell, STEP(cx, cy, cz)) += even + odd;                            \
        ARRIVED(back, m, cell, -STEP(cx, cy, cz)) += even - odd;                           \
    }

// Interpolates that along x and y, and adds it times a factor. Odd parts are scaled by the flow of the
// coarse voxel around each: its neighbours may be far thinner. layers: of parts
__kernel void prolongate(GRID, __global float *light, const int swapped, __global const float *depths,
                      const ulong origin, const float first, const ulong begin,
                      __global const float *depths_2, const ulong plane_2, const ulong row_2,
                      const ulong origin_2, const ulong ny_2, const ulong layers,
                      __global const float *parts, const float factor)
{
    PLACE;
    const size_t nz = get_global_size(0), all = layers * ny_2 * nz;
    const size_t x_1 = (NEARER(layer) + 1) * ny_2, x_2 = (size_t)(FARTHER((long)layer) + 1) * ny_2;
    const size_t y_1 = NEARER(y), y_2 = clamped(FARTHER((long)y), ny_2);
    const size_t at_11 = (x_1 + y_1) * nz + z, at_12 = (x_1 + y_2) * nz + z;
    const size_t at_21 = (x_2 + y_1) * nz + z, at_22 = (x_2 + y_2) * nz + z;
    const size_t cell = origin + STEP(2 * begin + layer, y, z);
    const size_t cell_2 =
        origin_2 + (begin + NEARER(layer)) * plane_2 + NEARER(y) * row_2 + NEARER(z);
    FLOWS(flow, first, depths[cell])
    FLOWS(flow_2, first, depths_2[cell_2])
    FOR_EACH_PAIR(ADD_BETWEEN)
}
