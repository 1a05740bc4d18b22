# SPDX-License-Identifier: GPL-3.0-or-later
"""From the solver's field to Blender's data: files, attributes and shaders that show the light."""
