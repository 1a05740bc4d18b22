// SPDX-License-Identifier: GPL-3.0-or-later
// Parallel light through voxels, layer by layer; transport/uncollided/sweep.py is the twin. Built behind uncollided/attenuation.cl,
// with
//   DIRECTED    beams have different directions: tally these, too
//   OCCLUDED    voxels stop light, and reflect some of it
//   EMITTING    rays start empty and gather the light of the voxels
//   APART       each beam gathers a light of its own, and scores by itself; where nothing is OCCLUDED
//
// Several beams are sent at once, all from the same side. Each voxel's column has `count` rays of
// each beam, and in a layer those of one number all cross voxels alike: on their way through the
// layer they start in a voxel, and may cross to the next along u, or v, or both, one behind the
// other. Voxels are counted along the beam, so backwards where it goes to lower ones.
//
// sizes  nu, nv; the first voxel of the box along u and v, and how many it has; beside, count
// layer  its number; that in the box, counted from 1, as `matter` has it: 0 and more than there are
//        outside; layers of the box; 1 in the first layer that light comes to; to the next one of
//        `matter`, 1, -1 or 0
// beams  by beam: share; du, dv, dw >= 0; 1 where it goes backwards along u, and along v; score of
//        a voxel that nothing has met; 1 where it goes backwards along w
// ways   by beam and number, in a layer: voxels along u and v from the ray's column to the voxel
//        that it starts in, where it starts there, the lengths in up to three voxels, and the order
//        of crossings
// windows  by beam, in a layer: where rays may have met anything, along u and v
// matter  depth of a voxel's edge, glow from 0 to 1 (of each beam where they are APART), shares of
//        light that are stopped and reflected, one `bordered` behind the other: of the layers of the
//        box, with an empty border

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
    Voxel found = {matter[at], 0.0f, 0.0f, 0.0f};
#ifdef EMITTING
    found.glow = matter[at + glow * bordered];
#endif
#ifdef OCCLUDED
    found.stopping = matter[at + 2 * bordered];
    found.reflecting = matter[at + 3 * bordered];
#endif
    return found;
}

// What is left of a ray behind some way in a voxel that it comes to.
static float behind(float weight, const Voxel voxel, const float way)
{
#ifdef OCCLUDED
    weight *= 1.0f - voxel.stopping;
#endif
#ifdef EMITTING
    const Fade f = fade(voxel.depth * way);
    return weight * f.through + voxel.glow * way * f.mean;
#else
    return weight * exp(-voxel.depth * way);
#endif
}

// Add what a ray that comes with `weight` to a place in a voxel leaves on some way in it.
static void cross(Tally *sum, float weight, const Voxel voxel, const float way, const float u,
                  const float v, const float w, const float du, const float dv, const float dw)
{
#ifdef OCCLUDED
    weight *= 1.0f - voxel.stopping;
#endif
    const float edge = voxel.depth, t = edge * way;
    const Fade f = fade(t);
    float total = weight * (edge > 1.0f ? 1.0f - f.through : way * f.mean);
    float placed = total * way * f.place;
    weight *= f.through;
#ifdef EMITTING
    // Of what starts on the way: the share 1 - mean collides, further on.
    const float fresh = voxel.glow * way;
    const float own = fresh * (edge > 1.0f ? 1.0f - f.mean : way * f.lost);
    total += own;
    placed += own * way * (t < 0.1f ? 2 / 3.0f - t * (1 / 36.0f - t * (1 / 540.0f))
                                    : (0.5f - f.mean * f.place) / (1.0f - f.mean));
    weight += fresh * f.mean;
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
// Of a voxel in the layer, and so many voxels further along the beam
#define LOOK(along_u, along_v)                                                             \
    look(matter, bordered, here_at + (along_u) * next_u + (along_v) * next_v, GLOW_OF(beam))
#define HERE(u, v)                                                                         \
    const long next_u = backward.x ? -(NV + 2) : NV + 2, next_v = backward.y ? -1 : 1;     \
    const long here_at = ((long)layer.s1 * (NU + 2) + 1 + (backward.x ? NU - 1 - (u) : (u))) \
                             * (NV + 2) + 1 + (backward.y ? NV - 1 - (v) : (v));
#define RAY(beam, n, u, v)                                                                 \
    (((size_t)((beam) * COUNT + (n)) * (NU + BESIDE) + (u) + BESIDE) * (NV + BESIDE) + (v) + BESIDE)

// The score of a voxel in a layer without matter, from the rays of a beam that have left it behind.
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

// tallies    score, one `voxels` behind the other, and where DIRECTED that times the direction along
//            w, u and v; where APART the score of each beam, and nothing else is tallied
// inside     of the box, one `inner` behind the other: score times the place from the voxel's
//            centre along w, u and v; where OCCLUDED what is reflected into it
// sums       by column, one behind the other: what is reflected out of the domain through the faces
//            -w, +w, -u, +u, -v, +v; what is stopped
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
        __global const float *facts = beams + BEAMS * beam;
        const float share = facts[0], du = facts[1], dv = facts[2], dw = facts[3];
        const int2 backward = {(int)facts[4], (int)facts[5]};
        const int u = backward.x ? NU - 1 - column_u : column_u;
        const int v = backward.y ? NV - 1 - column_v : column_v;
        __global const int *window = windows + 4 * beam;
        Tally sum = {facts[6], 0.0f, 0.0f, 0.0f, 0.0f};
        back_w = (int)facts[7];
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

// What is left of the rays behind the layer; over those that start in the box, or in the row before.
__kernel void pass(LAYER, __global float *rays)
{
    const int ray = (int)get_global_id(2), beam = ray / COUNT;
    __global const float *facts = beams + BEAMS * beam, *way = ways + WAYS * ray;
    const int2 backward = {(int)facts[4], (int)facts[5]};
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
