# SPDX-License-Identifier: GPL-3.0-or-later
"""Node trees read: closures, links, values and attributes."""
