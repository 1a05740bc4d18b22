# SPDX-License-Identifier: GPL-3.0-or-later
# Droplets of water about 10 um large absorb next to no visible light: Hu and Stamnes, An Accurate
# Parameterization of the Radiative Properties of Water Clouds, Journal of Climate 6, 1993.
# The optical depth is that of a cumulus, at any size of the scene.
import bpy

settings = bpy.context.scene.lb_lighting

settings.medium = "CUSTOM"
settings.sigma_s = (1.0, 1.0, 1.0)
settings.sigma_a = (0.0, 0.0, 0.0)
settings.g = (0.85, 0.85, 0.85)
settings.optical_depth = 30.0
