# SPDX-License-Identifier: GPL-3.0-or-later
# Jensen, Marschner, Levoy and Hanrahan, A Practical Model for Subsurface Light Transport, SIGGRAPH
# 2001, figure 5, in 1/m. The scattering is the reduced one, which goes with g = 0.
import bpy

settings = bpy.context.scene.lb_lighting

settings.medium = "CUSTOM"
settings.sigma_s = (2550.0, 3210.0, 3770.0)
settings.sigma_a = (1.1, 2.4, 14.0)
settings.g = (0.0, 0.0, 0.0)
settings.optical_depth = 0.0
