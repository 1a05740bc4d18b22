# SPDX-License-Identifier: GPL-3.0-or-later
# A luminous flame: soot of a volume fraction f = 1e-6 absorbs 6 pi E f / wavelength (650, 550 and
# 450 nm), with E = 0.26 from the refractive index of Dalzell and Sarofim, Optical Constants of
# Soot, Journal of Heat Transfer 91, 1969. That it scatters a tenth of that is a choice of ours.
# What the flame sends out itself is not in the light.
import bpy

settings = bpy.context.scene.lb_lighting

settings.medium = "CUSTOM"
settings.sigma_s = (0.75, 0.89, 1.1)
settings.sigma_a = (7.5, 8.9, 10.9)
settings.g = (0.0, 0.0, 0.0)
settings.optical_depth = 0.0
