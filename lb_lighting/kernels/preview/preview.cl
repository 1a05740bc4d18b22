// SPDX-License-Identifier: GPL-3.0-or-later
// Paths from a camera to the lights. The twin is transport/preview/preview_numpy.py. Built after
// photons/scatter.cl, with
//   EMISSION  voxels emit; fine cells are voxels
//
// At each collision a free path is drawn towards each light, and the light counts if the path
// arrives. A path thus alternates between its own flight and one flight to each light. Both kinds
// share one loop, so that all lanes of a vector stay busy.
//
// x, y and z of a float4 are three bands.

// The radiance that a collision sends back along the flight `p` if nothing blocks the light; turns
// `p` to the light. A light is eight numbers: the vector to a sun, or the position of a point light;
// whether it is a point light; and its irradiance, W/m^2, for a point light at a distance of one
// fine cell. `face` is the axis of the opaque face that was met, or -1 in the medium.
static float4 aim(Path *p, const float8 light, const float mean_cosine, const int face,
                  float *distance)
{
    const float vx = light.s3 > 0.0f ? light.s0 - p->ox : light.s0;
    const float vy = light.s3 > 0.0f ? light.s1 - p->oy : light.s1;
    const float vz = light.s3 > 0.0f ? light.s2 - p->oz : light.s2;
    const float squared = fmax(vx * vx + vy * vy + vz * vz, 1e-12f);
    const float inverse_length = rsqrt(squared);
    const float lx = vx * inverse_length, ly = vy * inverse_length, lz = vz * inverse_length;
    float share;
    if (face < 0) { // Henyey and Greenstein 1941
        const float cosine = lx * p->dx + ly * p->dy + lz * p->dz;
        const float g = mean_cosine;
        const float base = fmax(1.0f + g * g - 2.0f * g * cosine, 1e-12f);
        share = (1.0f - g * g) / (4.0f * M_PI_F * base * sqrt(base));
    } else { // Lambert; no light from behind
        const float out = face == 0 ? lx : face == 1 ? ly : lz;
        const float in = face == 0 ? p->dx : face == 1 ? p->dy : p->dz;
        share = fmax(in >= 0.0f ? -out : out, 0.0f) / M_PI_F;
    }
    *distance = light.s3 > 0.0f ? squared * inverse_length : INFINITY;
    p->dx = lx;
    p->dy = ly;
    p->dz = lz;
    return (float4)(light.s4, light.s5, light.s6, 0.0f) *
           (light.s3 > 0.0f ? share / squared : share);
}

// Light that the medium emits along a flight up to its present point, scored at points a fine cell
// apart, the next at `at`. Returns the one after that. `emission` is the radiance of one fine cell.
static float glow(const Path *p, const Grid g, float at, const float4 weight,
                  __global const float *emission, float4 *light)
{
#ifdef EMISSION
    for (; at < p->t; at += 1.0f) {
        const int i = clamp((int)(p->ox + at * p->dx), 0, g.nx - 1);
        const int j = clamp((int)(p->oy + at * p->dy), 0, g.ny - 1);
        const int k = clamp((int)(p->oz + at * p->dz), 0, g.nz - 1);
        *light += weight * vload4(((size_t)i * g.ny + j) * g.nz + k, emission);
    }
#endif
    return at - p->t;
}

// rays       6 x count: where they enter the domain, in fine cells, and unit directions
// numbers    of the rays, which select their random numbers
// most_collisions  of a path; it ends there
// occlusion  of each voxel, and four numbers of its albedo; see photons/photons.cl
// seen       4 x count: light, W/(m^2 sr), and whether the ray met anything
// left       8 x count: the direction in which a path that met something left the medium, and
//            its weight in three bands; 1 for a path that took too many steps
__kernel void see(GRID_PARAMETERS, __global const float *rays, __global const uint *numbers,
                  const int count, const uint seed, const int most_steps,
                  const int most_collisions, const float albedo_x, const float albedo_y,
                  const float albedo_z, const float mean_cosine, __global const float *lights,
                  const int light_count, __global const float *emission,
                  __global const float *occlusion, __global const float *occlusion_albedo,
                  __global float *seen, __global float *left, __global int *violations)
{
    const Grid g = GRID;
    const float4 albedo = (float4)(albedo_x, albedo_y, albedo_z, 0.0f);
    const int stride = (int)get_global_size(0);
    int ray = (int)get_global_id(0);
    int fresh = 1, steps = 0, collisions = 0, violated = 0;
    int target = -1; // the light that the flight goes to, or -1 for the path's own
    int i = 0, j = 0, k = 0, face = -1;
    float score_at = 0.0f, dx = 0.0f, dy = 0.0f, dz = 0.0f; // of the path's own flight
    float4 weight = 0.0f, light = 0.0f, due = 0.0f;
    Path p;
    Place at, here;
    Random random;
    while (ray < count) {
        if (fresh) {
            enter(&p, g, rays, count, ray);
            random = random_stream(seed, numbers[ray]);
            weight = (float4)(1.0f, 1.0f, 1.0f, 0.0f);
            light = 0.0f;
            score_at = random_next(&random);
            start_flight(&p, g, &random);
            fresh = steps = collisions = 0;
            target = -1;
            at = here = place_of(&p, g);
        }
        const int event = advance(&p, g, &random);
        steps++;
        const int lost = steps >= most_steps;
        if (event != COLLIDED && event != LEFT && !lost)
            continue;
        const int stopped = stop(&p, g, &random, occlusion, &here);
        const int met = stopped || event == COLLIDED;

        int done = lost, gone = 0;
        if (target < 0) {
            score_at = glow(&p, g, score_at, weight, emission, &light);
            gone = !met && !lost;
            collisions += met;
            done = lost || gone || collisions == most_collisions + 1;
            if (met) {
                weight *= stopped ? vload4(here.by, occlusion_albedo) : albedo;
                face = stopped ? here.axis : -1;
                at = here;
                if (stopped)
                    land(&p, g, here);
                else
                    arrive(&p, g);
                i = p.i, j = p.j, k = p.k;
                dx = p.dx, dy = p.dy, dz = p.dz;
            }
        } else if (event == LEFT && !stopped) {
            light += due;
        }
        target++;
        if (!done && target == light_count) { // all lights were tried: the path goes on
            target = -1;
            const float most = fmax(weight.x, fmax(weight.y, weight.z));
            if (most < 0.1f) { // Russian roulette, at even odds
                done = random_next(&random) < 0.5f || most == 0.0f;
                weight *= 2.0f;
            }
            p.dx = dx, p.dy = dy, p.dz = dz;
            if (face < 0)
                turn(&p, &random, mean_cosine);
            else
                turn_back(&p, &random, at);
        }
        if (done) {
            vstore4((float4)(light.xyz, collisions > 0 ? 1.0f : 0.0f), ray, seen);
            const float4 counts = gone && collisions > 0 ? weight : (float4)(0.0f);
            vstore8((float8)(p.dx, p.dy, p.dz, lost ? 1.0f : 0.0f, counts), ray, left);
            violated += p.violated;
            ray += stride;
            fresh = 1;
            continue;
        }
        float distance = INFINITY;
        if (target >= 0) {
            p.dx = dx, p.dy = dy, p.dz = dz;
            due = weight * aim(&p, vload8(target, lights), mean_cosine, face, &distance);
        }
        p.i = i, p.j = j, p.k = k;
        here = at;
        start_flight(&p, g, &random);
        p.end = fmin(p.end, distance);
    }
    violations[get_global_id(0)] = violated;
}
