# SPDX-License-Identifier: GPL-3.0-or-later
"""From `transport` back into Blender: files, attributes and shaders that show the light."""
