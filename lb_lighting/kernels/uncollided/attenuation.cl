// SPDX-License-Identifier: GPL-3.0-or-later

#define THIN 0.5f // optical depth up to which series are used

// How light fades over an optical depth, all finite down to a depth of 0.
typedef struct {
    float through; // exp(-depth)
    float mean;    // of that over the way: (1 - through) / depth
    float lost;    // (1 - mean) / depth
    float place;   // where on the way it collides, on average, from 0 to 1
} Fade;

static Fade fade(const float t)
{
    Fade f;
    f.through = exp(-t);
    if (t < THIN) {
        f.lost = 0.5f - t * (1 / 6.0f - t * (1 / 24.0f - t * (1 / 120.0f - t * (1 / 720.0f
                 - t * (1 / 5040.0f - t * (1 / 40320.0f))))));
        f.mean = 1.0f - t * f.lost;
        f.place = 0.5f - t * (1 / 12.0f - t * t * (1 / 720.0f - t * t * (1 / 30240.0f)));
    } else {
        const float inverse = 1.0f / t;
        f.mean = (1.0f - f.through) * inverse;
        f.lost = (1.0f - f.mean) * inverse;
        f.place = inverse - f.through / (1.0f - f.through);
    }
    return f;
}
