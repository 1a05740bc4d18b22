// SPDX-License-Identifier: GPL-3.0-or-later
// Rays of lamps go from voxel to voxel (Amanatides and Woo 1987) and leave what collides on the way.
// transport/uncollided/march.py has the twin. Built behind uncollided/attenuation.cl, with
//   OCCLUDED    voxels stop light, and reflect some of it
//
// Lengths are in voxel edges, and places run along the ray: from 0 where a ray that goes this way
// enters a voxel to 1 where it leaves, by axis, in each voxel anew, so that rounding does not grow
// with the way. Tallies are signed whole numbers of 64 bits in two words of 32, which every device
// can add atomically: a sum does not depend on the order. All lower words come first in memory.

#define UNIT 0x1p30f     // in a weight of 1; a voxel's diagonal still fits a signed word
#define FAINTEST 0x1p-32f // a weight of which no score is a unit any more
#define SLOWEST 1e-18f   // a direction's component closer to zero than this is taken for this

// What a voxel's tallies count. A score is the length of unscattered light's paths, or where a
// voxel's edge is deeper than 1, the weight that collides; they differ by that depth.
#define SCORE 0
#define POSITION 1  // three: score and place of the collisions from the voxel's centre
#define DIRECTION 4 // three: score and direction
#define TALLIES 7

// What a work-item counts for all its rays.
#define STOPPED 6 // behind the light that left through the faces -x, +x, -y, +y, -z, +z
#define SUMS 7

static void add(volatile __global uint *tally, const size_t upper, const float weight)
{
    const int units = convert_int_rte(weight * UNIT);
    if (units == 0)
        return;
    const uint before = atomic_add(tally, (uint)units), after = before + (uint)units;
    if (units > 0 ? after < before : after > before)
        atomic_add(tally + upper, units > 0 ? 1u : 0xffffffffu);
}

static void add_vector(volatile __global uint *tally, const size_t upper, const float weight,
                       const float x, const float y, const float z)
{
    add(tally, upper, weight * x);
    add(tally + 1, upper, weight * y);
    add(tally + 2, upper, weight * z);
}

static long in_units(const float weight)
{
    return convert_long_rte(weight * UNIT);
}

// Where a ray is after a step along an axis; `rest` keeps what rounding lost (Kahan 1965), as a ray
// that is nearly parallel to a border takes hundreds of steps to cross it.
static float moved(const float place, const float step, float *rest)
{
    const float whole = step + *rest, next = place + whole;
    *rest = whole - (next - place);
    return fmin(next, 1.0f);
}

// depth       of a voxel's edge, by voxel
// occlusion   share of the light arriving at a voxel that it stops, where OCCLUDED
// reflecting  share that it reflects
// rays        7 x count: place in the first voxel, unit direction, weight from 0 to 1
// starts      2 x count: first voxel; the face of the domain that a ray comes through, or -1
__kernel void march(const int nx, const int ny, const int nz, __global const float *depth,
                    __global const float *occlusion, __global const float *reflecting,
                    __global const float *rays, __global const int *starts, const int count,
                    __global uint *tallies, __global uint *reflected, __global long *sums)
{
    const size_t voxels = (size_t)nx * ny * nz, upper = TALLIES * voxels;
    long sum[SUMS];
    for (int n = 0; n < SUMS; n++)
        sum[n] = 0;
    for (int ray = (int)get_global_id(0); ray < count; ray += (int)get_global_size(0)) {
        float x = rays[ray], y = rays[count + ray], z = rays[2 * count + ray];
        const float dx = rays[3 * count + ray];
        const float dy = rays[4 * count + ray];
        const float dz = rays[5 * count + ray];
        const float ax = fmax(fabs(dx), SLOWEST), ix = 1.0f / ax, sx = dx < 0 ? -1.0f : 1.0f;
        const float ay = fmax(fabs(dy), SLOWEST), iy = 1.0f / ay, sy = dy < 0 ? -1.0f : 1.0f;
        const float az = fmax(fabs(dz), SLOWEST), iz = 1.0f / az, sz = dz < 0 ? -1.0f : 1.0f;
        int voxel = starts[ray];
        const int k = voxel % nz, j = voxel / nz % ny, i = voxel / nz / ny;
        int ahead_x = dx < 0 ? i : nx - 1 - i; // voxels until the domain ends
        int ahead_y = dy < 0 ? j : ny - 1 - j;
        int ahead_z = dz < 0 ? k : nz - 1 - k;
        const int next_x = dx < 0 ? -ny * nz : ny * nz, next_y = dy < 0 ? -nz : nz;
        const int next_z = dz < 0 ? -1 : 1;
        float weight = rays[6 * count + ray], rest_x = 0.0f, rest_y = 0.0f, rest_z = 0.0f;
#ifdef OCCLUDED
        const int face = starts[count + ray];
        if (face >= 0) {
            const float stopped = weight * occlusion[voxel], back = weight * reflecting[voxel];
            for (int n = 0; n < 6; n++) // not sum[face]: the sums stay in registers
                sum[n] += n == face ? in_units(back) : 0;
            sum[STOPPED] += in_units(stopped - back);
            weight -= stopped;
        }
#endif
        int through = -1; // the face that it leaves by
        while (through < 0) {
            const float tx = (1.0f - x) * ix, ty = (1.0f - y) * iy, tz = (1.0f - z) * iz;
            const float way = fmin(tx, fmin(ty, tz));
            const float edge = depth[voxel];
            const Fade f = fade(edge * way);
            __global uint *tally = tallies + TALLIES * (size_t)voxel;
            const float total = weight * (edge > 1.0f ? 1.0f - f.through : way * f.mean);
            const float placed = total * way * f.place;
            weight *= f.through;
            add(tally + SCORE, upper, total);
            if (edge > 0.0f) {
                add(tally + POSITION, upper, sx * (total * (x - 0.5f) + placed * ax));
                add(tally + POSITION + 1, upper, sy * (total * (y - 0.5f) + placed * ay));
                add(tally + POSITION + 2, upper, sz * (total * (z - 0.5f) + placed * az));
            }
            add_vector(tally + DIRECTION, upper, total, dx, dy, dz);
            if (weight < FAINTEST)
                break;
            const int by_x = way == tx, by_y = !by_x && way == ty, by_z = !by_x && !by_y;
            x = by_x ? 1.0f : moved(x, way * ax, &rest_x);
            y = by_y ? 1.0f : moved(y, way * ay, &rest_y);
            z = by_z ? 1.0f : moved(z, way * az, &rest_z);
            ahead_x -= by_x;
            ahead_y -= by_y;
            ahead_z -= by_z;
            if (min(ahead_x, min(ahead_y, ahead_z)) < 0) {
                through = by_x ? dx >= 0 : by_y ? 2 + (dy >= 0) : 4 + (dz >= 0);
                break;
            }
            const int next = voxel + (by_x ? next_x : by_y ? next_y : next_z);
#ifdef OCCLUDED
            if (occlusion[next] > 0.0f) {
                const float stopped = weight * occlusion[next], back = weight * reflecting[next];
                add(reflected + voxel, voxels, back);
                sum[STOPPED] += in_units(stopped - back);
                weight -= stopped;
            }
#endif
            x = by_x ? rest_x = 0.0f : x;
            y = by_y ? rest_y = 0.0f : y;
            z = by_z ? rest_z = 0.0f : z;
            voxel = next;
        }
        for (int n = 0; n < 6; n++)
            sum[n] += n == through ? in_units(weight) : 0;
    }
    for (int n = 0; n < SUMS; n++)
        sums[SUMS * get_global_id(0) + n] += sum[n];
}
