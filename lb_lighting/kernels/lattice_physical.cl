// SPDX-License-Identifier: GPL-3.0-or-later
// One step of the physical lattice, and its read-out. transport/physical_numpy.py is the twin and
// says what the quantities are.
//
// The light of direction m lies at m * stride + guard on, voxel by voxel, z fastest, so that the
// voxel upstream is always a fixed number of floats away; what is read beyond the domain's faces
// is other light, or the guard, and is not used.
//
// Built with the numbers of the twin W_AXIS, W_DIAGONAL, MEAN_LENGTH, SECOND_MOMENT, REFLECTED and
// CROWDED, and OCCLUSION where there is any.

#define DIAGONAL 1.41421356f
#define DIRECTIONS 18

// Pairs of opposite directions: their numbers, the components of the first, its kind.
#define FOR_EACH_AXIS(DO) DO(0, 1, 1, 0, 0) DO(2, 3, 0, 1, 0) DO(4, 5, 0, 0, 1)
#define FOR_EACH_DIAGONAL(DO)                                                              \
    DO(6, 9, 1, 1, 0)                                                                      \
    DO(7, 8, 1, -1, 0)                                                                     \
    DO(10, 13, 1, 0, 1)                                                                    \
    DO(11, 12, 1, 0, -1)                                                                   \
    DO(14, 17, 0, 1, 1)                                                                    \
    DO(15, 16, 0, 1, -1)
#define FOR_EACH_PAIR(DO) FOR_EACH_AXIS(DO) FOR_EACH_DIAGONAL(DO)

// The grid (voxels; floats from one direction's light to the next one's, and before the first), the
// light, the medium and the source.
#define PARAMETERS                                                                         \
    const int nx, const int ny, const int nz, const uint stride_floats, const uint guard,  \
        __global const float *light, __global const float *depths,                         \
        __global const uchar *open_faces,                                                  \
        __global const float *power, __global const float *drift,                          \
        __global const float *reflections,                                                 \
        __global const float *occlusion, __global const float *occlusion_albedo,           \
        const float first, const float second, const float loss

typedef struct {
    float even, odd, absorbed; // shares that a step changes
    float drifted, lingered;   // length of the voxel that counts, for the drift and the fluence
} Rates;

// Of light that crosses `length` of a voxel.
inline Rates rates(const float length, const float depth, const float first, const float second,
                   const float loss)
{
    const float crossed = length * depth;
    const float t = crossed * first, a = crossed * loss;
    Rates r;
    r.odd = 1.0f / (1.0f / t + 0.5f);
    r.even = 1.0f / (1.0f / (crossed * second) + fmin(0.125f * t, 0.5f) + 0.5f);
    r.absorbed = 1.0f / (1.0f / a + 0.5f);
    r.drifted = length / (1.0f + 0.5f * t);
    r.lingered = length / (1.0f + 0.5f * a);
    return r;
}

// The share of light leaving a voxel through an open face that comes back.
inline float returned(const int longest, const float depth, const float first)
{
    return REFLECTED / (1.0f + 1.0f / (longest * depth * first));
}

// Whether the voxel that lies (cx, cy, cz) upstream of (x, y, z) is in the domain.
#define IS_INSIDE(cx, cy, cz)                                                              \
    (((cx) == 0 || ((cx) > 0 ? x > 0 : x < nx - 1)) &&                                     \
     ((cy) == 0 || ((cy) > 0 ? y > 0 : y < ny - 1)) &&                                     \
     ((cz) == 0 || ((cz) > 0 ? z > 0 : z < nz - 1)))

#define STEP(cx, cy, cz) (((cx) * ny + (cy)) * nz + (cz))

// The bits of the faces that light leaves a voxel by, going (cx, cy, cz).
#define THROUGH(cx, cy, cz)                                                                \
    (((cx) < 0 ? 1 : 0) | ((cx) > 0 ? 2 : 0) | ((cy) < 0 ? 4 : 0) | ((cy) > 0 ? 8 : 0) |   \
     ((cz) < 0 ? 16 : 0) | ((cz) > 0 ? 32 : 0))
#define IS_OPEN(cx, cy, cz) (faces & THROUGH(cx, cy, cz))


#define OUT(m) light[(m) * stride + guard + voxel]
#define CAME(m, step) light[(m) * stride + guard + voxel - (step)]

// What opaque voxels stop of light between a voxel and the one (cx, cy, cz) upstream of it, either
// way: BESIDE, by the two voxels that a diagonal leads between, and what then is left, PAST.
#ifdef OCCLUSION
#define OPAQUE(voxel) occlusion[voxel]
#define REFLECTING(voxel) (occlusion[voxel] * occlusion_albedo[voxel])
#define ABSORBING(voxel) (occlusion[voxel] * (1.0f - occlusion_albedo[voxel]))
#define IS_DIAGONAL(cx, cy, cz) ((cx) * (cx) + (cy) * (cy) + (cz) * (cz) == 2)
#define MEAN_BESIDE(OF, cx, cy, cz)                                                        \
    (0.5f * (((cx) ? OF(voxel - STEP(cx, 0, 0)) : 0.0f) +                                  \
             ((cy) ? OF(voxel - STEP(0, cy, 0)) : 0.0f) +                                  \
             ((cz) ? OF(voxel - STEP(0, 0, cz)) : 0.0f)))
#define BESIDE(OF, cx, cy, cz)                                                             \
    (IS_DIAGONAL(cx, cy, cz)                                                               \
         ? MEAN_BESIDE(OF, cx, cy, cz) *                                                   \
               (1.0f + CROWDED * (1.0f - MEAN_BESIDE(OPAQUE, cx, cy, cz)))                 \
         : 0.0f)
#define PAST(cx, cy, cz) (1.0f - BESIDE(OPAQUE, cx, cy, cz))
#define PASSED(cx, cy, cz) (PAST(cx, cy, cz) * (1.0f - occlusion[voxel]))
#else
#define PASSED(cx, cy, cz) 1.0f
#endif

// What flows into a voxel along m: what came from the voxel upstream, if there is any, and at open
// faces some of what went there.
#define PULL_ONE(m, back, cx, cy, cz)                                                      \
    f[m] = IS_INSIDE(cx, cy, cz) ? CAME(m, STEP(cx, cy, cz)) * PASSED(cx, cy, cz) : 0.0f;  \
    f[m] += IS_OPEN(-(cx), -(cy), -(cz)) ? OUT(back) * comes_back : 0.0f;
#define PULL(m, back, cx, cy, cz)                                                          \
    PULL_ONE(m, back, cx, cy, cz)                                                          \
    PULL_ONE(back, m, -(cx), -(cy), -(cz))

// What opaque voxels around a voxel send back into it goes off evenly away from all of them.
#ifdef OCCLUSION
#define MEET(m, cx, cy, cz)                                                                \
    away[m] = IS_INSIDE(cx, cy, cz)                                                        \
                  ? BESIDE(REFLECTING, cx, cy, cz) +                                       \
                        PAST(cx, cy, cz) * REFLECTING(voxel - STEP(cx, cy, cz))            \
                  : 0.0f;
#define MEET_PAIR(m, back, cx, cy, cz)                                                     \
    MEET(m, cx, cy, cz)                                                                    \
    MEET(back, -(cx), -(cy), -(cz))                                                        \
    reflected += away[m] * OUT(back);                                                      \
    reflected += away[back] * OUT(m);
#define ADD_AWAY(m, back, cx, cy, cz) sum += away[m] + away[back];
#define SEND_BACK(m, back, cx, cy, cz)                                                     \
    f[m] += away[m] * density;                                                             \
    f[back] += away[back] * density;
#define REFLECT                                                                            \
    {                                                                                      \
        float away[DIRECTIONS], reflected = reflections[voxel], sum = 0.0f;                \
        FOR_EACH_PAIR(MEET_PAIR)                                                           \
        FOR_EACH_AXIS(ADD_AWAY)                                                            \
        const float along_axes = sum;                                                      \
        sum = 0.0f;                                                                        \
        FOR_EACH_DIAGONAL(ADD_AWAY)                                                        \
        const float total = W_AXIS * along_axes + W_DIAGONAL * sum;                        \
        if (total > 0.0f) {                                                                \
            {                                                                              \
                const float density = W_AXIS * (reflected / total);                        \
                FOR_EACH_AXIS(SEND_BACK)                                                   \
            }                                                                              \
            {                                                                              \
                const float density = W_DIAGONAL * (reflected / total);                    \
                FOR_EACH_DIAGONAL(SEND_BACK)                                               \
            }                                                                              \
        }                                                                                  \
    }
#else
#define REFLECT
#endif

#define LOCATE                                                                             \
    const size_t voxels = (size_t)nx * ny * nz, stride = stride_floats;                    \
    const size_t voxel = get_global_id(0);                                                 \
    if (voxel >= voxels)                                                                   \
        return;                                                                            \
    const int z = (int)(voxel % nz), row = (int)(voxel / nz), y = row % ny, x = row / ny;

// How a step begins, and all that is read of one: a voxel's rates, and the light f that flows in.
#define GATHER                                                                             \
    LOCATE                                                                                 \
    const Rates axis = rates(1.0f, depths[voxel], first, second, loss);                    \
    const Rates diagonal = rates(DIAGONAL, depths[voxel], first, second, loss);            \
    const float share = returned(max(nx, max(ny, nz)), depths[voxel], first);              \
    const float comes_back = share / (1.0f - share);                                       \
    const int faces = open_faces[voxel];                                                   \
    float f[DIRECTIONS];                                                                   \
    FOR_EACH_PAIR(PULL)                                                                    \
    REFLECT

#define ADD_PAIR(m, back, cx, cy, cz) sum += f[m] + f[back];

// The density that collisions lead to, of all light f, in isotropic light of weights w.
inline float isotropic(const float *f, const Rates axis, const Rates diagonal)
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

#define COLLIDE(m, back, cx, cy, cz)                                                       \
    {                                                                                      \
        const float even = 0.5f * (f[m] + f[back]), odd = 0.5f * (f[m] - f[back]);         \
        const float e = even - r.even * even + gained;                                     \
        const float o = odd - r.odd * odd + pushed * ((cx)*gx + (cy)*gy + (cz)*gz);        \
        const float ahead = IS_OPEN(cx, cy, cz) ? 1.0f - share : 1.0f;                     \
        const float behind = IS_OPEN(-(cx), -(cy), -(cz)) ? 1.0f - share : 1.0f;           \
        next[m * stride + guard + voxel] = ahead * (e + o);                                \
        next[back * stride + guard + voxel] = behind * (e - o);                            \
    }

__kernel void update(PARAMETERS, __global float *next)
{
    GATHER
    const float density = isotropic(f, axis, diagonal), emitted = power[voxel] / MEAN_LENGTH;
    const float gx = drift[voxel], gy = drift[voxels + voxel], gz = drift[2 * voxels + voxel];
    {
        const Rates r = axis;
        const float gained = W_AXIS * ((r.even - r.absorbed) * density +
                                       emitted * (1.0f - 0.5f * r.absorbed));
        const float pushed = W_AXIS / SECOND_MOMENT * r.drifted;
        FOR_EACH_AXIS(COLLIDE)
    }
    {
        const Rates r = diagonal;
        const float gained = W_DIAGONAL * ((r.even - r.absorbed) * density +
                                           DIAGONAL * emitted * (1.0f - 0.5f * r.absorbed));
        const float pushed = W_DIAGONAL / SECOND_MOMENT * r.drifted;
        FOR_EACH_DIAGONAL(COLLIDE)
    }
}

__kernel void read_fluence(PARAMETERS, __global float *fluence)
{
    GATHER
    const float density = isotropic(f, axis, diagonal);
    const float half_emitted = 0.5f * power[voxel] / MEAN_LENGTH;
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

__kernel void read_flux(PARAMETERS, __global float *flux)
{
    GATHER
    const float gx = drift[voxel], gy = drift[voxels + voxel], gz = drift[2 * voxels + voxel];
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

// Light of one direction that leaves the domain, by the first face of those it passes, and what
// the occluder downstream keeps of it.
#define ADD_LOST(m, cx, cy, cz)                                                            \
    if (IS_INSIDE(-(cx), -(cy), -(cz))) {                                                  \
        ADD_STOPPED(m, -(cx), -(cy), -(cz))                                                \
    } else {                                                                               \
        if (!IS_INSIDE(-(cx), 0, 0))                                                       \
            sum[(cx) > 0] += OUT(m);                                                       \
        else if (!IS_INSIDE(0, -(cy), 0))                                                  \
            sum[2 + ((cy) > 0)] += OUT(m);                                                 \
        else                                                                               \
            sum[4 + ((cz) > 0)] += OUT(m);                                                 \
    }
#ifdef OCCLUSION
#define ADD_STOPPED(m, cx, cy, cz)                                                         \
    sum[6] += OUT(m) * (BESIDE(ABSORBING, cx, cy, cz) +                                    \
                        PAST(cx, cy, cz) * ABSORBING(voxel - STEP(cx, cy, cz)));
#else
#define ADD_STOPPED(m, cx, cy, cz)
#endif
#define ADD_LOST_PAIR(m, back, cx, cy, cz)                                                 \
    ADD_LOST(m, cx, cy, cz) ADD_LOST(back, -(cx), -(cy), -(cz))

// lost  7 x nz: through the faces -x, +x, -y, +y, -z, +z, and stopped; summed over x and y.
__kernel void read_lost(PARAMETERS, __global float *lost)
{
    const size_t stride = stride_floats;
    const int z = (int)get_global_id(0);
    float sum[7] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
    for (int x = 0; x < nx; x++)
        for (int y = 0; y < ny; y++) {
            const size_t voxel = ((size_t)x * ny + y) * nz + z;
            FOR_EACH_PAIR(ADD_LOST_PAIR)
        }
    for (int n = 0; n < 7; n++)
        lost[n * nz + z] = sum[n];
}
