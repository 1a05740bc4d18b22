# SPDX-License-Identifier: GPL-3.0-or-later
"""Emissive meshes: flat ones become area lamps, others a few lamps."""

import bmesh
import bpy
import numpy as np
import pytest

from lb_lighting.errors import LightError
from lb_lighting.scene.lights.lamps import scene_lights
from lb_lighting.scene.lights.mesh_lights import MOST, Emitter, lamps_of
from lb_lighting.scene.lights.receivers import Receivers
from lb_lighting.transport.lights.lamps import AreaLight, PointLight
from tests import scenery
from tests.output.rendering import surface
from tests.scene.against import even_world, over_cycles

LOWER, UPPER = np.full(3, -1.0), np.full(3, 1.0)


def read(notes=None, lower=LOWER, upper=UPPER, lit=(), needed=False):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    lit = tuple(lit) or (scenery.link("lit", None),)
    receivers = Receivers(lit, (True,) * len(lit), lower, upper)
    return scene_lights(
        bpy.context.scene, depsgraph, [] if notes is None else notes, needed, receivers
    )


def emissive(strength=5.0, color=(1, 1, 1)):
    return surface("ShaderNodeEmission", Strength=strength, Color=(*color, 1))


def add_panel(z=2.0, material=None, width=1.2, depth=0.8):
    """A rectangle above the box that faces up."""
    x, y = width / 2, depth / 2
    mesh = bpy.data.meshes.new("panel")
    mesh.from_pydata([(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)], [], [(0, 1, 2, 3)])
    mesh.materials.append(material or emissive())
    return scenery.link("panel", mesh)


def backfacing(material, seen_from):
    """Make `material` emit light from the front or the back of faces only."""
    tree = material.node_tree
    mix, geometry = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeNewGeometry")
    glow = next(n for n in tree.nodes if n.type == "EMISSION")
    tree.links.new(geometry.outputs["Backfacing"], mix.inputs[0])
    tree.links.new(glow.outputs[0], mix.inputs[1 if seen_from == "front" else 2])
    tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    return material


@pytest.mark.usefixtures("quick_look")
class TestAgainstCycles:
    def test_a_panel_lights_leaves(self, tmp_path):
        even_world(0.05)
        add_panel().visible_camera = False
        assert over_cycles(tmp_path, scenery.add_leaves()) == pytest.approx(1, abs=0.1)

    def test_a_panel_lights_smoke(self, tmp_path):
        even_world(0.05)
        add_panel().visible_camera = False
        assert over_cycles(tmp_path, scenery.add_fog(tmp_path)) == pytest.approx(1, abs=0.1)


class TestMeshes:
    def test_a_rectangle_is_one_area_light(self):
        """The lower side emits; the upper one faces away from the box."""
        notes = []
        add_panel(material=emissive(5.0, (1, 0.5, 0.25)))
        (light,) = read(notes)
        assert isinstance(light, AreaLight)
        assert light.center == pytest.approx((0, 0, 2))
        assert np.abs(light.u) == pytest.approx((1.2, 0, 0), abs=1e-6)
        assert np.abs(light.v) == pytest.approx((0, 0.8, 0), abs=1e-6)
        assert np.cross(light.u, light.v) == pytest.approx((0, 0, -0.96))
        assert light.power == pytest.approx(np.pi * 5 * 0.96 * np.array((1, 0.5, 0.25)))
        assert not light.ellipse
        assert notes == []

    def test_in_the_box_both_sides_emit(self):
        add_panel(z=0.5)
        lights = read()
        assert sorted(np.cross(a.u, a.v)[2] for a in lights) == pytest.approx((-0.96, 0.96))
        assert [a.power for a in lights] == pytest.approx([np.pi * 5 * 0.96] * 2)

    @pytest.mark.parametrize(("side", "count"), [("front", 0), ("back", 1)])
    def test_nodes_can_make_one_side_dark(self, side, count):
        add_panel(material=backfacing(emissive(), side))
        assert len(read()) == count

    def test_a_mirrored_panel_emits_to_the_same_side(self):
        add_panel(material=backfacing(emissive(), "back")).scale.x = -1
        assert len(read()) == 1

    def test_alpha_scales_the_emission_of_a_principled_bsdf(self):
        material = scenery.leaf_material()
        inputs = material.node_tree.nodes["Principled BSDF"].inputs
        inputs["Emission Strength"].default_value, inputs["Alpha"].default_value = 5.0, 0.5
        add_panel(material=material)
        (light,) = read()
        assert light.power == pytest.approx(np.pi * 5 * 0.96 * 0.5)

    def test_emission_for_the_camera_only_is_left_out(self):
        material = emissive()
        tree = material.node_tree
        path = tree.nodes.new("ShaderNodeLightPath")
        emission = next(n for n in tree.nodes if n.type == "EMISSION")
        tree.links.new(path.outputs["Is Camera Ray"], emission.inputs["Strength"])
        add_panel(material=material)
        assert read() == []

    def test_a_pattern_becomes_even_with_a_note(self):
        material, notes = emissive(), []
        tree = material.node_tree
        noise = tree.nodes.new("ShaderNodeTexNoise")
        emission = next(n for n in tree.nodes if n.type == "EMISSION")
        tree.links.new(noise.outputs[0], emission.inputs["Color"])
        add_panel(material=material)
        (light,) = read(notes)
        assert light.power == pytest.approx(np.pi * 5 * 0.96)
        assert len(notes) == 1
        assert "'panel' (Noise Texture)" in notes[0]

    @pytest.mark.parametrize(
        ("name", "count"),
        [("hide_render", 0), ("hide_viewport", 1), ("visible_volume_scatter", 0),
         ("visible_diffuse", 1), ("visible_camera", 1)],
    )  # fmt: skip
    def test_visibility(self, name, count):
        panel = add_panel()
        setattr(panel, name, name.startswith("hide"))
        assert len(read()) == count

    def test_a_panel_linked_to_other_objects_is_left_out(self):
        notes, panel = [], add_panel()
        panel.light_linking.receiver_collection = bpy.data.collections.new("receivers")
        panel.light_linking.receiver_collection.objects.link(scenery.link("other", None))
        assert read(notes) == []
        assert "Light Linking" in notes[0]

    def test_a_panel_without_emission_sampling_counts(self):
        add_panel().data.materials[0].cycles.emission_sampling = "NONE"
        assert len(read()) == 1

    def test_a_selected_panel_gives_a_note(self):
        notes, panel = [], add_panel(z=0.0)
        assert read(notes, lit=[panel]) == []
        assert len(notes) == 1
        assert "'panel'" in notes[0]
        with pytest.raises(LightError, match=r"no light.*'panel'"):
            read(lit=[panel], needed=True)

    def test_instances_have_their_places(self):
        collection = bpy.data.collections.new("panels")
        panel = add_panel(z=0.0)
        collection.objects.link(panel)
        bpy.context.scene.collection.objects.unlink(panel)
        for x in (-2, 2):
            empty = scenery.link("empty", None)
            empty.instance_type, empty.instance_collection = "COLLECTION", collection
            empty.location = (x, 0, 3)
        assert sorted(light.center for light in read()) == [
            pytest.approx((-2, 0, 3)),
            pytest.approx((2, 0, 3)),
        ]

    def test_a_bulb_gives_a_note(self):
        notes, bulb = [], scenery.add_ball("bulb", 0.05, material=emissive())
        bulb.location = (0, 0, 4)
        (light,) = read(notes)
        assert light.power == pytest.approx(4 * np.pi * 5 * np.pi * 0.05**2, rel=0.05)
        assert len(notes) == 1
        assert "'bulb'" in notes[0]

    def test_the_number_of_lamps_is_limited(self):
        notes = []
        for x in range(MOST + 4):
            add_panel().location = (x, 0, 1)
        assert len(read(notes)) == MOST
        assert len(notes) == 1
        assert f"'panel.{MOST:03}'" in notes[0]


def grid_of(place, count, close=False):
    """Triangles (n, 3, 3) of the surface place(u, v), for u and v from 0 to 1."""
    ticks = np.linspace(0, 1, count + 1)
    points = np.stack(place(*np.meshgrid(ticks, ticks, indexing="ij")), axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))])


def cube_of(size, center):
    shape, mesh = bmesh.new(), bpy.data.meshes.new("cube")
    bmesh.ops.create_cube(shape, size=1)
    bmesh.ops.triangulate(shape, faces=shape.faces)
    shape.to_mesh(mesh)
    shape.free()
    points = np.array([v.co for v in mesh.vertices]) * size + center
    return points[np.array([p.vertices for p in mesh.polygons])]


def sphere_of(radius, center):
    def place(u, v):
        turn, tilt = 2 * np.pi * u, np.pi * (1 - v)
        x, y = np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn)
        return [radius * w + c for w, c in zip((x, y, np.cos(tilt)), center, strict=True)]

    return grid_of(place, 24)


def tube_of(radius, length, center):
    def place(u, v):
        turn = 2 * np.pi * u
        x, y, z = center
        return radius * np.cos(turn) + x, y + length * (v - 0.5), radius * np.sin(turn) + z

    return grid_of(place, 24)[:, ::-1]


def test_a_bulb_in_the_box_is_a_point():
    triangles = sphere_of(0.1, (0.1, -0.3, 0.2))
    count, one = len(triangles), np.ones(3)
    bulb = Emitter("bulb", triangles, np.zeros(count, bool), np.ones(count, bool), one, one)
    (light,) = lamps_of([bulb], LOWER, UPPER).lights
    assert isinstance(light, PointLight)
    assert light.position == pytest.approx((0.1, -0.3, 0.2))
    assert light.power == pytest.approx(4 * np.pi**2 * 0.1**2, rel=0.02)


def ring_of(radius, hole, z):
    def place(u, v):
        turn, r = 2 * np.pi * u, hole + (radius - hole) * v
        return r * np.cos(turn), r * np.sin(turn), np.full_like(u, z)

    return grid_of(place, 32)


def scattered(count, z):
    rng = np.random.default_rng(3)
    corners = rng.normal(size=(count, 1, 3)) * 0.2 + rng.normal(size=(count, 3, 3)) * 0.05
    return corners + np.array((0, 0, z))


def quartered(triangles):
    a, b, c = np.moveaxis(triangles, 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    pieces = (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)
    return np.concatenate([np.stack(piece, axis=1) for piece in pieces])


def fluence_of_triangles(triangles, both, places):
    """(n,) at places (n, 3), divided by radiance, of fronts or both sides, without occlusion."""
    while len(triangles) < 1000:
        triangles = quartered(triangles)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
    offsets = places[:, None] - triangles.mean(axis=1)
    ahead = np.einsum("pti,ti->pt", offsets, normal)
    ahead = np.abs(ahead) if both else np.maximum(ahead, 0)
    return (ahead / np.linalg.norm(offsets, axis=2) ** 3).sum(axis=1)


def fluence_of(lights, places):
    """(n,) W/m^2 at places (n, 3)."""
    total = np.zeros(len(places))
    for light in lights:
        if isinstance(light, PointLight):
            distance = np.linalg.norm(places - light.position, axis=1)
            total += light.power / (4 * np.pi * distance**2)
            continue
        s, t = (np.indices((24, 24)).reshape(2, -1) + 0.5) / 24 - 0.5
        inside = s**2 + t**2 < 0.25 if light.ellipse else np.full(len(s), True)
        points = np.outer(s, light.u) + np.outer(t, light.v) + light.center
        normal = np.cross(light.u, light.v)
        offsets = places[:, None] - points[inside]
        cosine = np.maximum(offsets @ normal, 0) / np.linalg.norm(normal)
        share = (cosine / np.linalg.norm(offsets, axis=2) ** 3).mean(axis=1)
        total += light.power / np.pi * share
    return total


class TestShapes:
    """The fluence in the box, compared with the sum over all triangles."""

    @pytest.mark.parametrize(
        ("triangles", "closed", "tolerance"),
        [
            pytest.param(sphere_of(0.05, (0, 0, 3)), True, 0.01, id="bulb far away"),
            pytest.param(sphere_of(0.1, (0.1, 0.2, 2)), True, 0.05, id="bulb close by"),
            pytest.param(sphere_of(1.0, (0, 0, 3)), True, 0.08, id="globe close by"),
            pytest.param(cube_of((2, 2, 0.1), (0, 0, 2)), True, 0.02, id="panel with a depth"),
            pytest.param(cube_of((1, 1, 1), (1.5, 1.5, 2)), True, 0.05, id="cube at an edge"),
            pytest.param(tube_of(0.02, 2, (0, 0, 2)), False, 0.08, id="neon tube"),
            pytest.param(ring_of(1, 0.0, 2), False, 0.02, id="disk"),
            pytest.param(ring_of(1, 0.8, 2), False, 0.05, id="ring"),
            pytest.param(scattered(500, 3), False, 0.1, id="fairy lights"),
            pytest.param(sphere_of(6, (0, 0, 0)), True, 0.06, id="dome around"),
        ],
    )
    def test_light(self, triangles, closed, tolerance, request):
        count = len(triangles)
        around = np.abs(triangles).max() > 5
        emitter = Emitter(
            "it", triangles, np.zeros(count, bool), np.full(count, closed), np.ones(3), np.ones(3)
        )
        shining = lamps_of([emitter], LOWER, UPPER)
        assert 1 <= len(shining.lights) <= MOST
        if "bulb" in request.node.name:
            assert len(shining.lights) == 1
        places = np.random.default_rng(0).uniform(-1, 1, (100, 3))
        facing = triangles[:, ::-1] if around else triangles
        expected = fluence_of_triangles(facing, not closed, places)
        fluence = fluence_of(shining.lights, places)
        assert fluence.mean() == pytest.approx(expected.mean(), rel=tolerance)
        assert fluence == pytest.approx(expected, rel=4 * tolerance)
