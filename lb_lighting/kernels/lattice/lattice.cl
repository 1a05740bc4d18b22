// SPDX-License-Identifier: GPL-3.0-or-later
// The physical lattice. The twin, transport/lattice/lattice_numpy.py, defines the quantities;
// lattice/layout.cl, which is built before this, defines their layout.
//
// Steps work in place. Before a step, the light that has arrived at a cell along m is in that cell,
// under m; or it is `swapped`: in the cell that it came from, under the opposite direction.
// `step_here` reads the first form and writes the second; `step_there` does the reverse. In both, a
// cell writes only to places that it alone reads.
//
// Built with the twin's constants W_AXIS, W_DIAGONAL, MEAN_LENGTH, SECOND_MOMENT, REFLECTED and
// DIAGONAL_BLOCKING, and with GROUP.

// Optical depths of voxels' edges. Outside the domain they are -1 minus the reflected share over
// REFLECTED.
#define MEDIUM                                                                             \
    __global const float *depths, const float first, const float second, const float loss

// The source: power, then drift.
#define SOURCE __global const float *source, const ulong cells

typedef struct {
    float even, odd, absorbed; // relaxation rates
    float drifted, lingered;   // effective lengths of the voxel, for the drift and the fluence
} Rates;

// The rates of light that crosses `length` of a voxel.
static Rates rates(const float length, const float depth, const float first, const float second,
                   const float loss)
{
    const float crossed = length * depth;
    const float t = crossed * first, e = crossed * second, a = crossed * loss;
    const float third = 0.125f * t < 0.5f ? 0.125f * t : 0.5f; // not fmin: PoCL calls it
    Rates r;
    const float over_t = 1.0f / (1.0f + 0.5f * t), over_a = 1.0f / (1.0f + 0.5f * a);
    r.odd = t * over_t;
    r.even = e / (1.0f + e * (third + 0.5f));
    r.absorbed = a * over_a;
    r.drifted = length * over_t;
    r.lingered = length * over_a;
    return r;
}

#define ADD_PAIR(m, back, cx, cy, cz) sum += f[m] + f[back];

// The density of the isotropic light, with weights w, to which collisions relax the light f.
static float isotropic(const float *f, const Rates axis, const Rates diagonal)
{
    const float pull_axis = axis.even > 0.0f ? axis.even : 1.0f;
    const float pull_diagonal = axis.even > 0.0f ? diagonal.even : DIAGONAL;
    float sum = 0.0f;
    FOR_EACH_AXIS(ADD_PAIR)
    const float along_axes = sum;
    sum = 0.0f;
    FOR_EACH_DIAGONAL(ADD_PAIR)
    return (pull_axis * along_axes + pull_diagonal * sum) /
           (6 * W_AXIS * pull_axis + 12 * W_DIAGONAL * pull_diagonal);
}

// A cell's rates, and its share of the source.
#define LOOK_AT_MEDIUM                                                                     \
    const float depth = depths[cell] < 0.0f ? 0.0f : depths[cell];                         \
    const Rates axis = rates(1.0f, depth, first, second, loss);                            \
    const Rates diagonal = rates(DIAGONAL, depth, first, second, loss);
#define LOOK                                                                               \
    LOOK_AT_MEDIUM                                                                         \
    const float emitted = source[cell] / MEAN_LENGTH;                                      \
    const float gx = source[cells + cell], gy = source[2 * cells + cell],                  \
                gz = source[3 * cells + cell];

// --- Steps ----------------------------------------------------------------------------------

#define COLLIDE(m, back, cx, cy, cz)                                                       \
    {                                                                                      \
        const float even = 0.5f * (f[m] + f[back]), odd = 0.5f * (f[m] - f[back]);         \
        const float e = even - r.even * even + gained;                                     \
        const float o = odd - r.odd * odd + pushed * ((cx)*gx + (cy)*gy + (cz)*gz);        \
        const float ahead = live * (e + o) + share * f[back] + GIVEN(m);                   \
        const float behind = live * (e - o) + share * f[m] + GIVEN(back);                  \
        LEAVE(m, back, STEP(cx, cy, cz), ahead, behind)                                    \
    }

#define UPDATE                                                                             \
    const float live = depths[cell] < 0.0f ? 0.0f : 1.0f;                                  \
    const float share = depths[cell] < 0.0f ? REFLECTED * (-1.0f - depths[cell]) : 0.0f;   \
    float f[DIRECTIONS];                                                                   \
    FOR_EACH_PAIR(TAKE)                                                                    \
    const float density = isotropic(f, axis, diagonal);                                    \
    {                                                                                      \
        const Rates r = axis;                                                              \
        const float gained = W_AXIS * ((r.even - r.absorbed) * density + emitted * r.lingered); \
        const float pushed = W_AXIS / SECOND_MOMENT * r.drifted;                           \
        FOR_EACH_AXIS(COLLIDE)                                                             \
    }                                                                                      \
    {                                                                                      \
        const Rates r = diagonal;                                                          \
        const float gained = W_DIAGONAL * ((r.even - r.absorbed) * density + emitted * r.lingered); \
        const float pushed = W_DIAGONAL / SECOND_MOMENT * r.drifted;                       \
        FOR_EACH_DIAGONAL(COLLIDE)                                                         \
    }

// The two steps in place. Those of the finest lattice add the source; those of coarser ones add the
// restricted light of each direction.
#define STEP_OF_SOURCE                                                                     \
    const size_t cell = get_global_id(0);                                                  \
    LOOK                                                                                   \
    UPDATE
#define STEP_OF_GIVEN                                                                      \
    const size_t cell = get_global_id(0);                                                  \
    LOOK_AT_MEDIUM                                                                         \
    const float emitted = 0.0f, gx = 0.0f, gy = 0.0f, gz = 0.0f;                           \
    UPDATE
#define STEP_KERNEL __kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void

#define TAKE TAKE_HERE
#define LEAVE LEAVE_HERE
#define GIVEN(m) 0.0f
STEP_KERNEL step_here(GRID, MEDIUM, SOURCE, __global float *light)
{
    STEP_OF_SOURCE
}
#undef GIVEN
#define GIVEN(m) given[(m)*stride + guard + cell]
STEP_KERNEL step_coarser_here(GRID, MEDIUM, __global const float *given, __global float *light)
{
    STEP_OF_GIVEN
}

#undef TAKE
#undef LEAVE
#define TAKE TAKE_THERE
#define LEAVE LEAVE_THERE
STEP_KERNEL step_coarser_there(GRID, MEDIUM, __global const float *given, __global float *light)
{
    STEP_OF_GIVEN
}
#undef GIVEN
#define GIVEN(m) 0.0f
STEP_KERNEL step_there(GRID, MEDIUM, SOURCE, __global float *light)
{
    STEP_OF_SOURCE
}

// --- Reflection where a medium ends within the domain ------------------------------------------

#define OUTWARD(m, back, cx, cy, cz)                                                       \
    {                                                                                      \
        const int along = (cx)*ox + (cy)*oy + (cz)*oz;                                     \
        if (along != 0) {                                                                  \
            const int out = along > 0 ? (m) : (back), in = along > 0 ? (back) : (m);       \
            const long step = along * (long)STEP(cx, cy, cz);                              \
            __global float *ahead = &ARRIVED(out, in, cell + step, step);                  \
            __global float *behind = &ARRIVED(in, out, cell - step, -step);                \
            *behind += share * *ahead;                                                     \
            *ahead -= share * *ahead;                                                      \
        }                                                                                  \
    }

// Reflects light that has just left empty cells in the five directions of a face. at: the cells;
// faces: 0 to 5 for -x, +x, -y, +y, -z, +z; shares: of the light that are reflected.
__kernel void mirror(GRID, __global float *light, const int swapped, __global const int *at,
                     __global const int *faces, __global const float *shares)
{
    const size_t n = get_global_id(0), cell = at[n];
    const int face = faces[n], sign = face % 2 ? 1 : -1;
    const int ox = face / 2 == 0 ? sign : 0, oy = face / 2 == 1 ? sign : 0;
    const int oz = face / 2 == 2 ? sign : 0;
    const float share = shares[n];
    FOR_EACH_PAIR(OUTWARD)
}

// --- Opaque voxels ------------------------------------------------------------------------------

// For light that arrives at a cell along (cx, cy, cz) from the one upstream: BESIDE, the share OF of
// the two voxels beside a diagonal, 0 along axes; and PAST, the share that they let pass.
#define OPAQUE(cell) occlusion[cell]
#define REFLECTING(cell) (occlusion[cell] * occlusion_albedo[cell])
#define ABSORBING(cell) (occlusion[cell] * (1.0f - occlusion_albedo[cell]))
#define IS_DIAGONAL(cx, cy, cz) ((cx) * (cx) + (cy) * (cy) + (cz) * (cz) == 2)
#define MEAN_BESIDE(OF, to, cx, cy, cz)                                                    \
    (0.5f * (((cx) ? OF((to)-STEP(cx, 0, 0)) : 0.0f) + ((cy) ? OF((to)-STEP(0, cy, 0)) : 0.0f) + \
             ((cz) ? OF((to)-STEP(0, 0, cz)) : 0.0f)))
#define BESIDE(OF, to, cx, cy, cz)                                                         \
    (IS_DIAGONAL(cx, cy, cz)                                                               \
         ? MEAN_BESIDE(OF, to, cx, cy, cz) *                                               \
               (1.0f + DIAGONAL_BLOCKING * (1.0f - MEAN_BESIDE(OPAQUE, to, cx, cy, cz)))             \
         : 0.0f)
#define PAST(to, cx, cy, cz) (1.0f - BESIDE(OPAQUE, to, cx, cy, cz))
#define SHARE_OF(OF, to, cx, cy, cz)                                                       \
    (BESIDE(OF, to, cx, cy, cz) + PAST(to, cx, cy, cz) * OF(to))
#define WEIGHT(cx, cy, cz) (IS_DIAGONAL(cx, cy, cz) ? W_DIAGONAL : W_AXIS)
#define IS_INSIDE(cell) (depths[cell] >= 0.0f)

#define OCCLUDERS                                                                          \
    __global const float *depths, __global const float *occlusion,                         \
        __global const float *occlusion_albedo, __global const int *at

#define GATHER_ONE(m, back, cx, cy, cz)                                                    \
    {                                                                                      \
        const size_t to = cell + STEP(cx, cy, cz);                                         \
        if (IS_INSIDE(to)) {                                                               \
            const float share = SHARE_OF(REFLECTING, to, cx, cy, cz);                      \
            returning += share * ARRIVED(m, back, to, STEP(cx, cy, cz));                   \
            spread += share * WEIGHT(cx, cy, cz);                                          \
        }                                                                                  \
    }
#define GATHER(m, back, cx, cy, cz)                                                        \
    GATHER_ONE(m, back, cx, cy, cz)                                                        \
    GATHER_ONE(back, m, -(cx), -(cy), -(cz))

// densities: of the isotropic light that is reflected into each of the cells `at`; reflected: as in
// the twin's source
__kernel void reflect(GRID, __global const float *light, const int swapped, OCCLUDERS,
                      __global const float *reflected, __global float *densities)
{
    const size_t cell = at[get_global_id(0)];
    float returning = reflected[cell], spread = 0.0f;
    FOR_EACH_PAIR(GATHER)
    densities[cell] = spread > 0.0f ? returning / spread : 0.0f;
}

#define MEET_ONE(m, back, cx, cy, cz)                                                      \
    {                                                                                      \
        const size_t to = cell + STEP(cx, cy, cz);                                         \
        if (IS_INSIDE(to)) {                                                               \
            __global float *arriving = &ARRIVED(m, back, to, STEP(cx, cy, cz));            \
            const float share = SHARE_OF(REFLECTING, cell, -(cx), -(cy), -(cz));           \
            absorbed += *arriving * SHARE_OF(ABSORBING, to, cx, cy, cz);                   \
            *arriving = *arriving * PAST(to, cx, cy, cz) * (1.0f - occlusion[to]) +        \
                        WEIGHT(cx, cy, cz) * share * densities[to];                        \
        }                                                                                  \
    }
#define MEET(m, back, cx, cy, cz)                                                          \
    MEET_ONE(m, back, cx, cy, cz)                                                          \
    MEET_ONE(back, m, -(cx), -(cy), -(cz))

// Stops light that has just left the cells `at`. stopped: the light that is absorbed.
__kernel void meet(GRID, __global float *light, const int swapped, OCCLUDERS,
                   __global const float *densities, __global float *stopped)
{
    const size_t cell = at[get_global_id(0)];
    float absorbed = 0.0f;
    FOR_EACH_PAIR(MEET)
    stopped[get_global_id(0)] = absorbed;
}

// --- Read-out ----------------------------------------------------------------------------------

#define READ(m, back, cx, cy, cz)                                                          \
    f[m] = ARRIVED(m, back, cell, STEP(cx, cy, cz));                                       \
    f[back] = ARRIVED(back, m, cell, -STEP(cx, cy, cz));

// The cell of a work-item's voxel in the range (nz, ny, nx), in every n-th layer; `origin` is the
// cell of the first voxel.
#define LOOK_AT_VOXEL                                                                      \
    const size_t z = get_global_id(0), y = get_global_id(1), x = get_global_id(2);         \
    const size_t voxel = (x * get_global_size(1) + y) * get_global_size(0) + z;            \
    const size_t cell = origin + STEP(x * every, y, z);                                    \
    LOOK                                                                                   \
    float f[DIRECTIONS];                                                                   \
    FOR_EACH_PAIR(READ)

__kernel void read_fluence(GRID, __global const float *light, const int swapped, MEDIUM, SOURCE,
                           const ulong origin, const ulong every, __global float *fluence)
{
    LOOK_AT_VOXEL
    const float density = isotropic(f, axis, diagonal), half_emitted = 0.5f * emitted;
    fluence[voxel] = 6 * W_AXIS * (density + half_emitted) * axis.lingered +
                     12 * W_DIAGONAL * (density + DIAGONAL * half_emitted) * diagonal.lingered;
}

#define ADD_FLUX(m, back, cx, cy, cz)                                                      \
    {                                                                                      \
        const float flow = (f[m] - f[back]) * kept +                                       \
                           pushed * ((cx)*gx + (cy)*gy + (cz)*gz);                         \
        jx += (cx)*flow;                                                                   \
        jy += (cy)*flow;                                                                   \
        jz += (cz)*flow;                                                                   \
    }

__kernel void read_flux(GRID, __global const float *light, const int swapped, MEDIUM, SOURCE,
                        const ulong origin, const ulong every, __global float *flux)
{
    LOOK_AT_VOXEL
    const size_t voxels = get_global_size(0) * get_global_size(1) * get_global_size(2);
    float jx = 0.0f, jy = 0.0f, jz = 0.0f;
    {
        const float kept = 1.0f - 0.5f * axis.odd;
        const float pushed = W_AXIS / SECOND_MOMENT * axis.drifted;
        FOR_EACH_AXIS(ADD_FLUX)
    }
    {
        const float kept = 1.0f - 0.5f * diagonal.odd;
        const float pushed = W_DIAGONAL / SECOND_MOMENT * diagonal.drifted;
        FOR_EACH_DIAGONAL(ADD_FLUX)
    }
    flux[voxel] = jx;
    flux[voxels + voxel] = jy;
    flux[2 * voxels + voxel] = jz;
}

// Light that has left the domain along m, through the first face on its path.
#define ADD_LEFT(m, back, cx, cy, cz)                                                      \
    if (at_end(cx, x, nx) || at_end(cy, y, ny) || at_end(cz, z, nz)) {                     \
        const size_t to = cell + STEP(cx, cy, cz);                                         \
        const float share = REFLECTED * (-1.0f - depths[to]);                              \
        const float leaving = (1.0f - share) * ARRIVED(m, back, to, STEP(cx, cy, cz));     \
        if (at_end(cx, x, nx))                                                             \
            sum[(cx) > 0] += leaving;                                                      \
        else if (at_end(cy, y, ny))                                                        \
            sum[2 + ((cy) > 0)] += leaving;                                                \
        else                                                                               \
            sum[4 + ((cz) > 0)] += leaving;                                                \
    }
#define ADD_LEFT_PAIR(m, back, cx, cy, cz)                                                 \
    ADD_LEFT(m, back, cx, cy, cz) ADD_LEFT(back, m, -(cx), -(cy), -(cz))

static int at_end(const int c, const int place, const int count)
{
    return c < 0 ? place == 0 : c > 0 && place == count - 1;
}

// left: 6 x nz, through the faces -x, +x, -y, +y, -z, +z, summed over x and y.
__kernel void read_left(GRID, __global const float *light, const int swapped,
                        __global const float *depths, const ulong origin, const int nx,
                        const int ny, __global float *left)
{
    const int z = (int)get_global_id(0), nz = (int)get_global_size(0);
    float sum[6] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
    for (int x = 0; x < nx; x++)
        for (int y = 0; y < ny; y++) {
            const size_t cell = origin + STEP((ulong)x, (ulong)y, (ulong)z);
            FOR_EACH_PAIR(ADD_LEFT_PAIR)
        }
    for (int n = 0; n < 6; n++)
        left[n * nz + z] = sum[n];
}
