// SPDX-License-Identifier: GPL-3.0-or-later
// Parallel beams through voxels, layer by layer; transport/uncollided/sweep.py is the twin. Built
// after attenuation.cl, with
//   DIRECTED    beams have different directions, which are tallied as well
//   OCCLUDED    opaque matter in voxels stops light and reflects part of it
//   EMITTING    rays start with a weight of 0 and gain the emission of the voxels
//   APART       each beam has an emission and a score to itself; not with OCCLUDED
//
// Several beams are sent at once, all from the same side. Each column of voxels has `count` rays of
// each beam. In a layer, all rays of one number take the same path: each starts in a voxel and may
// cross to the next voxel along u, along v, or along both, one after the other. Voxels are counted
// in the direction of the beam.
//
// sizes  nu, nv; the first voxel of the box along u and v, and its size along these; beside, the
//        columns before the domain in which rays start; count
// layer  its number in the domain; its number in `matter`, from 1 to the number of layers of the
//        box, and outside the box 0 or one more than that; layers of the box; 1 for the first layer
//        that light reaches; the step to the next layer's number in `matter`, 1, -1 or 0
// beams  by beam: share; du, dv, dw >= 0; 1 if it is backward along u, and along v; the score of a
//        voxel that unattenuated rays cross; 1 if it is backward along w
// ways   by beam and number, the rays' paths in a layer: voxels along u and v from a ray's column
//        to the voxel in which it starts; its place there; the lengths in up to three voxels; and
//        the order of crossings
// windows  by beam, the columns of a layer, along u and v, that attenuated rays may reach
// matter  optical depth of a voxel's edge, emission from 0 to 1 (if APART: of each beam), shares of
//        the light that are stopped and reflected; each of `bordered` values, the layers of the box
//        with an empty border

#define NONE 0
#define U 1
#define V 2
#define U_THEN_V 3
#define V_THEN_U 4

#define WAYS 8
#define BEAMS 8
#define NU sizes.s0
#define NV sizes.s1
#define BESIDE sizes.s6
#define COUNT sizes.s7

typedef struct {
    float depth, glow, stopping, reflecting;
} Voxel;

typedef struct {
    float score, u, v, w, weight;
} Tally;

#ifdef APART
#define GLOW_OF(beam) (1 + (beam))
#else
#define GLOW_OF(beam) 1
#endif

static Voxel look(__global const float *matter, const ulong bordered, const ulong at,
                  const ulong glow)
{
    Voxel voxel = {matter[at], 0.0f, 0.0f, 0.0f};
#ifdef EMITTING
    voxel.glow = matter[at + glow * bordered];
#endif
#ifdef OCCLUDED
    voxel.stopping = matter[at + 2 * bordered];
    voxel.reflecting = matter[at + 3 * bordered];
#endif
    return voxel;
}

// The weight of a ray after a path of length `way` in a voxel that it enters.
static float behind(float weight, const Voxel voxel, const float way)
{
#ifdef OCCLUDED
    weight *= 1.0f - voxel.stopping;
#endif
#ifdef EMITTING
    const Attenuation a = attenuate(voxel.depth * way);
    return weight * a.transmittance + voxel.glow * way * a.mean_transmittance;
#else
    return weight * exp(-voxel.depth * way);
#endif
}

// Add the score of a ray that enters a voxel with `weight` at a place (u, v, w), on a path of
// length `way` in it.
static void cross(Tally *sum, float weight, const Voxel voxel, const float way, const float u,
                  const float v, const float w, const float du, const float dv, const float dw)
{
#ifdef OCCLUDED
    weight *= 1.0f - voxel.stopping;
#endif
    const float edge = voxel.depth, t = edge * way;
    const Attenuation a = attenuate(t);
    float total = weight * (edge > 1.0f ? 1.0f - a.transmittance : way * a.mean_transmittance);
    float placed = total * way * a.collision_place;
    weight *= a.transmittance;
#ifdef EMITTING
    // Light emitted along the path: the share 1 - mean_transmittance collides farther along.
    const float emitted = voxel.glow * way, mean = a.mean_transmittance;
    const float score = emitted * (edge > 1.0f ? 1.0f - mean : way * a.source_score);
    total += score;
    placed += score * way * (t < 0.1f ? 2 / 3.0f - t * (1 / 36.0f - t * (1 / 540.0f))
                                      : (0.5f - mean * a.collision_place) / (1.0f - mean));
    weight += emitted * mean;
#endif
    sum->score += total;
    sum->u += total * (u - 0.5f) + placed * du;
    sum->v += total * (v - 0.5f) + placed * dv;
    sum->w += total * (w - 0.5f) + placed * dw;
    sum->weight = weight;
}

#define LAYER                                                                              \
    const int8 sizes, const int8 layer, const int beams_sent, const ulong bordered,        \
        __global const float *matter, __global const float *beams,                         \
        __global const float *ways, __global const int *windows
// The voxel at a step from the voxel `here_at`, in the direction of the beam
#define LOOK(along_u, along_v)                                                             \
    look(matter, bordered, here_at + (along_u) * next_u + (along_v) * next_v, GLOW_OF(beam))
#define HERE(u, v)                                                                         \
    const long next_u = backward.x ? -(NV + 2) : NV + 2, next_v = backward.y ? -1 : 1;     \
    const long here_at = ((long)layer.s1 * (NU + 2) + 1 + (backward.x ? NU - 1 - (u) : (u))) \
                             * (NV + 2) + 1 + (backward.y ? NV - 1 - (v) : (v));
#define RAY(beam, n, u, v)                                                                 \
    (((size_t)((beam) * COUNT + (n)) * (NU + BESIDE) + (u) + BESIDE) * (NV + BESIDE) + (v) + BESIDE)

// The score of a voxel in a layer without matter, from the attenuated rays of a beam.
static float crossed(__global const float *rays, __global const float *ways, const int8 sizes,
                     const int beam, const int u, const int v)
{
    float score = 0.0f;
    for (int n = 0; n < COUNT; n++) {
        __global const float *way = ways + WAYS * (beam * COUNT + n);
        const int cu = u - (int)way[0], cv = v - (int)way[1], order = (int)way[7];
        const int by_u = order == U || order == U_THEN_V, by_v = !by_u;
        score += rays[RAY(beam, n, cu, cv)] * way[4];
        if (order != NONE)
            score += rays[RAY(beam, n, cu - by_u, cv - by_v)] * way[5];
        if (order > V)
            score += rays[RAY(beam, n, cu - 1, cv - 1)] * way[6];
    }
    return score;
}

// tallies    of `voxels` values each: the score and, if DIRECTED, the score times the direction
//            along w, u and v; if APART, only the score of each beam
// inside     of `inner` values each, of the box: the score times the place relative to the voxel's
//            centre along w, u and v; if OCCLUDED, the light reflected into the voxel
// sums       by column, if OCCLUDED: the light reflected out of the domain through the faces
//            -w, +w, -u, +u, -v, +v; the light absorbed by opaque matter
__kernel void tally(LAYER, __global const float *rays, __global float *tallies, const ulong voxels,
                    __global float *inside, __global float *sums)
{
    const int column_v = (int)get_global_id(0), column_u = (int)get_global_id(1);
    const size_t column = (size_t)column_u * NV + column_v;
    const size_t voxel = (size_t)layer.s0 * NU * NV + column;
    float score = 0.0f, to_w = 0.0f, to_u = 0.0f, to_v = 0.0f;
    float place_w = 0.0f, place_u = 0.0f, place_v = 0.0f, reflected = 0.0f, stopped = 0.0f;
    float out_w = 0.0f, out_u = 0.0f, out_u_end = 0.0f, out_v = 0.0f, out_v_end = 0.0f;
    const int matters = layer.s1 >= 1 && layer.s1 <= layer.s2;
    int back_w = 0;
    for (int beam = 0; beam < beams_sent; beam++) {
        __global const float *constants = beams + BEAMS * beam;
        const float share = constants[0], du = constants[1], dv = constants[2], dw = constants[3];
        const int2 backward = {(int)constants[4], (int)constants[5]};
        const int u = backward.x ? NU - 1 - column_u : column_u;
        const int v = backward.y ? NV - 1 - column_v : column_v;
        __global const int *window = windows + 4 * beam;
        Tally sum = {constants[6], 0.0f, 0.0f, 0.0f, 0.0f};
        back_w = (int)constants[7];
        const int met = u >= window[0] && u < window[1] && v >= window[2] && v < window[3];
        if (met && !matters)
            sum.score = crossed(rays, ways, sizes, beam, u, v);
        if (met && matters) {
            HERE(u, v)
            const Voxel here = LOOK(0, 0);
#ifdef OCCLUDED
            const Voxel next = look(matter, bordered, here_at + layer.s4 * (NU + 2) * (NV + 2), 1);
            const float kept = here.stopping - here.reflecting;
            float arrived = 0.0f, back = 0.0f, by_w = 0.0f, from_u = 0.0f, from_v = 0.0f;
#endif
            sum.score = 0.0f;
            for (int n = 0; n < COUNT; n++) {
                __global const float *way = ways + WAYS * (beam * COUNT + n);
                const int cu = u - (int)way[0], cv = v - (int)way[1], order = (int)way[7];
                const float pu = way[2], pv = way[3];
                const float first = way[4], second = way[5], third = way[6];
                const int by_u = order == U || order == U_THEN_V, by_v = !by_u;
                float weight = rays[RAY(beam, n, cu, cv)];
                cross(&sum, weight, here, first, pu, pv, 0.0f, du, dv, dw);
#ifdef OCCLUDED
                const Voxel beside = LOOK(by_u, by_v);
                const Voxel aside = LOOK(by_v, by_u);
                arrived += weight;
                by_w += layer.s3 ? weight : 0.0f;
                back += sum.weight * (order == NONE ? next : beside).reflecting;
#endif
                if (order == NONE)
                    continue;
                weight = behind(rays[RAY(beam, n, cu - by_u, cv - by_v)],
                                LOOK(-by_u, -by_v), first);
                cross(&sum, weight, here, second, by_u ? 0.0f : pu + first * du,
                      by_v ? 0.0f : pv + first * dv, first * dw, du, dv, dw);
#ifdef OCCLUDED
                arrived += weight;
                from_u += by_u && u == 0 ? weight : 0.0f;
                from_v += by_v && v == 0 ? weight : 0.0f;
                back += sum.weight * (order > V ? aside : next).reflecting;
#endif
                if (order <= V)
                    continue;
                weight = behind(rays[RAY(beam, n, cu - 1, cv - 1)], LOOK(-1, -1), first);
                weight = behind(weight, LOOK(-by_v, -by_u), second);
                cross(&sum, weight, here, third, by_u ? second * du : 0.0f,
                      by_v ? second * dv : 0.0f, (first + second) * dw, du, dv, dw);
#ifdef OCCLUDED
                arrived += weight;
                from_u += by_v && u == 0 ? weight : 0.0f;
                from_v += by_u && v == 0 ? weight : 0.0f;
                back += sum.weight * next.reflecting;
#endif
            }
#ifdef OCCLUDED
            reflected += share * back;
            stopped += share * kept * arrived;
            const float out = share * here.reflecting;
            out_w += out * by_w;
            out_u += backward.x ? 0.0f : out * from_u;
            out_u_end += backward.x ? out * from_u : 0.0f;
            out_v += backward.y ? 0.0f : out * from_v;
            out_v_end += backward.y ? out * from_v : 0.0f;
#endif
        }
#ifdef APART
        tallies[voxel + beam * voxels] = sum.score;
#else
        score += share * sum.score;
        place_w += share * (back_w ? -sum.w : sum.w);
        place_u += share * (backward.x ? -sum.u : sum.u);
        place_v += share * (backward.y ? -sum.v : sum.v);
#ifdef DIRECTED
        to_w += share * sum.score * (back_w ? -dw : dw);
        to_u += share * sum.score * (backward.x ? -du : du);
        to_v += share * sum.score * (backward.y ? -dv : dv);
#endif
#endif
    }
#ifndef APART
    tallies[voxel] += score;
#ifdef DIRECTED
    tallies[voxel + voxels] += to_w;
    tallies[voxel + 2 * voxels] += to_u;
    tallies[voxel + 3 * voxels] += to_v;
#endif
    const int i = column_u - sizes.s2, j = column_v - sizes.s3;
    if (!matters || i < 0 || i >= sizes.s4 || j < 0 || j >= sizes.s5)
        return;
    const size_t at = ((size_t)(layer.s1 - 1) * sizes.s4 + i) * sizes.s5 + j;
    const size_t inner = (size_t)layer.s2 * sizes.s4 * sizes.s5;
    inside[at] += place_w;
    inside[at + inner] += place_u;
    inside[at + 2 * inner] += place_v;
#ifdef OCCLUDED
    const size_t columns = (size_t)NU * NV;
    inside[at + 3 * inner] += reflected;
    sums[column + back_w * columns] += out_w;
    sums[column + 2 * columns] += out_u;
    sums[column + 3 * columns] += out_u_end;
    sums[column + 4 * columns] += out_v;
    sums[column + 5 * columns] += out_v_end;
    sums[column + 6 * columns] += stopped;
#endif
#endif
}

// The weights after the layer of rays that start in the box or in the row before it.
__kernel void pass(LAYER, __global float *rays)
{
    const int ray = (int)get_global_id(2), beam = ray / COUNT;
    __global const float *constants = beams + BEAMS * beam, *way = ways + WAYS * ray;
    const int2 backward = {(int)constants[4], (int)constants[5]};
    const int first_u = backward.x ? NU - sizes.s2 - sizes.s4 : sizes.s2;
    const int first_v = backward.y ? NV - sizes.s3 - sizes.s5 : sizes.s3;
    const int u = first_u - 1 + (int)get_global_id(1), v = first_v - 1 + (int)get_global_id(0);
    const int order = (int)way[7], by_u = order == U || order == U_THEN_V;
    const int by_v = order == V || order == V_THEN_U;
    const size_t at = RAY(beam, ray % COUNT, u - (int)way[0], v - (int)way[1]);
    HERE(u, v)
    float weight = behind(rays[at], LOOK(0, 0), way[4]);
    if (order != NONE)
        weight = behind(weight, LOOK(by_u, by_v), way[5]);
    if (order > V)
        weight = behind(weight, LOOK(1, 1), way[6]);
    rays[at] = weight;
}
