# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights in SI units, and how photons and rays are drawn from them."""
