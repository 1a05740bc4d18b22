# SPDX-License-Identifier: GPL-3.0-or-later
# Geist and Westall, Lattice-Boltzmann Lighting Models, table 1: derived from Knapp and Carter,
# Variability in Leaf Optical Properties, American Journal of Botany 85, 1998.
import bpy

settings = bpy.context.scene.lb_lighting

settings.medium = "CUSTOM"
settings.sigma_s = (0.891, 0.909, 0.882)
settings.sigma_a = (0.109, 0.091, 0.118)
settings.g = (-0.231, 0.103, -0.75)
settings.optical_depth = 30.0
