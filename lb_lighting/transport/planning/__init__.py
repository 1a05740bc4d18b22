# SPDX-License-Identifier: GPL-3.0-or-later
"""From an error target to settings: a pilot solve, and predictions for the full one."""
