// SPDX-License-Identifier: GPL-3.0-or-later
// Random numbers: xoshiro128++ (Blackman and Vigna 2021), one stream for each ray.

typedef struct {
    uint a, b, c, d;
} Random;

// The finalizer of MurmurHash3: every bit of the result depends on every bit of `h`.
static uint mix_bits(uint h)
{
    h ^= h >> 16;
    h *= 0x85ebca6bu;
    h ^= h >> 13;
    h *= 0xc2b2ae35u;
    return h ^ (h >> 16);
}

// The stream of ray `index` under `seed`.
static Random random_stream(const uint seed, const uint index)
{
    Random r;
    r.a = mix_bits(index + 0x9e3779b9u * seed);
    r.b = mix_bits(r.a ^ index ^ 0x632be5abu);
    r.c = mix_bits(r.b + 0x9e3779b9u);
    r.d = mix_bits(r.c ^ seed) | 1u; // the state must not be all zero
    return r;
}

// Uniform in (0, 1), one of 2^23 values that exclude both ends, so log() is finite.
static float random_next(Random *r)
{
    const uint bits = rotate(r->a + r->d, 7u) + r->a;
    const uint t = r->b << 9;
    r->c ^= r->a;
    r->d ^= r->b;
    r->b ^= r->c;
    r->a ^= r->d;
    r->c ^= t;
    r->d = rotate(r->d, 11u);
    return ((float)(int)(bits >> 9) + 0.5f) * 0x1p-23f;
}
