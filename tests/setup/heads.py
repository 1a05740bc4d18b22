# SPDX-License-Identifier: GPL-3.0-or-later
"""Two real heads from Debian packages, as densities: axes x, y, z, C order, float32, >= 0."""

import tarfile

import nibabel
import numpy as np

from tests.setup.debian import package

MAGNETIC = ("mricron-data", "usr/share/mricron/templates/ch2better.nii.gz")
TOMOGRAPHY = ("invesalius-examples", "usr/share/doc/invesalius-examples/examples/Cranium.inv3")
SLICES = (108, 256, 256)  # z, y, x: the stored order of the tomography


def ch2better():
    """A magnetic resonance image, scaled to 0..1: (301, 370, 316) voxels of 0.5 mm, 63 % void."""
    name, path = MAGNETIC
    values = np.ascontiguousarray(nibabel.load(package(name) / path).dataobj, np.float32)
    return values / values.max()


def cranium():
    """A computed tomography: (256, 256, 108) voxels of 0.957 x 0.957 x 1.5 mm.

    The density is relative to water, from Hounsfield units: air 0, water 1, bone up to 4.
    """
    name, path = TOMOGRAPHY
    with tarfile.open(package(name) / path) as archive:
        matrix = next(entry for entry in archive if entry.name.endswith("matrix.dat"))
        hounsfield = np.frombuffer(archive.extractfile(matrix).read(), "<i2").reshape(SLICES)
    density = 1 + hounsfield.transpose(2, 1, 0) / np.float32(1000)
    # Scanners write less than -1000 outside their field of view.
    return np.ascontiguousarray(np.maximum(density, 0))


def interpolation(count, size):
    """(size, count): the weights of `count` samples at each of `size` samples of the same extent.

    Linear between the samples' centres, constant beyond the outermost; each row sums to 1.
    """
    at = np.clip((np.arange(size) + 0.5) * count / size - 0.5, 0, count - 1)
    return np.maximum(0, 1 - np.abs(at[:, None] - np.arange(count))).astype(np.float32)


def resampled(values, shape):
    """`values` (float32, 3 dimensions) resampled trilinearly to another number of voxels."""
    first, second, third = map(interpolation, values.shape, shape)
    planes = second @ values @ third.T
    return (first @ planes.reshape(len(planes), -1)).reshape(shape)
