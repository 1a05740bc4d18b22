// SPDX-License-Identifier: GPL-3.0-or-later
// The least trilinear function above the density in each super-voxel, by the dual simplex method;
// transport/photons/majorants_numpy.py describes it and is the twin. A work-item solves one
// super-voxel; a group has LANES of them, and their node values lie side by side.
//
// Built with LANES, EXCHANGES (the maximum), TOLERANCE (of the mean) and SMALLEST_PIVOT.

#define CORNERS 8
#define NODE(i, j, k) (((size_t)((i) * nodes.y + (j)) * nodes.z + (k)) * LANES)
#define ROW(i, j) (((size_t)(i) * shape.y + (j)) * shape.z)

// values  voxels (blocky) or nodes; fine, cells and nodes are triples of counts, nodes the largest
//         of a super-voxel; size is in fine cells; scratch holds the node values
// least   8 corner values for each super-voxel, z fastest
__kernel void fit(__global const float *values, int3 fine, int3 cells, int3 nodes, int size,
                  int blocky, __global float *scratch, __global float *least)
{
    const int cell = get_global_id(0);
    if (cell >= cells.x * cells.y * cells.z)
        return;
    __global float *node =
        scratch + (size_t)get_group_id(0) * nodes.x * nodes.y * nodes.z * LANES + get_local_id(0);
    const int3 first =
        size * (int3)(cell / cells.z / cells.y, cell / cells.z % cells.y, cell % cells.z);
    const int3 extent = min(fine - first, size);
    const int3 last = first + extent - blocky;
    const int3 shape = fine + 1 - blocky;
    const float3 unit = 1.0f / convert_float3(extent);

    // A node takes the largest of the super-voxel's values around it.
    for (int i = 0; i < nodes.x; i++) {
        const int x1 = min(first.x + i, last.x), x0 = clamp(first.x + i - blocky, first.x, x1);
        for (int j = 0; j < nodes.y; j++) {
            const int y1 = min(first.y + j, last.y), y0 = clamp(first.y + j - blocky, first.y, y1);
            const int missing = i > extent.x || j > extent.y;
            __global const float *r00 = values + ROW(x0, y0), *r01 = values + ROW(x0, y1);
            __global const float *r10 = values + ROW(x1, y0), *r11 = values + ROW(x1, y1);
            float below = -INFINITY;
            for (int k = 0; k < nodes.z; k++) {
                const int z = min(first.z + k, last.z);
                const float here = fmax(fmax(r00[z], r01[z]), fmax(r10[z], r11[z]));
                const float largest = blocky ? fmax(below, here) : here;
                node[NODE(i, j, k)] = missing || k > extent.z ? -INFINITY : largest;
                below = here;
            }
        }
    }

    float corner[CORNERS], share[CORNERS], inverse[CORNERS][CORNERS];
#pragma unroll
    for (int c = 0; c < CORNERS; c++) {
        corner[c] = node[NODE(c & 4 ? extent.x : 0, c & 2 ? extent.y : 0, c & 1 ? extent.z : 0)];
        share[c] = 1.0f;
#pragma unroll
        for (int n = 0; n < CORNERS; n++)
            inverse[c][n] = c == n ? 1.0f : 0.0f;
    }

    float best = INFINITY;
    for (int exchange = 0; exchange <= EXCHANGES; exchange++) {
        // Find the node that lies farthest above the function.
        float excess = 0.0f;
        int3 worst = (int3)(0);
        for (int i = 0; i < nodes.x; i++) {
            const float x = i * unit.x;
            const float f00 = mix(corner[0], corner[4], x), f01 = mix(corner[1], corner[5], x);
            const float f10 = mix(corner[2], corner[6], x), f11 = mix(corner[3], corner[7], x);
            for (int j = 0; j < nodes.y; j++) {
                const float y = j * unit.y;
                const float near = mix(f00, f10, y), slope = (mix(f01, f11, y) - near) * unit.z;
                for (int k = 0; k < nodes.z; k++) {
                    const float missing = node[NODE(i, j, k)] - (near + slope * k);
                    if (missing > excess) {
                        excess = missing;
                        worst = (int3)(i, j, k);
                    }
                }
            }
        }

        float mean = 0.0f;
#pragma unroll
        for (int c = 0; c < CORNERS; c++)
            mean += corner[c] / CORNERS;
        if (mean + excess < best) {
            best = mean + excess;
            for (int c = 0; c < CORNERS; c++)
                least[(size_t)cell * CORNERS + c] = corner[c] + excess;
        }
        if (!(excess > TOLERANCE * mean))
            break;

        // It enters the basis; the node whose share would turn negative first leaves it.
        const float3 at = convert_float3(worst) * unit;
        float weight[CORNERS], entering[CORNERS];
#pragma unroll
        for (int c = 0; c < CORNERS; c++)
            weight[c] = (c & 4 ? at.x : 1 - at.x) * (c & 2 ? at.y : 1 - at.y) *
                        (c & 1 ? at.z : 1 - at.z);
        float step = INFINITY, pivot = 1.0f;
        int leaving = 0; // at least one pivot is large enough: they sum to 1
#pragma unroll
        for (int n = 0; n < CORNERS; n++) {
            entering[n] = 0.0f;
#pragma unroll
            for (int c = 0; c < CORNERS; c++)
                entering[n] += weight[c] * inverse[c][n];
            const float ratio = entering[n] > SMALLEST_PIVOT ? share[n] / entering[n] : INFINITY;
            if (ratio < step) {
                step = ratio;
                pivot = entering[n];
                leaving = n;
            }
        }
#pragma unroll
        for (int n = 0; n < CORNERS; n++)
            share[n] = n == leaving ? step : fmax(share[n] - step * entering[n], 0.0f);
#pragma unroll
        for (int c = 0; c < CORNERS; c++) {
            float column = 0.0f;
#pragma unroll
            for (int n = 0; n < CORNERS; n++)
                column = n == leaving ? inverse[c][n] : column;
            column /= pivot;
            corner[c] += column * excess;
#pragma unroll
            for (int n = 0; n < CORNERS; n++)
                inverse[c][n] = n == leaving ? column : inverse[c][n] - column * entering[n];
        }
    }
}
