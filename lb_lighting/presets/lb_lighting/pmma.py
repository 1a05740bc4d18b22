# SPDX-License-Identifier: GPL-3.0-or-later
# Geist and Westall, Lattice-Boltzmann Lighting Models, table 2.
import bpy

settings = bpy.context.scene.lb_lighting

settings.medium = "CUSTOM"
settings.sigma_s = (0.99, 0.99, 0.99)
settings.sigma_a = (0.01, 0.01, 0.01)
settings.g = (0.8, -0.88, -0.88)
settings.optical_depth = 30.0
