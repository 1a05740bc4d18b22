# SPDX-License-Identifier: GPL-3.0-or-later
"""From Blender's scene to plain arrays and transport values."""
