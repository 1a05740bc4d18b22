# SPDX-License-Identifier: GPL-3.0-or-later
"""The real inputs of the demo: a tree grown by `m_tree` and the teapot of a Debian package.

Everything is in metres with z up. Downloads are cached in `build/assets`. This needs no Blender.
"""

from typing import NamedTuple

import collada
import m_tree
import numpy as np

from tests.setup import debian

ASSETS = debian.ASSETS
TEAPOT = ("assimp-testmodels", "usr/share/assimp/models/Collada/teapot_instancenodes.DAE")


class Mesh(NamedTuple):
    """vertices (n, 3) m, float; faces (m, 3) or (m, 4), int, indices into vertices."""

    vertices: np.ndarray
    faces: np.ndarray


# --- The tree ------------------------------------------------------------------------------------

TWIG_RADIUS = 0.015  # m: leaves grow on thinner wood
LEAF_LENGTH, LEAF_WIDTH = 0.12, 0.07  # m


def between(lower, upper):
    """A property of m_tree with uniform random values in [lower, upper]."""
    prop = m_tree.RandomProperty()
    prop.min, prop.max = lower, upper
    return m_tree.PropertyWrapper(prop)


def along(first, last):
    """A property of m_tree that changes from `first` to `last` along the parent branch."""
    prop = m_tree.SimpleCurveProperty()
    prop.x_min, prop.x_max, prop.y_min, prop.y_max, prop.power = 0, 1, first, last, 1
    return m_tree.PropertyWrapper(prop)


def add_branches(parent, seed, length, angle, density, start):
    """Another order of branches on `parent`: `density` per metre beyond the fraction `start`."""
    branches = m_tree.BranchFunction()
    branches.seed = seed
    branches.length = length
    branches.start_angle = angle
    branches.start_radius = m_tree.PropertyWrapper(m_tree.ConstantProperty(0.6))
    branches.distribution.start = start
    branches.distribution.density = density
    parent.add_child(branches)
    return branches


def grow(seed):
    """The mesh of m_tree for a broadleaf of about 7 m: a trunk and three orders of branches."""
    trunk = m_tree.TrunkFunction()
    trunk.seed = seed
    trunk.length, trunk.start_radius, trunk.end_radius = 6, 0.18, 0.03
    trunk.randomness = 0.25
    boughs = add_branches(trunk, seed + 1, along(3.0, 1.0), between(45, 70), density=7, start=0.25)
    twigs = add_branches(
        boughs, seed + 2, between(0.5, 1.4), between(40, 70), density=5, start=0.15
    )
    add_branches(twigs, seed + 3, between(0.2, 0.6), between(40, 70), density=6, start=0.1)
    tree = m_tree.Tree()
    tree.set_trunk_function(trunk)
    tree.execute_functions()
    mesher = m_tree.ManifoldMesher()
    mesher.radial_n_points = 6
    return mesher.mesh_tree(tree)


def unit(vectors):
    """(n, 3) unit vectors along the given ones."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def leaf_quads(stalks, directions, rng):
    """A kite for each leaf: stalks (n, 3) m, and directions (n, 3) of their twigs."""
    count = len(stalks)
    # A leaf grows at an angle to its twig, hangs a little, and faces the sky.
    axis = unit(directions + unit(rng.normal(size=(count, 3))) + [0, 0, -0.3])
    side = unit(np.cross(axis, [0, 0, 1] + 0.7 * rng.normal(size=(count, 3))))
    size = rng.uniform(0.7, 1.2, (count, 1))
    tip, middle = LEAF_LENGTH * size * axis, 0.45 * LEAF_LENGTH * size * axis
    half = LEAF_WIDTH / 2 * size * side
    corners = np.stack([stalks, stalks + middle + half, stalks + tip, stalks + middle - half], 1)
    return Mesh(corners.reshape(-1, 3), np.arange(4 * count).reshape(-1, 4))


def scatter(vertices, quads, count, rng):
    """Evenly spaced points along the twigs: positions (count, 3) m, and a vertex near each."""
    lengths = np.linalg.norm(vertices[quads[:, 0]] - vertices[quads[:, 2]], axis=1)
    chosen = quads[rng.choice(len(quads), count, p=lengths / lengths.sum())]
    share = rng.uniform(size=(count, 1))
    places = (1 - share) * vertices[chosen[:, 0]] + share * vertices[chosen[:, 2]]
    return places, chosen[:, 0]


def tree(seed=1, leaves=20_000):
    """A broadleaf tree of about 7 m: (wood, leaves), two meshes; each quad of leaves is a leaf."""
    grown = grow(seed)
    vertices = np.reshape(grown.get_vertices(), (-1, 3)).astype(float)
    faces = np.reshape(grown.get_polygons(), (-1, 4))
    directions = np.reshape(grown.get_vector3_attribute("direction"), (-1, 3)).astype(float)
    thin = np.asarray(grown.get_float_attribute("radius")) < TWIG_RADIUS
    rng = np.random.default_rng(seed)
    twigs = faces[thin[faces].all(axis=1)]
    stalks, corners = scatter(vertices, twigs, leaves, rng)
    return Mesh(vertices, faces), leaf_quads(stalks, directions[corners], rng)


# --- The teapot ----------------------------------------------------------------------------------


def teapot():
    """The teapot (body, lid, handle, spout) as a mesh of triangles.

    It stands on z = 0, centred on the z axis, and is 1 m long from spout to handle.
    """
    package, path = TEAPOT
    document = collada.Collada(str(debian.package(package) / path))
    # The file holds the same teapot twice, side by side.
    first = next(document.scene.objects("geometry"))
    triangles = next(first.primitives())
    lower, upper = triangles.vertex.min(axis=0), triangles.vertex.max(axis=0)
    foot = np.append((lower + upper)[:2] / 2, lower[2])
    return Mesh((triangles.vertex - foot) / (upper - lower).max(), triangles.vertex_index)
