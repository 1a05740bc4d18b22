# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures and statistics by free path sampling, without a solve."""
