// SPDX-License-Identifier: GPL-3.0-or-later
// What a step of the physical lattice reads and writes, without its collision, and a plain copy.
// Built behind the extension's lattice/layout.cl.

#define LEAVE_ALL_HERE(m, back, cx, cy, cz)                                                \
    LEAVE_HERE(m, back, STEP(cx, cy, cz), 0.999f * f[m], 0.999f * f[back])
#define LEAVE_ALL_THERE(m, back, cx, cy, cz)                                               \
    LEAVE_THERE(m, back, STEP(cx, cy, cz), 0.999f * f[m], 0.999f * f[back])

#define KERNEL(name, TAKE, LEAVE)                                                          \
    __kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void name(                 \
        GRID, __global float *light)                                                       \
    {                                                                                      \
        const size_t cell = get_global_id(0);                                              \
        float f[DIRECTIONS];                                                               \
        FOR_EACH_PAIR(TAKE)                                                                \
        FOR_EACH_PAIR(LEAVE)                                                               \
    }
KERNEL(step_here, TAKE_HERE, LEAVE_ALL_HERE)
KERNEL(step_there, TAKE_THERE, LEAVE_ALL_THERE)

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
copy(__global const float *from, __global float *to)
{
    to[get_global_id(0)] = 0.999f * from[get_global_id(0)];
}
