# SPDX-License-Identifier: GPL-3.0-or-later
"""Sparse grids read block by block, and resampled onto the lattice."""
