# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes of `make bench-render`: clouds, a fire in smoke, trees, a teapot."""

from collections.abc import Callable
from dataclasses import dataclass, field

import bpy
import numpy as np
import openvdb

from lb_lighting.scene.enclosure import solid_fraction
from lb_lighting.transport.medium import PRESETS, Domain
from tests.benchmarks import crowns, endtoend, media
from tests.demo import assets
from tests.demo import scenes as demo

SUNS = ((endtoend.FROM_THE_LEFT, endtoend.WHITE),)
LIGHTS = {"sun": (True, False), "sun and sky": (True, True), "white sky": (False, True)}
BAKED = "white sky, baked"  # as the previous, but the sky's direct light is baked too
# (reflectance, transmittance) of leaves in the red, green and blue of the picture.
GREEN = ((0.05, 0.03), (0.10, 0.09), (0.04, 0.02))
WHITE = ((0.45, 0.45),) * 3
TREES = (
    ("green", GREEN, "sun"),
    ("green", GREEN, "sun and sky"),
    ("white", WHITE, "sun"),
    ("white", WHITE, "white sky"),
    ("white", WHITE, BAKED),
)
SAMPLES = 4, 16, 64  # of Cycles
FRAMES = 12
FLAME = (1.0, 0.45, 0.15)  # colour
STRENGTH = 12.0  # W/(m^3 sr) where the grid `flame` is 1
SPOUT = 0.285  # m, where the rest of the spout begins
CLOSED = 128  # voxels along the teapot
DEPTH = 100.0  # optical, of the teapot over its length of 1 m


@dataclass(frozen=True)
class Shot:
    """A scene and its camera.

    group    the part of the benchmark that it belongs to
    build    function of a folder: fills the empty file, returns the objects to light
    facts    everything that the picture depends on
    bounces  of Cycles: those of the reference, then fewer
    half     samples of each half of the reference
    block    edge, in pixels, of the blocks over which the main error is averaged
    ours     samples of our pictures: those of Cycles where edges of leaves cause the noise
    case     the medium of a cloud
    options  of the bake that differ from the defaults
    """

    name: str
    group: str
    build: Callable
    facts: tuple
    bounces: tuple
    half: int
    block: int = 1
    ours: tuple = (1, 4, 16)
    case: endtoend.Case | None = None
    options: dict = field(default_factory=dict)

    @property
    def known_by(self):
        return self.name, *self.facts


def shots():
    """Every `Shot` of one picture."""
    yield from clouds()
    yield from trees()
    yield fire()
    yield teapot()


# --- Clouds --------------------------------------------------------------------------------------


def clouds():
    density = media.cloud(endtoend.EDGE).astype(np.float32)
    for albedo in (0.99, 0.9999):
        for g in (0.0, 0.85):
            name = f"cloud, albedo {albedo:g}, g {g:g}"
            case = endtoend.Case(name, density, 40.0, albedo, g, SUNS)
            bounces = (1024, 32) if (albedo, g) == (0.99, 0) else (1024,)
            yield Shot(name, "clouds", in_medium(case), (case.key,), bounces, 128, case=case)


def in_medium(case):
    return lambda folder: [endtoend.build(case, folder)]


# --- Trees ---------------------------------------------------------------------------------------


def trees():
    case = crowns.CASES["tree"]
    for name, colors, lights in TREES:

        def build(_folder, colors=colors, lights=lights):
            bpy.ops.wm.read_factory_settings(use_empty=True)
            objects = crowns.build(case, colors)
            crowns.light(*LIGHTS[lights.removesuffix(", baked")])
            crowns.look(case, "lit")
            return objects

        facts = (colors, crowns.BARK, *crowns.SUN, crowns.IRRADIANCE, crowns.RADIANCE, lights)
        name, options = f"{name} tree, {lights}", {"sky": True} if lights == BAKED else {}
        scene = name, "trees", build, facts, (32, 12, 4), 64
        yield Shot(*scene, block=4, ours=SAMPLES, options=options)


# --- Smoke ---------------------------------------------------------------------------------------


def fire(frame=0):
    density, flame = plume(frame)
    case = endtoend.Case("smoke", density, 10.0, 0.9, 0.6, ())

    def build(folder):
        source = endtoend.build(case, folder)
        path = folder / f"plume-{frame}.vdb"
        source.data.filepath = str(endtoend.write_grids(path, density=density, flame=flame))
        let_shine(source.active_material)
        return [source]

    facts = (case.key, float(flame.sum()), FLAME, STRENGTH)
    name = "fire in smoke" + f", frame {frame}" * bool(frame)
    return Shot(name, "smoke", build, facts, (128, 8), 128)


def plume(frame):
    """(density, flame), each (EDGE, EDGE, EDGE): smoke that rises by 2 voxels per frame above a
    flickering fire."""
    n = endtoend.EDGE
    x, y, z = media.corners(n)
    curls = np.roll(media.noise(n, np.random.default_rng(3)), 2 * frame, axis=2)
    height = (z + 1) / 2
    radius = 0.25 + 0.45 * height
    aside = np.hypot(x - 0.15 * np.sin(3 * height), y)
    density = np.clip(1.6 * (1 - aside / radius) + 0.45 * curls, 0, 1.5)
    density *= np.clip(4 * (1 - height), 0, 1) * np.clip(6 * (height - 0.04), 0, 1)
    core = 1 - np.hypot(aside / 0.22, (height - 0.2) / 0.16)
    flame = np.clip(2 * core + 0.3 * curls, 0, 1) * (density > 0)
    return density.astype(np.float32), flame.astype(np.float32)


def let_shine(material):
    """Let the grid `flame` emit light."""
    nodes, links = material.node_tree.nodes, material.node_tree.links
    volume = next(node for node in nodes if node.type == "PRINCIPLED_VOLUME")
    grid, times = nodes.new("ShaderNodeAttribute"), nodes.new("ShaderNodeMath")
    grid.attribute_name = "flame"
    times.operation, times.inputs[1].default_value = "MULTIPLY", STRENGTH
    links.new(grid.outputs["Factor"], times.inputs[0])
    links.new(times.outputs[0], volume.inputs["Emission Strength"])
    volume.inputs["Emission Color"].default_value = (*FLAME, 1)


# --- The teapot ----------------------------------------------------------------------------------


def teapot():
    """A teapot with the red band of the preset PMMA, and only a volume material, no surface.

    The original mesh is open, so Cycles cannot tell its inside. This is its hull without the spout,
    which is too thin and open at the end.
    """
    optics = PRESETS["pmma"]
    albedo = optics.sigma_s[0] / (optics.sigma_s[0] + optics.sigma_a[0])
    case = endtoend.Case("teapot", None, DEPTH, albedo, optics.g[0], ())

    def build(_folder):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        ob = demo.mesh_object("Teapot", closed(assets.teapot()), endtoend.medium(case))
        demo.surroundings(target=(0, 0, 0.22), distance=1.5, height=0.5)
        bpy.context.scene.render.film_transparent = True
        return [ob]

    return Shot("teapot", "teapot", build, (str(case), CLOSED, SPOUT), (1024, 32), 64)


def closed(mesh, edge=CLOSED):
    """The outer hull of a `Mesh`, from a grid of `edge` voxels along its longest edge."""
    triangles = mesh.vertices[mesh.faces]
    lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    domain = Domain.around(lower, upper, edge, 3)
    grid = openvdb.FloatGrid()
    inside = solid_fraction(triangles, domain)
    grid.copyFromArray(np.ascontiguousarray(0.5 - inside, np.float32))
    grid.transform = openvdb.createLinearTransform(domain.voxel_size)
    corners, quads = grid.convertToQuads(isovalue=0.0)
    corners = corners + domain.origin + domain.voxel_size / 2
    return assets.Mesh(corners, quads[(corners[quads][..., 0] < SPOUT).all(axis=1)])
