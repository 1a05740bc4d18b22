# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's front door; everything is in `lb_lighting`."""

from .lb_lighting import register, unregister

__all__ = ["register", "unregister"]
