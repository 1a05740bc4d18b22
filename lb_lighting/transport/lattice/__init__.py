# SPDX-License-Identifier: GPL-3.0-or-later
"""The lattice of the physical model: D3Q19, its boundary, multigrid and convergence."""
