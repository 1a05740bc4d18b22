# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that tests of voxels share."""

import bpy
import numpy as np
from mathutils import Euler, Matrix

from lb_lighting.scene import read_meshes
from lb_lighting.transport.medium import Domain

ROTATED_SCALED = Matrix.LocRotScale((3, -1, 2), Euler((0.4, 0.9, -0.3)), (2, 0.5, 1.3))


def add_object(mesh, name="ob", matrix=None):
    ob = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(ob)
    if matrix is not None:
        ob.matrix_world = matrix
    return ob


def add_mesh(vertices, faces, name="mesh"):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    return mesh


def add_cube(name="cube", matrix=None):
    """A cube of edge 1 around the origin."""
    bpy.ops.mesh.primitive_cube_add(size=1)
    cube = bpy.context.object
    cube.name = name
    if matrix is not None:
        cube.matrix_world = matrix
    return cube


def add_sphere(subdivisions=4):
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=subdivisions, radius=1)
    return bpy.context.object


def parts_of(*objects):
    return read_meshes.world_parts(bpy.context.evaluated_depsgraph_get(), objects)


def triangles_of(*objects):
    return np.concatenate([part.faces.triangles for part in parts_of(*objects)])


def area_of(triangles):
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2


def domain_of(triangles, resolution=32):
    points = triangles.reshape(-1, 3)
    return Domain.around(points.min(axis=0), points.max(axis=0), resolution)
