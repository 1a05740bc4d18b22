// SPDX-License-Identifier: GPL-3.0-or-later
// Photons on free paths: they scatter, lose weight by absorption, and score in a grid of tallies.
// The twin is transport/photons/paths_numpy.py. Built after photons/scatter.cl, with
//   KEEP_DIRECT  tally uncollided light, too
//   KEEP_FLUX    tally the flux, too
//   OCCLUSION    voxels are opaque; fine cells are voxels
//
// Scores are integers in units of UNIT, so their sum does not depend on the order in which a device
// works: a seed always gives the same result. A tally has 64 bits in two words of 32 bits, which
// every device can add atomically. All lower words come first in memory, because the upper ones are
// rarely needed. Quantities that are scored together lie side by side.

#define UNIT 0x1p24f // units in a weight of 1; a weight of up to 64 fits a signed word

// The contents of a voxel's tallies. A signed quantity q in [-1, 1] is counted as (1 + q) / 2.
// Uncollided light has one tally with KEEP_DIRECT, its weight. Scattered or reflected light has:
#define WEIGHT 0 // its weight
#define FLUX 1   // three, with KEEP_FLUX: weight times direction
#ifdef KEEP_FLUX
#define SCATTERED_TALLIES 4
#else
#define SCATTERED_TALLIES 1
#endif

// Photons that become a collision source have:
#define POWER 0     // their weight
#define POSITION 1  // three: weight times the position in the voxel, from -1/2 to 1/2
#define DIRECTION 4 // three: weight times the direction before the last collision
#define HANDOVER_TALLIES 7

// Sums of a work-item over all its photons.
#define ABSORBED 0
#define LEFT_THROUGH 1 // six: faces -x, +x, -y, +y, -z, +z
#define HANDOVER 7     // the weight of photons that become a collision source
#define LOST 8         // the weight of photons that took too many steps
#define LOST_PHOTONS 9 // their number; the sums below are numbers as well
#define VIOLATIONS 10
#define COLLISIONS 11
#define SUMS 12

static long in_units(const float weight)
{
    return (long)(int)(weight * UNIT + 0.5f);
}

static void add(__global uint *tally, const size_t upper, const float weight)
{
    const uint units = (uint)(int)(weight * UNIT + 0.5f);
    const uint before = atomic_add(tally, units);
    if (before + units < before)
        atomic_inc(tally + upper);
}

static void add_vector(__global uint *tally, const size_t upper, const float weight,
                       const float x, const float y, const float z)
{
    add(tally, upper, weight * (0.5f * x + 0.5f));
    add(tally + 1, upper, weight * (0.5f * y + 0.5f));
    add(tally + 2, upper, weight * (0.5f * z + 0.5f));
}

// The grid of tallies: voxel (0, 0, 0) begins at `lower`; edges are 1 / per_cell fine cells.
typedef struct {
    int nx, ny, nz;
    float lower, per_cell;
    size_t voxels;
} Tallies;

#define TALLIES_PARAMETERS                                                                 \
    const int tally_nx, const int tally_ny, const int tally_nz, const float tally_lower,   \
        const float per_cell
#define TALLIES                                                                            \
    (Tallies)                                                                              \
    {                                                                                      \
        tally_nx, tally_ny, tally_nz, tally_lower, per_cell,                               \
            (size_t)tally_nx *tally_ny *tally_nz                                           \
    }

// The voxel of a flight at `t`, and its place relative to the voxel's lower corner.
static size_t voxel_at(const Path *p, const Tallies v, const float t, float *x, float *y, float *z)
{
    *x = (p->ox + t * p->dx - v.lower) * v.per_cell;
    *y = (p->oy + t * p->dy - v.lower) * v.per_cell;
    *z = (p->oz + t * p->dz - v.lower) * v.per_cell;
    const int i = clamp((int)*x, 0, v.nx - 1);
    const int j = clamp((int)*y, 0, v.ny - 1);
    const int k = clamp((int)*z, 0, v.nz - 1);
    *x -= i;
    *y -= j;
    *z -= k;
    return ((size_t)i * v.ny + j) * v.nz + k;
}

// Score a flight up to its present point. Returns the place of the next score.
static float score(const Path *p, const Tallies v, float at, const float spacing,
                   const float weight, const int turned, __global uint *direct,
                   __global uint *scattered)
{
    for (; at < p->t; at += spacing) {
        float x, y, z;
        const size_t voxel = voxel_at(p, v, at, &x, &y, &z);
        if (turned) {
            __global uint *tally = scattered + SCATTERED_TALLIES * voxel;
            const size_t upper = SCATTERED_TALLIES * v.voxels;
            add(tally + WEIGHT, upper, weight);
#ifdef KEEP_FLUX
            add_vector(tally + FLUX, upper, weight, p->dx, p->dy, p->dz);
#endif
        }
#ifdef KEEP_DIRECT
        else
            add(direct + voxel, v.voxels, weight);
#endif
    }
    return at;
}

static void hand_over(const Path *p, const Tallies v, const float weight, __global uint *source)
{
    float x, y, z;
    const size_t voxel = voxel_at(p, v, p->t, &x, &y, &z);
    __global uint *tally = source + HANDOVER_TALLIES * voxel;
    const size_t upper = HANDOVER_TALLIES * v.voxels;
    add(tally + POWER, upper, weight);
    add_vector(tally + POSITION, upper, weight, clamp(x, 0.0f, 1.0f) - 0.5f,
               clamp(y, 0.0f, 1.0f) - 0.5f, clamp(z, 0.0f, 1.0f) - 0.5f);
    add_vector(tally + DIRECTION, upper, weight, p->dx, p->dy, p->dz);
}

// The face through which a flight leaves, in the order of LEFT_THROUGH.
static int face(const Path *p, const Grid g)
{
    const float x = ((p->dx >= 0.0f ? g.upper_x : g.lower) - p->ox) * p->ix;
    const float y = ((p->dy >= 0.0f ? g.upper_y : g.lower) - p->oy) * p->iy;
    const float z = ((p->dz >= 0.0f ? g.upper_z : g.lower) - p->oz) * p->iz;
    return x <= fmin(y, z) ? (p->dx >= 0.0f) : y <= z ? 2 + (p->dy >= 0.0f) : 4 + (p->dz >= 0.0f);
}

// photons    7 x count: origin in fine cells, unit direction, weight from 0 to 64
// copies     paths that start from each photon
// first      number of the first path
// spacing    between two scores of a path, the first at random: the expected score of a voxel is
//            the length of the path in it, over `spacing` (a track length estimator)
// last       the collision at which a photon becomes a collision source, or 0
// occlusion  share of the light that each voxel stops; its albedo is the reflected share of the
//            stopped light. Read only with OCCLUSION
__kernel void trace_photons(GRID_PARAMETERS, __global const float *photons, const int count,
                            const int copies, const uint seed, const uint first,
                            const int most_steps, const float albedo, const float mean_cosine,
                            const float spacing, const int last,
                            __global const float *occlusion,
                            __global const float *occlusion_albedo, TALLIES_PARAMETERS,
                            __global uint *direct, __global uint *scattered,
                            __global uint *source, __global long *sums)
{
    const Grid g = GRID;
    const Tallies v = TALLIES;
    const int stride = (int)get_global_size(0);
    int path = (int)get_global_id(0);
    int fresh = 1, steps = 0, collisions = 0, turned = 0;
    float weight = 0.0f, least = 0.0f, score_at = 0.0f;
    long sum[SUMS];
    for (int n = 0; n < SUMS; n++)
        sum[n] = 0;
    Path p;
    Place at;
    Random random;
    while (path < count * copies) {
        if (fresh) {
            enter(&p, g, photons, count, path / copies);
            weight = photons[6 * count + path / copies];
            least = weight * 0.1f;
            random = random_stream(seed, first + path);
            score_at = random_next(&random) * spacing;
            start_flight(&p, g, &random);
            fresh = steps = collisions = turned = 0;
            at = place_of(&p, g);
        }
        const int event = advance(&p, g, &random);
        steps++;
        if (event != COLLIDED && event != LEFT && steps < most_steps)
            continue;
        const int stopped = stop(&p, g, &random, occlusion, &at);
        const int left = event == LEFT && !stopped;
        const int lost = steps >= most_steps && !left;

        score_at = score(&p, v, score_at, spacing, weight, turned, direct, scattered);
        int done = left || lost;
        if (left) {
            const int through = face(&p, g);
            for (int n = 0; n < 6; n++) // not sum[... + through]: the sums stay in registers
                sum[LEFT_THROUGH + n] += n == through ? in_units(weight) : 0;
        } else if (lost) {
            sum[LOST] += in_units(weight);
            sum[LOST_PHOTONS]++;
        } else {
            turned = 1;
            collisions += !stopped;
            const float kept = weight * (stopped ? occlusion_albedo[at.by] : albedo);
            sum[ABSORBED] += in_units(weight) - in_units(kept);
            weight = kept;
            if (!stopped && collisions == last) {
                hand_over(&p, v, weight, source);
                sum[HANDOVER] += in_units(weight);
                done = 1;
            } else if (weight < least) { // Russian roulette, at even odds
                const int survives = random_next(&random) < 0.5f;
                sum[ABSORBED] += survives ? -in_units(weight) : in_units(weight);
                weight *= 2.0f;
                done = !survives || weight == 0.0f;
            }
            if (!done) {
                score_at -= p.t;
                if (stopped) {
                    land(&p, g, at);
                    turn_back(&p, &random, at);
                } else {
                    arrive(&p, g);
                    turn(&p, &random, mean_cosine);
                }
                start_flight(&p, g, &random);
            }
        }
        if (done) {
            sum[COLLISIONS] += collisions;
            sum[VIOLATIONS] += p.violated;
            path += stride;
            fresh = 1;
        }
    }
    for (int n = 0; n < SUMS; n++)
        sums[SUMS * get_global_id(0) + n] += sum[n];
}

// After batch number `batch`, counted from 1: add its score, the tally minus `before`, to the sum
// of squared deviations from the mean of the batches (Welford 1962).
__kernel void take_batch(__global const uint *scattered, const int batch, __global ulong *before,
                         __global float *deviation)
{
    const size_t voxel = get_global_id(0), tally = SCATTERED_TALLIES * voxel + WEIGHT;
    const size_t upper = SCATTERED_TALLIES * get_global_size(0);
    const ulong now = (ulong)scattered[upper + tally] << 32 | scattered[tally];
    if (now == 0)
        return;
    const float weight = (float)(now - before[voxel]) * (1.0f / UNIT);
    const float mean_before = batch > 1 ? (float)before[voxel] / (UNIT * (batch - 1)) : 0.0f;
    const float mean = (float)now / (UNIT * batch);
    deviation[voxel] += (weight - mean_before) * (weight - mean);
    before[voxel] = now;
}
