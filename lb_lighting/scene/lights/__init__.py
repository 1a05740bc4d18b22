# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads lamps, worlds and emissive meshes as lights for the solver."""
