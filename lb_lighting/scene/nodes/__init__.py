# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads node trees: closures, links, values and attributes."""
