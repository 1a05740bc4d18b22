# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps, worlds and shining meshes read as the lights of the solver."""
