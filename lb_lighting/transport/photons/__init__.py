# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons: free path samplers, majorants and Monte Carlo tallies."""
