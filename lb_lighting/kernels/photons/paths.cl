// SPDX-License-Identifier: GPL-3.0-or-later
// The steps of free path sampling (paper 2): a ray goes from super-voxel to super-voxel and meets
// real and virtual particles, which add up to the majorant of the density. The twin is
// transport/photons/walk.py.
//
// Lengths are in fine cells. Built after photons/random.cl with
//   RAY_MARCH or WOODCOCK       else super-voxels
//   POLYNOMIAL                  the majorant of a super-voxel is trilinear, else constant
//   LINEAR                      the density is linear between nodes, else constant in fine cells
//   PERLIN_MEDIUM               the density is a function, that of photons/perlin.cl, built before this

typedef struct {
    __global const float *density; // fine cells, or nodes, one more along each edge, if LINEAR
    __global const float *bound;   // majorants: one value for each super-voxel, eight if POLYNOMIAL
    int nx, ny, nz;                // fine cells
    int mx, my, mz;                // super-voxels
    int size;                      // fine cells along an edge of a super-voxel
    float lower, upper_x, upper_y, upper_z;
    float majorant;                // of the whole domain
    float per_depth;               // density times length in fine cells per unit optical depth
#ifdef PERLIN_MEDIUM
    Perlin noise;
#endif
} Grid;

#ifdef PERLIN_MEDIUM
#define MEDIUM_PARAMETERS PERLIN_PARAMETERS
#define MEDIUM 0
#else
#define MEDIUM_PARAMETERS __global const float *density
#define MEDIUM density
#endif

#define GRID_PARAMETERS                                                                    \
    MEDIUM_PARAMETERS, __global const float *bound, const int nx, const int ny,            \
        const int nz, const int mx, const int my, const int mz, const int size,            \
        const float lower, const float upper_x, const float upper_y, const float upper_z,  \
        const float majorant, const float per_depth
#ifdef PERLIN_MEDIUM
#define GRID                                                                               \
    (Grid)                                                                                 \
    {                                                                                      \
        0, bound, nx, ny, nz, mx, my, mz, size, lower, upper_x, upper_y, upper_z,          \
            majorant, per_depth, PERLIN                                                    \
    }
#else
#define GRID                                                                               \
    (Grid)                                                                                 \
    {                                                                                      \
        density, bound, nx, ny, nz, mx, my, mz, size, lower, upper_x, upper_y, upper_z,    \
            majorant, per_depth                                                            \
    }
#endif

typedef struct {
    float ox, oy, oz;    // where the flight started
    float dx, dy, dz;    // unit vector
    float ix, iy, iz;    // 1 / d, finite
    float t, end;        // its length so far; where it leaves the domain
    float tx, ty, tz;    // where it crosses the next face of its super-voxel, by axis
    int i, j, k;         // super-voxel
    float depth;         // density times length until the next particle
    float limit;         // the majorant in this super-voxel, if it is constant
    int violated;        // whether a density exceeded its majorant
} Path;

// The event that ended a step of a path.
#define CROSSED 0  // on the border of two super-voxels
#define VIRTUAL 1  // at a virtual particle
#define COLLIDED 2 // at a real one
#define LEFT 3     // outside

#define TOLERATED 1.0001f // largest ratio of density to majorant; rounding explains less
#define SLOWEST 1e-18f // components of a direction closer to zero are replaced by this

static float inverse(const float d)
{
    return 1.0f / (d >= 0.0f ? fmax(d, SLOWEST) : fmin(d, -SLOWEST));
}

// Where a flight crosses the face of cell `cell` that is ahead.
static float crossing(const int cell, const int size, const float o, const float d, const float i)
{
    return ((float)((cell + (d >= 0.0f)) * size) - o) * i;
}

static float constant_bound(const Path *p, const Grid g)
{
#if defined(WOODCOCK)
    return g.majorant;
#elif defined(POLYNOMIAL) || defined(RAY_MARCH) && defined(PERLIN_MEDIUM)
    return 0.0f; // not used
#else
    return g.bound[(p->i * g.my + p->j) * g.mz + p->k];
#endif
}

// Density times length until the next particle.
static float next_depth(const Grid g, Random *random)
{
    return -log(random_next(random)) * g.per_depth;
}

// A new path: ray `n` of `count`, whose origins and directions are stored component by component.
static void enter(Path *p, const Grid g, __global const float *rays, const int count, const int n)
{
    p->ox = rays[n];
    p->oy = rays[count + n];
    p->oz = rays[2 * count + n];
    p->dx = rays[3 * count + n];
    p->dy = rays[4 * count + n];
    p->dz = rays[5 * count + n];
    p->i = clamp((int)p->ox / g.size, 0, g.mx - 1);
    p->j = clamp((int)p->oy / g.size, 0, g.my - 1);
    p->k = clamp((int)p->oz / g.size, 0, g.mz - 1);
    p->violated = 0;
}

// A new flight from (ox, oy, oz), in the path's super-voxel, along (dx, dy, dz).
static void start_flight(Path *p, const Grid g, Random *random)
{
    p->ix = inverse(p->dx);
    p->iy = inverse(p->dy);
    p->iz = inverse(p->dz);
    p->t = 0.0f;
    p->end = fmin(((p->dx >= 0.0f ? g.upper_x : g.lower) - p->ox) * p->ix,
                  fmin(((p->dy >= 0.0f ? g.upper_y : g.lower) - p->oy) * p->iy,
                       ((p->dz >= 0.0f ? g.upper_z : g.lower) - p->oz) * p->iz));
    p->depth = next_depth(g, random);
#ifndef WOODCOCK
    p->tx = crossing(p->i, g.size, p->ox, p->dx, p->ix);
    p->ty = crossing(p->j, g.size, p->oy, p->dy, p->iy);
    p->tz = crossing(p->k, g.size, p->oz, p->dz, p->iz);
#endif
    p->limit = constant_bound(p, g);
}

// Go to the next super-voxel; 0 if there is none.
static int cross_face(Path *p, const Grid g)
{
    const int along_x = p->tx <= fmin(p->ty, p->tz);
    const int along_y = !along_x & (p->ty <= p->tz);
    const int along_z = !along_x & !along_y;
    p->i += along_x ? (p->dx >= 0.0f ? 1 : -1) : 0;
    p->j += along_y ? (p->dy >= 0.0f ? 1 : -1) : 0;
    p->k += along_z ? (p->dz >= 0.0f ? 1 : -1) : 0;
    p->tx = along_x ? crossing(p->i, g.size, p->ox, p->dx, p->ix) : p->tx;
    p->ty = along_y ? crossing(p->j, g.size, p->oy, p->dy, p->iy) : p->ty;
    p->tz = along_z ? crossing(p->k, g.size, p->oz, p->dz, p->iz) : p->tz;
    const int inside = ((uint)p->i < (uint)g.mx) & ((uint)p->j < (uint)g.my) &
                       ((uint)p->k < (uint)g.mz);
    if (inside)
        p->limit = constant_bound(p, g);
    return inside;
}

// The fine cell of a coordinate, always within the super-voxel, whose majorant must hold there.
static int fine_cell(const float x, const int cell, const int size, const int n)
{
#ifdef WOODCOCK
    return clamp((int)x, 0, n - 1);
#else
    return clamp((int)x, cell * size, min((cell + 1) * size, n) - 1);
#endif
}

// Whether the density at the flight's present point exceeds `threshold`; `bound` is checked, too.
static int denser(Path *p, const Grid g, const float threshold, const float bound)
{
    const float x = p->ox + p->t * p->dx, y = p->oy + p->t * p->dy, z = p->oz + p->t * p->dz;
#ifdef PERLIN_MEDIUM
    const int real = perlin_exceeds(g.noise, x, y, z, threshold);
    if (real) // true whenever the density exceeds its majorant
        p->violated |= perlin_exceeds(g.noise, x, y, z, bound * TOLERATED);
    return real;
#else
    const int i = fine_cell(x, p->i, g.size, g.nx);
    const int j = fine_cell(y, p->j, g.size, g.ny);
    const int k = fine_cell(z, p->k, g.size, g.nz);
#ifdef LINEAR
    const int row = g.nz + 1, plane = (g.ny + 1) * row;
    __global const float *node = g.density + i * plane + j * row + k;
    const float fx = clamp(x - i, 0.0f, 1.0f);
    const float fy = clamp(y - j, 0.0f, 1.0f);
    const float fz = clamp(z - k, 0.0f, 1.0f);
    const float low = mix(mix(node[0], node[1], fz), mix(node[row], node[row + 1], fz), fy);
    const float high = mix(mix(node[plane], node[plane + 1], fz),
                           mix(node[plane + row], node[plane + row + 1], fz), fy);
    const float density = mix(low, high, fx);
#else
    const float density = g.density[(i * g.ny + j) * g.nz + k];
#endif
    p->violated |= density > bound * TOLERATED;
    return density > threshold;
#endif
}

#ifdef POLYNOMIAL
// The majorant along a flight, a cubic in the length from here, and its integral.
typedef struct {
    float c0, c1, c2, c3;
    float half_c1, third_c2, quarter_c3;
} Cubic;

static float cubic_value(const Cubic c, const float s)
{
    return c.c0 + s * (c.c1 + s * (c.c2 + s * c.c3));
}

static float cubic_integral(const Cubic c, const float s)
{
    return s * (c.c0 + s * (c.half_c1 + s * (c.third_c2 + s * c.quarter_c3)));
}

// The eight coefficients of [1, x, y, z, xy, yz, zx, xyz] in this super-voxel.
static void coefficients(const Path *p, const Grid g, float *a)
{
#ifdef RAY_MARCH
    // Here a super-voxel is a fine cell, and the majorant is the density itself.
    const int row = g.nz + 1, plane = (g.ny + 1) * row;
    __global const float *n = g.density + p->i * plane + p->j * row + p->k;
    a[0] = n[0];
    a[1] = n[plane] - n[0];
    a[2] = n[row] - n[0];
    a[3] = n[1] - n[0];
    a[4] = n[plane + row] - n[plane] - a[2];
    a[5] = n[row + 1] - n[row] - a[3];
    a[6] = n[plane + 1] - n[plane] - a[3];
    a[7] = n[plane + row + 1] - n[plane + row] - n[plane + 1] + n[plane] - a[5];
#else
    const float8 c = vload8((p->i * g.my + p->j) * g.mz + p->k, g.bound);
    a[0] = c.s0, a[1] = c.s1, a[2] = c.s2, a[3] = c.s3;
    a[4] = c.s4, a[5] = c.s5, a[6] = c.s6, a[7] = c.s7;
#endif
}

static Cubic bound_ahead(const Path *p, const Grid g)
{
    float a[8];
    coefficients(p, g, a);
    const float shrink = 1.0f / g.size;
    const float x = (p->ox + p->t * p->dx) * shrink - p->i, vx = p->dx * shrink;
    const float y = (p->oy + p->t * p->dy) * shrink - p->j, vy = p->dy * shrink;
    const float z = (p->oz + p->t * p->dz) * shrink - p->k, vz = p->dz * shrink;
    Cubic c;
    c.c0 = a[0] + x * (a[1] + a[4] * y) + y * (a[2] + a[5] * z) + z * (a[3] + a[6] * x) +
           a[7] * x * y * z;
    c.c1 = vx * (a[1] + a[4] * y + a[6] * z + a[7] * y * z) +
           vy * (a[2] + a[4] * x + a[5] * z + a[7] * x * z) +
           vz * (a[3] + a[5] * y + a[6] * x + a[7] * x * y);
    c.c2 = a[4] * vx * vy + a[5] * vy * vz + a[6] * vz * vx +
           a[7] * (x * vy * vz + y * vz * vx + z * vx * vy);
    c.c3 = a[7] * vx * vy * vz;
    c.half_c1 = c.c1 * 0.5f;
    c.third_c2 = c.c2 * (1.0f / 3.0f);
    c.quarter_c3 = c.c3 * 0.25f;
    return c;
}

// Where the integral of a non-negative cubic reaches `depth`, in [0, length]: Newton's method in a
// bracket, which is halved if a step would leave it, down to the resolution of float32.
static float cubic_solve(const Cubic c, const float depth, const float length, const float whole)
{
    float low = 0.0f, high = length;
    float s = length * (depth / whole);
    for (int n = 0; n < 32; n++) {
        const float excess = cubic_integral(c, s) - depth;
        low = excess > 0.0f ? low : s;
        high = excess > 0.0f ? s : high;
        if (fabs(excess) <= 2e-7f * whole || high - low <= 2e-7f * length)
            break;
        const float newton = s - excess / cubic_value(c, s);
        s = newton > low && newton < high ? newton : 0.5f * (low + high);
    }
    return s;
}
#endif

// Follow the flight to its next event, one of those listed above.
static int advance(Path *p, const Grid g, Random *random)
{
#ifdef WOODCOCK
    const float next = p->end;
#else
    const float next = fmin(fmin(p->end, p->tx), fmin(p->ty, p->tz));
#endif
    const float length = fmax(next - p->t, 0.0f);
#ifdef POLYNOMIAL
    const Cubic ahead = bound_ahead(p, g);
    const float depth = cubic_integral(ahead, length);
#else
#if defined(RAY_MARCH) && defined(PERLIN_MEDIUM)
    const float middle = p->t + length / 2;
    p->limit = perlin_density(g.noise, p->ox + middle * p->dx, p->oy + middle * p->dy,
                              p->oz + middle * p->dz);
#endif
    const float depth = p->limit * length;
#endif

    if (p->depth < depth) {
#ifdef POLYNOMIAL
        const float step = cubic_solve(ahead, p->depth, length, depth);
        const float limit = cubic_value(ahead, step);
#else
        const float step = p->depth / p->limit;
        const float limit = p->limit;
#endif
        p->t = fmin(p->t + step, next);
#ifndef RAY_MARCH
        if (!denser(p, g, random_next(random) * limit, limit)) {
            p->depth = next_depth(g, random);
            return VIRTUAL;
        }
#endif
        return COLLIDED;
    }
    p->depth -= depth;
    p->t = next;
    if (next >= p->end)
        return LEFT;
#ifdef WOODCOCK
    return CROSSED; // not reached: a flight's only next face is the end
#else
    return cross_face(p, g) ? CROSSED : LEFT;
#endif
}
