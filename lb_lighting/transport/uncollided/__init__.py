# SPDX-License-Identifier: GPL-3.0-or-later
"""Uncollided light: rays followed exactly through the voxels."""
