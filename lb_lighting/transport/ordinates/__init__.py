# SPDX-License-Identifier: GPL-3.0-or-later
"""Discrete ordinates: scattered radiance along many directions, by source iteration."""
