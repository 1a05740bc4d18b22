// SPDX-License-Identifier: GPL-3.0-or-later
// Rays of lamps go from voxel to voxel (Amanatides and Woo 1987) and score their first
// collisions; transport/uncollided/march.py is the twin. Built after attenuation.cl, with
//   OCCLUDED    opaque matter in voxels stops light and reflects part of it
//
// Lengths are in voxel edges. A ray's place in a voxel runs along each axis from 0 where a ray of
// this direction enters to 1 where it leaves; it restarts in each voxel, so rounding errors do not
// grow along the ray. Tallies are signed 64-bit integers in two words of 32 bits, which every
// device can add atomically, so sums do not depend on the order. All lower words come first in
// memory.

#define UNIT 0x1p30f     // units in a weight of 1; a voxel's diagonal still fits a signed word
#define FAINTEST 0x1p-32f // weights below this score no unit
#define SLOWEST 1e-18f   // components of a direction closer to zero are replaced by this

// The kinds of a voxel's tallies. A score is the path length of uncollided light; or, if the edge
// of the voxel is deeper than 1, the weight that collides: the path length times that depth.
#define SCORE 0
#define POSITION 1  // three: score times place of the collisions, relative to the voxel's centre
#define DIRECTION 4 // three: score times direction
#define TALLIES 7

// The sums of a work-item over all its rays.
#define STOPPED 6 // after the light that left through the faces -x, +x, -y, +y, -z, +z
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

// The place of a ray after a step along an axis. Kahan summation (1965), with the rounding error in
// `error`: a ray that is nearly parallel to a face takes hundreds of steps to reach it.
static float moved(const float place, const float step, float *error)
{
    const float corrected = step + *error, next = place + corrected;
    *error = corrected - (next - place);
    return fmin(next, 1.0f);
}

// depth       optical depth of a voxel's edge, by voxel
// occlusion   if OCCLUDED: share of the arriving light that opaque matter in a voxel stops
// reflecting  if OCCLUDED: share of the arriving light that it reflects
// rays        7 x count: place in the first voxel, unit direction, weight from 0 to 1
// starts      2 x count: first voxel; the face of the domain through which a ray enters, or -1
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
        int ahead_x = dx < 0 ? i : nx - 1 - i; // voxels up to the end of the domain
        int ahead_y = dy < 0 ? j : ny - 1 - j;
        int ahead_z = dz < 0 ? k : nz - 1 - k;
        const int next_x = dx < 0 ? -ny * nz : ny * nz, next_y = dy < 0 ? -nz : nz;
        const int next_z = dz < 0 ? -1 : 1;
        float weight = rays[6 * count + ray], error_x = 0.0f, error_y = 0.0f, error_z = 0.0f;
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
        int exit_face = -1; // of the domain
        while (exit_face < 0) {
            const float tx = (1.0f - x) * ix, ty = (1.0f - y) * iy, tz = (1.0f - z) * iz;
            const float way = fmin(tx, fmin(ty, tz));
            const float edge = depth[voxel];
            const Attenuation a = attenuate(edge * way);
            __global uint *tally = tallies + TALLIES * (size_t)voxel;
            const float total
                = weight * (edge > 1.0f ? 1.0f - a.transmittance : way * a.mean_transmittance);
            const float placed = total * way * a.collision_place;
            weight *= a.transmittance;
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
            x = by_x ? 1.0f : moved(x, way * ax, &error_x);
            y = by_y ? 1.0f : moved(y, way * ay, &error_y);
            z = by_z ? 1.0f : moved(z, way * az, &error_z);
            ahead_x -= by_x;
            ahead_y -= by_y;
            ahead_z -= by_z;
            if (min(ahead_x, min(ahead_y, ahead_z)) < 0) {
                exit_face = by_x ? dx >= 0 : by_y ? 2 + (dy >= 0) : 4 + (dz >= 0);
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
            x = by_x ? error_x = 0.0f : x;
            y = by_y ? error_y = 0.0f : y;
            z = by_z ? error_z = 0.0f : z;
            voxel = next;
        }
        for (int n = 0; n < 6; n++)
            sum[n] += n == exit_face ? in_units(weight) : 0;
    }
    for (int n = 0; n < SUMS; n++)
        sums[SUMS * get_global_id(0) + n] += sum[n];
}
