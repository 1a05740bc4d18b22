# SPDX-License-Identifier: GPL-3.0-or-later
# Soot, 1 g/m^3 at density 1: absorption 7.5 m^2/g at 550 nm, by 1 / wavelength (650, 550, 450 nm),
# and an albedo of 0.25: Bond and Bergstrom, Light Absorption by Carbonaceous Particles, Aerosol
# Science and Technology 40, 2006. That it scatters forward, by 0.5, is a choice of ours.
import bpy

settings = bpy.context.scene.lb_lighting

settings.medium = "CUSTOM"
settings.sigma_s = (2.1, 2.5, 3.1)
settings.sigma_a = (6.3, 7.5, 9.2)
settings.g = (0.5, 0.5, 0.5)
settings.optical_depth = 0.0
