# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading shader nodes: which closures reach an output, and what values feed them."""

from dataclasses import dataclass

import numpy as np

from ..errors import SceneError
from ..ours import is_ours

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709, as Blender turns colour into a number


@dataclass(frozen=True)
class Closure:
    """A closure node, its share after Mix Shaders (0 to 1), and the group nodes around it."""

    node: object
    weight: float
    groups: tuple


class Shader:
    """The nodes of a material, world or light.

    owner    that data-block; its name is in every error
    error    the LightingError to raise for what cannot be read
    """

    def __init__(self, owner, error=SceneError):
        self.owner = owner
        self.error = error
        # A preset stands in for a material, but not for a light.
        self.or_preset = ", or choose a preset" if error is SceneError else ""

    def closures(self, output, known, ignored=()):
        """[Closure] that reach the socket `output` of the active output node.

        known    node types that may be there; any other raises the error
        ignored  node types that may be there and are left out
        """
        node = self.owner.node_tree.get_output_node("CYCLES")
        if node is None:
            return []
        return self._closures(node.inputs[output], (), 1.0, known, ignored)

    def reaching(self, output):
        """[Closure] of any type that may reach the socket `output`, however they are mixed."""
        node = self.owner.node_tree.get_output_node("CYCLES")
        return list(_reaching(node.inputs[output], ())) if node else []

    def color(self, closure, name):
        """(3,): the input `name` of a closure, averaged where an image feeds it."""
        value = self._average(*resolve(closure.node.inputs[name], closure.groups))
        return np.broadcast_to(value, 3)

    def number(self, closure, name):
        """The input `name` of a closure, averaged where an image feeds it."""
        return self._number(closure.node.inputs[name], closure.groups)

    def scaled_attribute(self, closure, name):
        """(scale, attribute name or None) of an input that is a number times an attribute."""
        return self._scaled_attribute(*resolve(closure.node.inputs[name], closure.groups))

    def text(self, closure, name):
        """The text that the input `name` of a closure holds."""
        return resolve(closure.node.inputs[name], closure.groups)[0].default_value

    def _closures(self, socket, groups, weight, known, ignored):
        socket, groups = resolve(socket, groups)
        if not socket.is_output:
            return []
        node = socket.node
        if node.type == "ADD_SHADER":
            first, second = (self._closures(s, groups, weight, known, ignored) for s in node.inputs)
            return first + second
        if node.type == "MIX_SHADER":
            first, second = (
                self._closures(s, groups, weight, known, ignored) for s in node.inputs[1:]
            )
            if not first + second:
                return []  # whatever drives the mix does not matter
            factor = float(np.clip(self._number(node.inputs[0], groups), 0, 1))
            return _weighted(first, 1 - factor) + _weighted(second, factor)
        if node.type in ignored:
            return []
        if node.type not in known:
            raise self.error(
                f"'{self.owner.name}' uses the node '{node.bl_label}', which cannot be converted; "
                f"replace it{self.or_preset}."
            )
        return [Closure(node, weight, groups)]

    def _number(self, socket, groups):
        value = self._average(*resolve(socket, groups))
        return float(LUMINANCE @ value if np.ndim(value) else value)

    def _average(self, socket, groups):
        """The value of a resolved socket: a number or (3,)."""
        if not socket.is_output or socket.node.type in {"RGB", "VALUE"}:
            value = socket.default_value
            return np.array(value[:3]) if hasattr(value, "__len__") else value
        if socket.node.type in {"TEX_IMAGE", "TEX_ENVIRONMENT"}:
            return self._image_average(socket)
        raise self.error(
            f"'{self.owner.name}' takes a value from the node '{socket.node.bl_label}', which has "
            f"no single colour; use a plain value or an image{self.or_preset}."
        )

    def _image_average(self, socket):
        node = socket.node
        pixels = linear_pixels(node.image) if node.image else np.empty((0, 0, 4))
        if not pixels.size:
            raise self.error(
                f"'{self.owner.name}' uses an image that is not loaded; correct its path."
            )
        if node.type == "TEX_ENVIRONMENT":
            if node.projection != "EQUIRECTANGULAR":
                raise self.error(
                    f"'{self.owner.name}' uses a mirror ball; use an equirectangular image instead."
                )
            return _sphere_average(pixels)
        alpha = pixels[..., 3]
        if socket.name == "Alpha":
            return float(alpha.mean())
        # The colour of pixels that are cut away is not seen.
        return np.average(pixels[..., :3], axis=(0, 1), weights=alpha if alpha.any() else None)

    def _scaled_attribute(self, socket, groups):
        """(scale, attribute name or None) of a resolved socket."""
        node = socket.node
        if not socket.is_output or node.type == "VALUE":
            return socket.default_value, None
        if node.type == "ATTRIBUTE":
            return 1.0, node.attribute_name
        if node.type == "VOLUME_INFO":
            return 1.0, socket.name.lower()
        if node.type == "MATH" and node.operation == "MULTIPLY":
            factors = [self._scaled_attribute(*resolve(s, groups)) for s in node.inputs[:2]]
            names = [name for _scale, name in factors if name is not None]
            if len(names) < 2:
                return factors[0][0] * factors[1][0], names[0] if names else None
        raise self.error(
            f"'{self.owner.name}' computes its density with the node '{node.bl_label}'; "
            "only an attribute times a number can be converted."
        )


def resolve(socket, groups=()):
    """(socket, groups): where a value comes from, through links, reroutes and node groups.

    It is an output of a node, or an input that nothing is linked to and that holds the value.
    groups  the group nodes around the socket, outermost first
    """
    if not socket.is_output:
        links = [link for link in socket.links if not link.is_muted]
        return resolve(links[0].from_socket, groups) if links else (socket, groups)
    node = socket.node
    if node.type == "REROUTE":
        return resolve(node.inputs[0], groups)
    if node.type == "GROUP" and is_ours(node):  # what it was put in front of, or behind
        return resolve(node.inputs[0], groups)
    if node.type == "GROUP":
        inside = next(n for n in node.node_tree.nodes if n.type == "GROUP_OUTPUT")
        return resolve(_twin(inside.inputs, socket), (*groups, node))
    if node.type == "GROUP_INPUT":
        return resolve(_twin(groups[-1].inputs, socket), groups[:-1])
    return socket, groups


def may_be_positive(closure, name):
    """Whether the input `name` of a closure is more than 0, or is computed by nodes."""
    socket, _groups = resolve(closure.node.inputs[name], closure.groups)
    computed = socket.is_output and socket.node.type != "VALUE"
    return computed or socket.default_value > 0


def linear_pixels(image):
    """(height, width, 4) float32, linear, from the bottom up; (0, 0, 4) if it is not loaded."""
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    width, height = image.size if pixels.size else (0, 0)
    pixels = pixels.reshape(height, width, 4)
    # Blender hands out the bytes of an image as they are stored, but floats as linear values.
    if not image.is_float and image.colorspace_settings.name == "sRGB":
        encoded = pixels[..., :3]
        pixels[..., :3] = np.where(
            encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4
        )
    return pixels


def _sphere_average(pixels):
    """(3,): the mean over solid angle of an equirectangular image."""
    height = len(pixels)
    latitude = np.pi * ((np.arange(height) + 0.5) / height - 0.5)
    return np.average(pixels[..., :3].mean(axis=1), axis=0, weights=np.cos(latitude))


def _twin(sockets, socket):
    """The one of `sockets` that stands for `socket` on the other side of a group's wall."""
    return next(s for s in sockets if s.identifier == socket.identifier)


def _reaching(socket, groups):
    socket, groups = resolve(socket, groups)
    if not socket.is_output:
        return
    if socket.node.type not in {"ADD_SHADER", "MIX_SHADER"}:
        yield Closure(socket.node, 1.0, groups)
        return
    for shader in socket.node.inputs:
        if shader.type == "SHADER":
            yield from _reaching(shader, groups)


def _weighted(closures, factor):
    return [Closure(c.node, c.weight * factor, c.groups) for c in closures]
