# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume grids, from files, sequences and geometry nodes, and any grid onto the lattice."""

import tempfile
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np
import openvdb

from ..errors import EmptyError, SceneError
from ..essence import content_of_file, content_of_grid

SLAB = 1 << 17  # samples taken at once: few enough for the cache


@dataclass(frozen=True)
class Grid:
    """A grid by its name in a .vdb file, read when it is needed, or one that no file has.

    path  of the file, or ""
    made  the openvdb grid that is in no file, or None
    """

    name: str
    path: str = ""
    made: object = None

    @cached_property
    def vdb(self):
        """The openvdb grid."""
        return openvdb.read(self.path, self.name) if self.made is None else self.made

    @property
    def essence(self):
        """What the grid holds, wherever it lies."""
        if self.made is None:
            return self.name, content_of_file(self.path)
        return self.name, _index_to_object(self.made), content_of_grid(self.made)


@dataclass(frozen=True)
class Cells:
    """A dense grid in the world, values and index_to_world as `resample_array` has them."""

    values: np.ndarray
    index_to_world: np.ndarray

    def on(self, domain):
        """(nx, ny, nz) float32: averaged over the voxels of `domain`."""
        return resample_array(self.values, self.index_to_world, domain)

    def at(self, other):
        """The values at the voxel centres of other `Cells`, in their shape."""
        if other is self:
            return self.values
        to_own = np.linalg.inv(self.index_to_world) @ other.index_to_world
        places = _positions(to_own, (0, 0, 0), other.values.shape)
        return _trilinear(np.pad(self.values, 1), places + 1)


def grid_names(ob, depsgraph):
    """Names of the grids that the original object `ob` shows at the current frame."""
    _geometry, grids = _loaded(ob, depsgraph)
    return [grid.name for grid in grids]


def find_grid(ob, depsgraph, name="density"):
    """The `Grid` called `name` of the original object `ob` at the current frame.

    Raises EmptyError for a file that cannot be read, or a name that does not exist: another frame
    may have them.
    """
    geometry, grids = _loaded(ob, depsgraph)
    names = [grid.name for grid in grids]
    if name not in names:
        raise EmptyError(f"'{ob.name}' has no grid '{name}'; choose one of: {', '.join(names)}.")
    if grids.frame_filepath and not ob.modifiers:
        return Grid(name, grids.frame_filepath)
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder, "evaluated.vdb"))
        geometry.volume.grids.save(filepath=path)
        return Grid(name, made=openvdb.read(path, name))


def has_volume(ob, depsgraph):
    """Whether the original object `ob` shows a volume, its own or one that its nodes make."""
    return _volume_geometry(ob, depsgraph) is not None


def volume_material(ob, depsgraph):
    """The material that the volume of `ob` has by its slot or its nodes, or None."""
    geometry = _volume_geometry(ob, depsgraph)  # it owns its volume and has to outlive it
    made = [] if ob.type == "VOLUME" else geometry.volume.materials
    return made[0].original if made and made[0] else ob.active_material


def is_in_object_space(ob, depsgraph):
    """Whether a material's coefficients are per unit of the object's own space, not per m."""
    geometry = _volume_geometry(ob, depsgraph)
    return geometry.volume.render.space == "OBJECT"


def world_matrix(ob, depsgraph):
    """(4, 4): the evaluated object's space to world space; SceneError where that is flat."""
    matrix = np.array(ob.evaluated_get(depsgraph).matrix_world, np.float32)
    if np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        raise SceneError(f"'{ob.name}' is scaled to nothing along an axis; give it a size.")
    return matrix.astype(float)


def box_bounds(lower, upper, matrix):
    """(lower, upper), each (3,): the box around the box from `lower` to `upper` under `matrix`."""
    corners = _apply(matrix, np.array(list(product(*zip(lower, upper, strict=True)))))
    return corners.min(axis=0), corners.max(axis=0)


def world_bounds(grid, matrix_world):
    """(lower, upper), each (3,) m: the box around the active voxels of `grid` in world space.

    matrix_world  (4, 4), of the object that shows the grid
    """
    lower, upper = _active_box(grid)
    return box_bounds(lower - 0.5, upper + 0.5, np.asarray(matrix_world) @ _index_to_object(grid))


def resample(grid, matrix_world, domain):
    """`grid` averaged over the voxels of `domain`: (nx, ny, nz) float32, 0 outside of the grid.

    A vector grid gives (3, nx, ny, nz).
    matrix_world  (4, 4), of the object that shows the grid
    Raises SceneError for values that are negative or not finite.
    """
    cells = near_cells(grid, matrix_world, domain)
    if cells.values.ndim == 3:
        return cells.on(domain)
    bands = np.moveaxis(cells.values, -1, 0)
    return np.stack([resample_array(band, cells.index_to_world, domain) for band in bands])


def near_cells(grid, matrix_world, domain):
    """The `Cells` of `grid`, a vector's with the channels last, that are seen from `domain`.

    Raises SceneError for values that are negative or not finite.
    """
    matrix = np.asarray(matrix_world) @ _index_to_object(grid)
    to_grid = np.linalg.inv(matrix) @ domain.index_to_world
    lower, upper = box_bounds((-0.5,) * 3, np.subtract(domain.shape, 0.5), to_grid)
    active_lower, active_upper = _active_box(grid)
    # One voxel more, because a value reaches as far as the next voxel's centre.
    lower = np.maximum(active_lower, np.floor(lower) - 1).astype(int)
    upper = np.minimum(active_upper, np.ceil(upper) + 1).astype(int)
    channels = (3,) if isinstance(grid.background, tuple) else ()
    values = np.empty((*np.maximum(upper - lower + 1, 0), *channels), np.float32)
    if values.size:
        grid.copyToArray(values, tuple(map(int, lower)))
    _refuse_bad_voxels(values, grid.name)
    return Cells(values, matrix @ _translation(lower))


def resample_array(values, index_to_world, domain):
    """`values` averaged over the voxels of `domain`: (nx, ny, nz) float32.

    values          (mx, my, mz), trilinear between voxel centres and 0 outside, as Cycles has it
    index_to_world  (4, 4): the centre of voxel (i, j, k) is at index_to_world @ (i, j, k, 1)

    The integral over space is kept: a fine grid is averaged in blocks of about half a domain voxel
    or more, and the blocks are sampled about as densely as they lie.
    """
    to_index = np.linalg.inv(index_to_world) @ domain.index_to_world
    values, to_index = _coarsened(values, to_index)
    result = np.zeros(domain.shape, np.float32)
    if not values.size:
        return result
    padded = np.pad(values, 1)
    offsets = _sub_voxels(to_index)
    depth = max(1, SLAB // (domain.shape[1] * domain.shape[2]))
    for start in range(0, domain.shape[0], depth):
        slab = result[start : start + depth]
        for offset in offsets:
            shift = np.add(offset, (start, 0, 0))
            slab += _trilinear(padded, _positions(to_index, shift, slab.shape) + 1)
        slab /= len(offsets)
    return result


def _volume_geometry(ob, depsgraph):
    """The evaluated geometry of `ob` if there is a volume in it, or None."""
    try:
        geometry = ob.evaluated_get(depsgraph).evaluated_geometry()
    except TypeError:  # empties, lamps and the like
        return None
    return geometry if geometry.volume is not None else None


def _loaded(ob, depsgraph):
    """(geometry, grids); the geometry owns the grids and has to outlive them."""
    geometry = _volume_geometry(ob, depsgraph)
    if geometry is None:
        raise SceneError(f"'{ob.name}' has no volume; choose a Volume object or one that makes it.")
    grids = geometry.volume.grids
    # The error of an earlier frame stays with the grids of this one.
    if not grids.load() and not len(grids):
        raise EmptyError(
            f"The volume file '{geometry.volume.filepath}' of '{ob.name}' cannot be read "
            f"({grids.error_message}); correct its path."
        )
    if not len(grids):
        raise EmptyError(f"The volume of '{ob.name}' has no grids; choose a file that has some.")
    return geometry, grids


def _active_box(grid):
    """The first and the last active voxel, (3,) int each."""
    if not grid.activeVoxelCount():
        raise EmptyError(f"The grid '{grid.name}' is empty; choose one with active voxels.")
    return tuple(map(np.array, grid.evalActiveVoxelBoundingBox()))


def _index_to_object(grid):
    """(4, 4): the grid's own transform."""
    if not grid.transform.isLinear:
        raise SceneError(f"The grid '{grid.name}' is a frustum; save it with a linear transform.")
    origin, *axes = (
        np.array(grid.transform.indexToWorld(p)) for p in ((0, 0, 0), *np.eye(3, dtype=int))
    )
    matrix = np.eye(4)
    matrix[:3, 3] = origin
    matrix[:3, :3] = np.transpose(axes - origin)
    return matrix


def _refuse_bad_voxels(values, name):
    bad = np.count_nonzero(~(np.isfinite(values) & (values >= 0)))
    if bad:
        raise SceneError(
            f"The grid '{name}' has {bad} voxels that are negative or not finite; "
            "repair it, or choose another grid."
        )


def _translation(vector):
    matrix = np.eye(4)
    matrix[:3, 3] = vector
    return matrix


def _apply(matrix, points):
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _coarsened(values, to_index):
    """`values` averaged in blocks where they are much finer than the domain, with `to_index`."""
    per_voxel = np.linalg.norm(to_index[:3, :3], axis=1)
    factors = np.maximum(1, np.round(per_voxel / 2)).astype(int)
    shape = np.ceil(np.divide(values.shape, factors)).astype(int)
    values = np.pad(values, [(0, d) for d in shape * factors - values.shape])
    blocks = values.reshape([n for pair in zip(shape, factors, strict=True) for n in pair])
    to_block = np.diag([*(1 / factors), 1.0]) @ _translation((1 - factors) / 2)
    return blocks.mean(axis=(1, 3, 5), dtype=np.float64).astype(np.float32), to_block @ to_index


def _sub_voxels(to_index):
    """[(3,)] offsets, in domain voxels, of samples that lie no wider apart than the values."""
    steps = np.linalg.norm(to_index[:3, :3], axis=0)
    counts = np.maximum(1, np.ceil(steps - 0.1)).astype(int)  # little is lost at 1.1
    return list(product(*((np.arange(n) + 0.5) / n - 0.5 for n in counts)))


def _positions(to_index, shift, shape):
    """(3, *shape): `to_index` of the lattice points of `shape`, moved by `shift`."""
    axes = np.ix_(*(np.arange(n) + s for n, s in zip(shape, shift, strict=True)))
    return np.stack(
        [sum(m * a for m, a in zip(row, axes, strict=False)) + row[3] for row in to_index[:3]]
    )


def _trilinear(padded, positions):
    """`padded` (with a border of zeros) at `positions` (3, ...), in its voxels; 0 beyond."""
    last = np.array(padded.shape).reshape(3, *[1] * (positions.ndim - 1)) - 1
    inside = np.all((positions >= 0) & (positions < last), axis=0)
    positions = positions[:, inside]
    base = positions.astype(np.int64)
    high = (positions - base).astype(np.float32)
    sides = (1 - high, high)
    strides = padded.shape[1] * padded.shape[2], padded.shape[2], 1
    first = sum(stride * index for stride, index in zip(strides, base, strict=True))
    values = padded.ravel()
    found = np.zeros(first.shape, np.float32)
    for i, j, k in product((0, 1), repeat=3):
        weight = sides[i][0] * sides[j][1] * sides[k][2]
        found += weight * values[first + np.dot(strides, (i, j, k))]
    result = np.zeros(inside.shape, np.float32)
    result[inside] = found
    return result
