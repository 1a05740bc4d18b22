// SPDX-License-Identifier: GPL-3.0-or-later
// The first collisions of rays. Built after photons/paths.cl; the twin is
// transport/photons/paths_numpy.py.

// The distance to the first real collision of each ray: infinite if it leaves the domain, NaN if it
// takes more than `most_steps` steps. Each work-item counts the real and virtual particles that its
// rays meet, and the rays whose majorant is violated. It takes the next ray as soon as it has
// finished one, so that all lanes of a vector stay busy.
__kernel void free_paths(GRID_PARAMETERS, __global const float *rays,
                         __global const uint *indices, const int count, const uint seed,
                         const int most_steps,
                         __global float *distances, __global int *particles,
                         __global int *violations)
{
    const Grid g = GRID;
    const int stride = (int)get_global_size(0);
    int ray = (int)get_global_id(0);
    int fresh = 1, steps = 0, met = 0, violated = 0;
    Path p;
    Random random;
    while (ray < count) {
        if (fresh) {
            enter(&p, g, rays, count, ray);
            random = random_stream(seed, indices[ray]);
            start_flight(&p, g, &random);
            fresh = 0;
            steps = 0;
        }
        const int event = advance(&p, g, &random);
        steps++;
        met += event == VIRTUAL || event == COLLIDED;
        if (event == COLLIDED || event == LEFT || steps >= most_steps) {
            distances[ray] = event == COLLIDED ? p.t : event == LEFT ? INFINITY : NAN;
            violated += p.violated;
            ray += stride;
            fresh = 1;
        }
    }
    particles[get_global_id(0)] = met;
    violations[get_global_id(0)] = violated;
}
