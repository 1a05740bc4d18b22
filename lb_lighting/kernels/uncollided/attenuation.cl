// SPDX-License-Identifier: GPL-3.0-or-later
// Attenuation of light along a path; transport/uncollided/attenuation.py is the twin.

#define THIN 0.5f // optical depth up to which series are used

// Attenuation along a path of optical depth t, finite down to t = 0.
typedef struct {
    float transmittance;      // T = exp(-t)
    float mean_transmittance; // m = (1 - T) / t
    float source_score;       // (1 - m) / t: the score of light that is emitted along the path
    float collision_place;    // mean, of light that enters, 0 to 1 along the path
} Attenuation;

static Attenuation attenuate(const float t)
{
    Attenuation a;
    a.transmittance = exp(-t);
    if (t < THIN) {
        a.source_score = 0.5f - t * (1 / 6.0f - t * (1 / 24.0f - t * (1 / 120.0f - t * (1 / 720.0f
                         - t * (1 / 5040.0f - t * (1 / 40320.0f))))));
        a.mean_transmittance = 1.0f - t * a.source_score;
        a.collision_place = 0.5f - t * (1 / 12.0f - t * t * (1 / 720.0f - t * t * (1 / 30240.0f)));
    } else {
        const float inverse = 1.0f / t;
        a.mean_transmittance = (1.0f - a.transmittance) * inverse;
        a.source_score = (1.0f - a.mean_transmittance) * inverse;
        a.collision_place = inverse - a.transmittance / (1.0f - a.transmittance);
    }
    return a;
}
