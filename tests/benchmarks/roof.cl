// SPDX-License-Identifier: GPL-3.0-or-later
// What a step of the physical lattice reads and writes, without its collision, and a plain copy.

#define DIRECTIONS 18
#define FOR_EACH_PAIR(DO)                                                                  \
    DO(0, 1, 1, 0, 0)                                                                      \
    DO(2, 3, 0, 1, 0)                                                                      \
    DO(4, 5, 0, 0, 1)                                                                      \
    DO(6, 9, 1, 1, 0)                                                                      \
    DO(7, 8, 1, -1, 0)                                                                     \
    DO(10, 13, 1, 0, 1)                                                                    \
    DO(11, 12, 1, 0, -1)                                                                   \
    DO(14, 17, 0, 1, 1)                                                                    \
    DO(15, 16, 0, 1, -1)
#define STEP(cx, cy, cz) ((cx)*plane + (cy)*row + (cz))
#define HERE(m, cell) light[(m)*stride + guard + (cell)]

#define TAKE_HERE(m, back, cx, cy, cz)                                                     \
    f[m] = HERE(m, cell);                                                                  \
    f[back] = HERE(back, cell);
#define LEAVE_HERE(m, back, cx, cy, cz)                                                    \
    HERE(back, cell) = 0.999f * f[m];                                                      \
    HERE(m, cell) = 0.999f * f[back];
#define TAKE_THERE(m, back, cx, cy, cz)                                                    \
    f[m] = HERE(back, cell - STEP(cx, cy, cz));                                            \
    f[back] = HERE(m, cell + STEP(cx, cy, cz));
#define LEAVE_THERE(m, back, cx, cy, cz)                                                   \
    HERE(m, cell + STEP(cx, cy, cz)) = 0.999f * f[m];                                      \
    HERE(back, cell - STEP(cx, cy, cz)) = 0.999f * f[back];

#define KERNEL(name, TAKE, LEAVE)                                                          \
    __kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void name(                 \
        const ulong plane, const ulong row, const ulong stride, const ulong guard,         \
        __global float *light)                                                             \
    {                                                                                      \
        const size_t cell = get_global_id(0);                                              \
        float f[DIRECTIONS];                                                               \
        FOR_EACH_PAIR(TAKE)                                                                \
        FOR_EACH_PAIR(LEAVE)                                                               \
    }
KERNEL(step_here, TAKE_HERE, LEAVE_HERE)
KERNEL(step_there, TAKE_THERE, LEAVE_THERE)

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
copy(__global const float *from, __global float *to)
{
    to[get_global_id(0)] = 0.999f * from[get_global_id(0)];
}
