# SPDX-License-Identifier: GPL-3.0-or-later
"""What the solver's process is asked to do.

A task crosses to it as a pickle, and its `run` returns what crosses back; see `worker.py`. None of
it needs Blender.
"""
