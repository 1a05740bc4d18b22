// SPDX-License-Identifier: GPL-3.0-or-later
// The density of fractal noise, which is never stored. transport/photons/perlin.py describes it and is
// the twin. This file has no kernel: sources that need its functions are built after it, and it is
// built after photons/random.cl.
//
// A kernel takes PERLIN_PARAMETERS, in the order of PerlinMedium.device_arguments, and calls the
// functions with PERLIN. Positions are in cells of the finest lattice; an octave's scale is a power
// of two, so scaling them is exact.

typedef struct {
    uint seed;
    int frame;         // time is frame + frac
    float frac;
    int octaves;       // the cells of octave i have edges of 2^(octaves - 1 - i) fine cells
    float amplitude;   // of octave 0; all of them sum to 1
    float persistence; // amplitude of an octave over that of the previous one
    float cutoff;
    float power;
} Perlin;

#define PERLIN_PARAMETERS                                                                  \
    const uint perlin_seed, const int perlin_frame, const float perlin_frac,               \
        const int perlin_octaves, const float perlin_amplitude,                            \
        const float perlin_persistence, const float perlin_cutoff, const float perlin_power
#define PERLIN                                                                             \
    (Perlin)                                                                               \
    {                                                                                      \
        perlin_seed, perlin_frame, perlin_frac, perlin_octaves, perlin_amplitude,          \
            perlin_persistence, perlin_cutoff, perlin_power                                \
    }

float perlin_between(const float a, const float b, const float share)
{
    return a + share * (b - a);
}

float perlin_value(const uint row, const uint z)
{
    return (float)(mix_bits(row ^ (z * 0x27d4eb2fu)) >> 8) * 0x1p-24f;
}

float perlin_along_z(const uint row, const uint z, const float fz)
{
    return perlin_between(perlin_value(row, z), perlin_value(row, z + 1), fz);
}

float perlin_along_yz(const uint plane, const uint y, const uint z, const float fy, const float fz)
{
    return perlin_between(perlin_along_z(mix_bits(plane ^ (y * 0x165667b1u)), z, fz),
                          perlin_along_z(mix_bits(plane ^ ((y + 1) * 0x165667b1u)), z, fz), fy);
}

// The noise of one octave in one frame, in [0, 1]; positions in cells of its lattice.
float perlin_frame(const uint seed, const int octave, const int frame, const float px,
                   const float py, const float pz)
{
    const float cx = floor(px), cy = floor(py), cz = floor(pz);
    const float fx = px - cx, fy = py - cy, fz = pz - cz;
    const uint x = (uint)(int)cx, y = (uint)(int)cy, z = (uint)(int)cz;
    const uint key = mix_bits(mix_bits(seed ^ ((uint)(octave + 1) * 0x9e3779b1u)) ^
                                ((uint)frame * 0x85ebca77u));
    return perlin_between(perlin_along_yz(mix_bits(key ^ (x * 0xc2b2ae3du)), y, z, fy, fz),
                          perlin_along_yz(mix_bits(key ^ ((x + 1) * 0xc2b2ae3du)), y, z, fy, fz),
                          fx);
}

// The noise of one octave. It is a loop because compilers that vectorise a condition would compute
// both frames, at twice the cost.
float perlin_octave(const Perlin m, const int octave, const float x, const float y, const float z)
{
    const int last = m.frame + (m.frac > 0.0f);
    float value = 0.0f, share = 1.0f - m.frac;
    for (int frame = m.frame; frame <= last; frame++) {
        value += share * perlin_frame(m.seed, octave, frame, x, y, z);
        share = m.frac;
    }
    return value;
}

// The noise, in [0, 1].
float perlin_noise(const Perlin m, const float x, const float y, const float z)
{
    float noise = 0.0f, amplitude = m.amplitude, scale = ldexp(1.0f, 1 - m.octaves);
    for (int octave = 0; octave < m.octaves; octave++) {
        noise += amplitude * perlin_octave(m, octave, x * scale, y * scale, z * scale);
        amplitude *= m.persistence;
        scale *= 2.0f;
    }
    return noise;
}

// The density, in [0, 1].
float perlin_density(const Perlin m, const float x, const float y, const float z)
{
    const float noise = perlin_noise(m, x, y, z);
    return powr(fmax(0.0f, (noise - m.cutoff) / (1.0f - m.cutoff)), m.power);
}

// Whether the density exceeds `threshold` (0 or more). The result equals a comparison of
// perlin_density, but it compares the noise, for which a few octaves usually suffice: the others
// add between 0 and the sum of their amplitudes.
int perlin_exceeds(const Perlin m, const float x, const float y, const float z,
                   const float threshold)
{
    const float least_noise = m.cutoff + (1.0f - m.cutoff) * powr(threshold, 1.0f / m.power);
    float noise = 0.0f, rest = 1.0f, amplitude = m.amplitude, scale = ldexp(1.0f, 1 - m.octaves);
    for (int octave = 0; octave < m.octaves; octave++) {
        noise += amplitude * perlin_octave(m, octave, x * scale, y * scale, z * scale);
        rest -= amplitude;
        if (noise > least_noise || noise + rest <= least_noise)
            break;
        amplitude *= m.persistence;
        scale *= 2.0f;
    }
    return noise > least_noise;
}
