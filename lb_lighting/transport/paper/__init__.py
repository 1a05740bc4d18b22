# SPDX-License-Identifier: GPL-3.0-or-later
"""The model of paper 1: all light on its lattice, for its number of steps."""
