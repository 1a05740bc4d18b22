// SPDX-License-Identifier: GPL-3.0-or-later
// Parallel light through voxels, layer by layer; transport/sweep.py is the twin. Built behind fade.cl.
//
// Each voxel's column has `count` rays, and in a layer those of one number all cross voxels alike:
// on their way through the layer they start in a voxel, and may cross to the next along u, or v, or
// both, one behind the other. `ways` has for each layer and number: how many voxels along u and v it
// is from the ray's column to the voxel that it starts in, where it starts there, the lengths in up
// to three voxels, and the order of crossings.

#define WAYS 8
#define NONE 0
#define U 1
#define V 2
#define U_THEN_V 3
#define V_THEN_U 4

#define LAYER                                                                              \
    const int nu, const int nv, const int beside, const int count,                         \
        const ulong first_depth, const ulong first_way, const ulong first_tally,           \
        __global const float *all_depths, __global const float *all_ways
#define LOOK                                                                               \
    __global const float *depths = all_depths + first_depth, *ways = all_ways + first_way;

static float depth_at(__global const float *depths, const int nu, const int nv, const int u,
                      const int v)
{
    return u < 0 || v < 0 || u >= nu || v >= nv ? 0.0f : depths[u * nv + v];
}

#define DEPTH(u, v) depth_at(depths, nu, nv, u, v)
#define RAY(n, u, v) (((n) * (nu + beside) + (u) + beside) * (nv + beside) + (v) + beside)

typedef struct {
    float score, u, v, w;
} Tally;

// Of light that comes with `weight` to a place in a voxel of this depth, and goes some way in it.
static Tally crossed(const float weight, const float depth, const float way, const float u,
                     const float v, const float w, const float du, const float dv, const float dw)
{
    const Fade f = fade(depth * way);
    const float score = weight * (depth > 1.0f ? 1.0f - f.through : way * f.mean);
    const float on = way * f.place;
    const Tally tally = {score, score * (u - 0.5f + on * du), score * (v - 0.5f + on * dv),
                         score * (w - 0.5f + on * dw)};
    return tally;
}

#define ADD(...)                                                                           \
    {                                                                                      \
        const Tally t = crossed(__VA_ARGS__, du, dv, dw);                                  \
        sum.score += t.score;                                                              \
        sum.u += t.u;                                                                      \
        sum.v += t.v;                                                                      \
        sum.w += t.w;                                                                      \
    }

// tallies  score, and score times the place from the voxel's centre along u, v and w, one `size`
// behind the other; (du, dv, dw)  the direction of light, all >= 0
__kernel void tally(LAYER, __global const float *rays, const float du, const float dv,
                    const float dw, __global float *tallies, const ulong size)
{
    const int v = (int)get_global_id(0), u = (int)get_global_id(1);
    LOOK
    const float depth = depths[u * nv + v];
    Tally sum = {0.0f, 0.0f, 0.0f, 0.0f};
    for (int n = 0; n < count; n++) {
        __global const float *way = ways + WAYS * n;
        const int cu = u - (int)way[0], cv = v - (int)way[1], order = (int)way[7];
        const float pu = way[2], pv = way[3], first = way[4], second = way[5], third = way[6];
        ADD(rays[RAY(n, cu, cv)], depth, first, pu, pv, 0.0f)
        if (order != NONE) {
            const int by_u = order == U || order == U_THEN_V, by_v = !by_u;
            const float w = first * dw;
            const float came = exp(-first * DEPTH(u - by_u, v - by_v));
            ADD(rays[RAY(n, cu - by_u, cv - by_v)] * came, depth, second,
                by_u ? 0.0f : pu + first * du, by_v ? 0.0f : pv + first * dv, w)
            if (order > V) {
                const float there = exp(-first * DEPTH(u - 1, v - 1) -
                                        second * DEPTH(u - by_v, v - by_u));
                ADD(rays[RAY(n, cu - 1, cv - 1)] * there, depth, third,
                    by_u ? second * du : 0.0f, by_v ? second * dv : 0.0f,
                    (first + second) * dw)
            }
        }
    }
    const size_t voxel = first_tally + (size_t)u * nv + v;
    tallies[voxel] = sum.score;
    tallies[size + voxel] = sum.u;
    tallies[2 * size + voxel] = sum.v;
    tallies[3 * size + voxel] = sum.w;
}

// What is left of the rays behind the layer; over those that start in it, or in the row before.
__kernel void pass(LAYER, __global float *rays)
{
    const int v = (int)get_global_id(0) - 1, u = (int)get_global_id(1) - 1;
    const int n = (int)get_global_id(2);
    LOOK
    __global const float *way = ways + WAYS * n;
    const int order = (int)way[7], by_u = order == U || order == U_THEN_V;
    const int by_v = order == V || order == V_THEN_U;
    float depth = way[4] * DEPTH(u, v);
    if (order != NONE)
        depth += way[5] * DEPTH(u + by_u, v + by_v);
    if (order > V)
        depth += way[6] * DEPTH(u + 1, v + 1);
    rays[RAY(n, u - (int)way[0], v - (int)way[1])] *= exp(-depth);
}
