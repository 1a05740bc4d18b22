// SPDX-License-Identifier: GPL-3.0-or-later
// The turns of a path: scattering by the medium, and reflection by opaque voxels that stop it.
// Built after photons/paths.cl with
//   OCCLUSION  voxels are opaque; fine cells are then voxels
// transport/photons/walk.py is the twin.

// Move the origin to the flight's present point.
static void arrive(Path *p, const Grid g)
{
    p->ox = clamp(p->ox + p->t * p->dx, g.lower, g.upper_x);
    p->oy = clamp(p->oy + p->t * p->dy, g.lower, g.upper_y);
    p->oz = clamp(p->oz + p->t * p->dz, g.lower, g.upper_z);
}

// Scatter (dx, dy, dz) by the phase function of Henyey and Greenstein (1941).
static void turn(Path *p, Random *random, const float mean_cosine)
{
    const float even = 2.0f * random_next(random) - 1.0f;
    const float ratio = (1.0f - mean_cosine * mean_cosine) / (1.0f + mean_cosine * even);
    const float cosine = fabs(mean_cosine) < 1e-3f
                             ? even + 1.5f * mean_cosine * (1.0f - even * even)
                             : (1.0f + mean_cosine * mean_cosine - ratio * ratio) /
                                   (2.0f * mean_cosine);
    const float c = clamp(cosine, -1.0f, 1.0f);
    const float s = sqrt(1.0f - c * c);
    float around_cosine;
    const float around_sine = sincos(2 * M_PI_F * random_next(random), &around_cosine);
    const float u = s * around_cosine, v = s * around_sine;

    // An orthonormal basis about the old direction (Duff et al. 2017).
    const float sign = copysign(1.0f, p->dz);
    const float a = -1.0f / (sign + p->dz);
    const float b = p->dx * p->dy * a;
    const float x = u * (1.0f + sign * p->dx * p->dx * a) + v * b + c * p->dx;
    const float y = u * sign * b + v * (sign + p->dy * p->dy * a) + c * p->dy;
    const float z = -u * sign * p->dx - v * p->dy + c * p->dz;
    const float scale = rsqrt(x * x + y * y + z * z);
    p->dx = x * scale;
    p->dy = y * scale;
    p->dz = z * scale;
}

// The position of a flight among opaque voxels, and the one that stopped it last. The voxel is
// tracked, not computed from coordinates: rounding must not take a photon through a wall.
typedef struct {
    int i, j, k; // the voxel
    int axis;    // of the face at which the flight was stopped
    size_t by;   // number of the voxel behind it
} Place;

#ifdef OCCLUSION
static Place place_of(const Path *p, const Grid g)
{
    return (Place){clamp((int)p->ox, 0, g.nx - 1), clamp((int)p->oy, 0, g.ny - 1),
                   clamp((int)p->oz, 0, g.nz - 1), 0, 0};
}

// Follow a flight from voxel to voxel up to its present point, and cut it at the first face that
// stops it. Returns whether there is one.
static int stop(Path *p, const Grid g, Random *random, __global const float *occlusion,
                Place *at)
{
    for (;;) {
        const float tx = crossing(at->i, 1, p->ox, p->dx, p->ix);
        const float ty = crossing(at->j, 1, p->oy, p->dy, p->iy);
        const float tz = crossing(at->k, 1, p->oz, p->dz, p->iz);
        const float next = fmin(tx, fmin(ty, tz));
        const int axis = tx <= fmin(ty, tz) ? 0 : ty <= tz ? 1 : 2;
        const int i = at->i + (axis != 0 ? 0 : p->dx >= 0.0f ? 1 : -1);
        const int j = at->j + (axis != 1 ? 0 : p->dy >= 0.0f ? 1 : -1);
        const int k = at->k + (axis != 2 ? 0 : p->dz >= 0.0f ? 1 : -1);
        const int inside = ((uint)i < (uint)g.nx) & ((uint)j < (uint)g.ny) &
                           ((uint)k < (uint)g.nz);
        if (next >= p->t || !inside)
            return 0;
        const size_t voxel = ((size_t)i * g.ny + j) * g.nz + k;
        const float share = occlusion[voxel];
        if (share > 0.0f && (share == 1.0f || random_next(random) < share)) {
            p->t = fmax(next, 0.0f);
            at->axis = axis;
            at->by = voxel;
            return 1;
        }
        at->i = i;
        at->j = j;
        at->k = k;
    }
}

// Move the origin to the face that stopped the flight, on the side that it came from.
static void land(Path *p, const Grid g, const Place at)
{
    arrive(p, g);
    if (at.axis == 0)
        p->ox = at.i + (p->dx >= 0.0f);
    else if (at.axis == 1)
        p->oy = at.j + (p->dy >= 0.0f);
    else
        p->oz = at.k + (p->dz >= 0.0f);
    p->i = at.i / g.size; // `advance` may have continued behind the face
    p->j = at.j / g.size;
    p->k = at.k / g.size;
}

// Reflect (dx, dy, dz) from that face, cosine-distributed about its normal (Lambert).
static void turn_back(Path *p, Random *random, const Place at)
{
    const float squared = random_next(random);
    const float back = sqrt(squared), aside = sqrt(1.0f - squared);
    float u;
    const float v = aside * sincos(2 * M_PI_F * random_next(random), &u);
    u *= aside;
    if (at.axis == 0) {
        p->dx = p->dx >= 0.0f ? -back : back;
        p->dy = u;
        p->dz = v;
    } else if (at.axis == 1) {
        p->dy = p->dy >= 0.0f ? -back : back;
        p->dz = u;
        p->dx = v;
    } else {
        p->dz = p->dz >= 0.0f ? -back : back;
        p->dx = u;
        p->dy = v;
    }
}
#else
static Place place_of(const Path *p, const Grid g)
{
    return (Place){0, 0, 0, 0, 0};
}

static int stop(Path *p, const Grid g, Random *random, __global const float *occlusion,
                Place *at)
{
    return 0;
}

static void land(Path *p, const Grid g, const Place at)
{
}

static void turn_back(Path *p, Random *random, const Place at)
{
}
#endif
