// SPDX-License-Identifier: GPL-3.0-or-later
// The layout of the lattice's light: cell by cell (transport/lattice/layout.py); the light of direction
// m begins `stride` floats after that of m - 1, and the first one `guard` floats from the start.

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

// The steps in cells along z (1), y and x; the floats from one direction's light to the next, and those
// before the first.
#define GRID const ulong plane, const ulong row, const ulong stride, const ulong guard
#define STEP(cx, cy, cz) ((cx)*plane + (cy)*row + (cz))

// The light that has arrived at a cell along m, from `step` cells away.
#define HERE(m, cell) light[(m)*stride + guard + (cell)]
#define ARRIVED(m, back, cell, step) HERE(swapped ? (back) : (m), swapped ? (cell) - (step) : (cell))

// The light f of a step in place: one kind of step reads light in the cell where it has arrived and
// writes it swapped; the other reads swapped light and writes it where it arrives next.
#define TAKE_HERE(m, back, cx, cy, cz)                                                     \
    f[m] = HERE(m, cell);                                                                  \
    f[back] = HERE(back, cell);
#define LEAVE_HERE(m, back, step, ahead, behind)                                           \
    HERE(back, cell) = ahead;                                                              \
    HERE(m, cell) = behind;
#define TAKE_THERE(m, back, cx, cy, cz)                                                    \
    f[m] = HERE(back, cell - STEP(cx, cy, cz));                                            \
    f[back] = HERE(m, cell + STEP(cx, cy, cz));
#define LEAVE_THERE(m, back, step, ahead, behind)                                          \
    HERE(m, cell + (step)) = ahead;                                                        \
    HERE(back, cell - (step)) = behind;
