// SPDX-License-Identifier: GPL-3.0-or-later
// The paper's first kernel: one work-item for each node, directions fastest in memory, and a table
// of the node that each flow goes to. Flows that would leave the lattice or enter a boundary node
// go to a sink behind the last node.
//
// Built with WIDTH, HEIGHT, DEPTH (nodes), FIRST (1 where absorbed light is dropped, else 0)
// and, where the medium has opaque voxels, OCCLUSION.

#define DIRECTIONS 19
#define NODE(i, j, k) (((size_t)(i) * HEIGHT + (j)) * DEPTH + (k))
#define FLOW(i, j, k, m) (NODE(i, j, k) * DIRECTIONS + (m))

__kernel void update(__global const float *from, __global float *to,
                     __constant float *omega, __global const float *density,
#ifdef OCCLUSION
                     __global const float *occlusion,
#endif
                     __global const uint *target)
{
    const int i = get_global_id(2);
    const int j = get_global_id(1);
    const int k = get_global_id(0);

    for (int m = FIRST; m < DIRECTIONS; m++) {
        float flow = 0.0f;
        for (int n = 0; n < DIRECTIONS; n++)
            flow += omega[m * DIRECTIONS + n] * from[FLOW(i, j, k, n)];
        flow = from[FLOW(i, j, k, m)] + flow * density[NODE(i, j, k)];
#ifdef OCCLUSION
        flow *= 1.0f - occlusion[NODE(i, j, k)];
#endif
        to[(size_t)target[FLOW(i, j, k, m)] * DIRECTIONS + m] = flow;
    }
}
