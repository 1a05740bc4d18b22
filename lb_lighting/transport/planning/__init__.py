# SPDX-License-Identifier: GPL-3.0-or-later
"""From an error target to settings: a pilot solve, and what to expect of the whole one."""
