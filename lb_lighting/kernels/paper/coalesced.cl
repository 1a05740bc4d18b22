// SPDX-License-Identifier: GPL-3.0-or-later
// The paper's final kernel for devices that do not coalesce shifted writes: a work-group is one
// stripe along DEPTH. It collects its outflow in local memory, each value at its target, and writes
// the stripe in order after a barrier.
//
// Two stripes take turns. With a single one, as printed in the paper, a fast work-item may
// overwrite for direction m + 1 a value that a slow one has yet to write for m.
//
// Built with WIDTH, HEIGHT, DEPTH (nodes), FIRST (1 where absorbed light is dropped, else 0)
// and, where the medium has opaque voxels, OCCLUSION. The work-group is (1, 1, DEPTH).

#define DIRECTIONS 19
#define NODE(i, j, k) (((size_t)(i) * HEIGHT + (j)) * DEPTH + (k))
#define FLOW(i, j, k, m) ((((size_t)(i) * HEIGHT + (j)) * DIRECTIONS + (m)) * DEPTH + (k))
#define INSIDE(i, j, k)                                                                    \
    ((i) > 0 && (i) < WIDTH - 1 && (j) > 0 && (j) < HEIGHT - 1 && (k) > 0 && (k) < DEPTH - 1)

__kernel void update(__global const float *from, __global float *to,
                     __constant float *omega, __global const float *density,
#ifdef OCCLUSION
                     __global const float *occlusion,
#endif
                     __constant int *direction)
{
    const int i = get_global_id(2);
    const int j = get_global_id(1);
    const int k = get_global_id(0);
    const float d = density[NODE(i, j, k)];
    __local float stripes[2][DEPTH];
    float f[DIRECTIONS];

#pragma unroll
    for (int m = 0; m < DIRECTIONS; m++)
        f[m] = from[FLOW(i, j, k, m)];

#pragma unroll
    for (int m = FIRST; m < DIRECTIONS; m++) {
        __local float *stripe = stripes[m % 2];
        const int out_i = i + direction[3 * m + 0];
        const int out_j = j + direction[3 * m + 1];
        const int out_k = k + direction[3 * m + 2];
        if (out_k > 0 && out_k < DEPTH - 1) {
            float flow = 0.0f;
#pragma unroll
            for (int n = 0; n < DIRECTIONS; n++)
                flow += omega[m * DIRECTIONS + n] * f[n];
            flow = f[m] + flow * d;
#ifdef OCCLUSION
            flow *= 1.0f - occlusion[NODE(i, j, k)];
#endif
            stripe[out_k] = flow;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        if (INSIDE(out_i, out_j, k))
            to[FLOW(out_i, out_j, k, m)] = stripe[k];
    }
}
