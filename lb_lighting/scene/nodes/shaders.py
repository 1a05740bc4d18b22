# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads shader nodes: the closures that reach an output, and the values of their inputs."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...arrays import Floats
from ...errors import LightingError, SceneError
from .arithmetic import Constant, Scaled, Unread
from .attributes import Attributes
from .links import (
    Circle,
    Groups,
    Links,
    Node,
    Place,
    Socket,
    active_output,
    postorder,
    refuse_circle,
    resolve,
)
from .values import as_number, value_of

if TYPE_CHECKING:
    import bpy

type Owner = bpy.types.Light | bpy.types.Material | bpy.types.World
type Image = Any  # bpy.types.Image, whose pixels and size the checker takes for single values
type Tree = dict[Place, list[Place]]

IMAGES = {"TEX_IMAGE", "TEX_ENVIRONMENT"}


@dataclass(frozen=True)
class Closure:
    """A closure node, its weight after Mix Shaders (0 to 1), and the group nodes around it."""

    node: Node
    weight: float
    groups: Groups


class Shader:
    """The nodes of a material, world or light.

    owner       the data-block; errors name it
    error       the LightingError to raise for unsupported nodes
    attributes  from `object_attributes` of the object that has the material, or None if that is
                not known
    """

    def __init__(
        self,
        owner: Owner,
        error: type[LightingError] = SceneError,
        attributes: Attributes | None = None,
    ) -> None:
        self.owner = owner
        self.error = error
        self.attributes = attributes
        self.links = Links()
        # Presets can replace a material, but not a light.
        self.or_preset = ", or choose a preset" if error is SceneError else ""

    def closures(
        self, output: str, known: Collection[str], ignored: Collection[str] = ()
    ) -> list[Closure]:
        """[Closure] that reach the input `output` of the active output node, each node once.

        known    node types to return
        ignored  node types to leave out; any other type raises the error
        """
        try:
            return self._weighted(self._tree(output), known, ignored)
        except Circle as circle:
            raise self._circle(circle) from None

    def refuse_circle(self) -> None:
        """Raise the error if links form a circle, which keeps Cycles from rendering anything."""
        try:
            refuse_circle(self.owner.node_tree)
        except Circle as circle:
            raise self._circle(circle) from None

    def reaching(self, output: str) -> list[Closure]:
        """[Closure] of any type that may reach the input `output`, for any factors of mixes."""
        try:
            tree = self._tree(output)
        except Circle:
            return []  # Cycles renders nothing
        return [
            Closure(socket.node, 1.0, groups)
            for socket, groups in tree
            if socket.is_output and not _mixes(socket)
        ]

    def color(self, closure: Closure, name: str) -> Floats:
        """(3,): the input `name` of a closure, or the mean of an image that is linked to it."""
        return np.broadcast_to(self._average(*self._resolve(closure, name)), 3)

    def number(self, closure: Closure, name: str | int) -> float:
        """The input `name` of a closure, or the mean of an image that is linked to it."""
        socket, groups = self._resolve(closure, name)
        return as_number(self._average(socket, groups), socket)

    def scaled_attribute(self, closure: Closure, name: str) -> Scaled:
        """The input `name` of a closure, a number that may be multiplied by an attribute."""
        socket, groups = self._resolve(closure, name)
        value = as_number(value_of(socket, groups, self.links, self.attributes), socket)
        if isinstance(value, Unread):
            raise self.error(
                f"'{self.owner.name}' computes its {name.lower()} with the node "
                f"'{_shown_name(value.node)}'; only an attribute times a number is supported."
            )
        return value if isinstance(value, Scaled) else Scaled(value)

    def text(self, closure: Closure, name: str) -> str:
        """The text in the input `name` of a closure."""
        socket, _groups = self._resolve(closure, name)
        if socket.is_output:
            raise self._no_constant(socket.node)
        return socket.default_value or ""

    def _tree(self, output: str) -> Tree:
        """{place: [places that it mixes]} for all that reaches an output, in postorder."""
        tree = self.owner.node_tree
        if tree is None:
            return {}
        refuse_circle(tree)
        node, groups = active_output(tree)
        if node is None:
            return {}
        return postorder(self.links.resolve(node.inputs[output], groups), self._mixed)

    def _mixed(self, place: Place) -> list[Place]:
        """The places that an Add or Mix Shader mixes, without those with a share of 0."""
        socket, groups = place
        if not _mixes(socket):
            return []
        inputs = [s for s in socket.node.inputs if s.type == "SHADER"]
        if socket.node.type == "MIX_SHADER":
            factor = self._factor(socket.node.inputs[0], groups)
            inputs = inputs[1:] if factor == 1 else inputs[:1] if factor == 0 else inputs
        return [self.links.resolve(s, groups) for s in inputs]

    def _factor(self, socket: Socket, groups: Groups) -> float | None:
        """The share of a Mix Shader's second shader, 0 to 1; None if it is not constant."""
        socket, groups = self.links.resolve(socket, groups)
        value = as_number(value_of(socket, groups, self.links, self.attributes), socket)
        return None if isinstance(value, (Scaled, Unread)) else float(np.clip(value, 0, 1))

    def _weighted(
        self, tree: Tree, known: Collection[str], ignored: Collection[str]
    ) -> list[Closure]:
        """[Closure] in `tree`, each weighted by the sum over all paths that lead to it."""
        # Mark the places that lead to a closure that is not ignored.
        counts: dict[Place, bool] = {}
        for (socket, groups), below in tree.items():
            is_closure = socket.is_output and not _mixes(socket)
            counts[socket, groups] = any(counts[place] for place in below) or (
                is_closure and socket.node.type not in ignored
            )
        # Pass the weight of the output down to the closures.
        weights = dict.fromkeys(tree, 0.0) | dict.fromkeys(list(tree)[-1:], 1.0)
        closures: list[Closure] = []
        for place, below in reversed(tree.items()):
            (socket, groups), weight = place, weights[place]
            if not counts[place]:
                continue  # nor does the factor of its mix have to be supported
            if _mixes(socket):
                for part, share in zip(below, self._shares(socket.node, groups), strict=True):
                    weights[part] += weight * share
            elif socket.node.type in known:
                closures.append(Closure(socket.node, weight, groups))
            else:
                self._refuse_closure(socket.node)
        return closures[::-1]

    def _refuse_closure(self, node: Node) -> None:
        raise self.error(
            f"'{self.owner.name}' uses the node '{_shown_name(node)}', which is not supported; "
            f"replace it{self.or_preset}."
        )

    def _shares(self, node: Node, groups: Groups) -> list[float]:
        """The shares of the places that `_mixed` returns for a node."""
        if node.type == "ADD_SHADER":
            return [1.0, 1.0]
        factor = self._factor(node.inputs[0], groups)
        if factor in {0.0, 1.0}:
            return [1.0]
        if factor is None:
            factor = float(np.clip(self.number(Closure(node, 1.0, groups), 0), 0, 1))
        return [1 - factor, factor]

    def _resolve(self, closure: Closure, name: str | int) -> Place:
        """The place that the input `name` of a closure gets its value from."""
        try:
            return self.links.resolve(closure.node.inputs[name], closure.groups)
        except Circle as circle:
            raise self._circle(circle) from None

    def _average(self, socket: Socket, groups: Groups) -> Constant:
        """The value of a resolved socket, a number or (3,); for an image, its mean."""
        if socket.is_output and socket.node.type in IMAGES:
            return self._image_average(socket)
        value = value_of(socket, groups, self.links, self.attributes)
        if isinstance(value, (Scaled, Unread)):
            raise self._no_constant(value.node if isinstance(value, Unread) else socket.node)
        return value

    def _no_constant(self, node: Node) -> LightingError:
        return self.error(
            f"'{self.owner.name}' takes a value from the node '{_shown_name(node)}', which has "
            f"no single value; use a constant value or an image{self.or_preset}."
        )

    def _circle(self, circle: Circle) -> LightingError:
        return self.error(
            f"The links of '{self.owner.name}' form a loop at the node "
            f"'{circle.node.name}'; remove one of them."
        )

    def _image_average(self, socket: Socket) -> Constant:
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
        # Transparent pixels do not show their colour.
        return np.average(pixels[..., :3], axis=(0, 1), weights=alpha if alpha.any() else None)


def may_be_positive(closure: Closure, name: str) -> bool:
    """Whether the input `name` of a closure is above 0, or cannot be evaluated."""
    socket, groups = resolve(closure.node.inputs[name], closure.groups)
    value = value_of(socket, groups, Links())
    if isinstance(value, Unread):
        return True
    return bool(np.any(np.greater(value.scale if isinstance(value, Scaled) else value, 0)))


def linear_pixels(image: Image) -> Floats:
    """(height, width, 4) float32, linear, bottom row first; (0, 0, 4) if it is not loaded."""
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    width, height = image.size if values.size else (0, 0)
    pixels = values.reshape(height, width, 4)
    # Blender returns the pixels of byte images as stored, but those of float images as linear.
    if not image.is_float and image.colorspace_settings.name == "sRGB":
        encoded = pixels[..., :3]
        pixels[..., :3] = np.where(
            encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4
        )
    return pixels


def _sphere_average(pixels: Floats) -> Floats:
    """(3,): the mean of an equirectangular image over solid angle."""
    height = len(pixels)
    latitude = np.pi * ((np.arange(height) + 0.5) / height - 0.5)
    return np.average(pixels[..., :3].mean(axis=1), axis=0, weights=np.cos(latitude))


def _mixes(socket: Socket) -> bool:
    return socket.is_output and socket.node.type in {"ADD_SHADER", "MIX_SHADER"}


def _shown_name(node: Node) -> str:
    """The name of a node in the editor; without its add-on, a node has no label."""
    return str(node.name if node.bl_idname == "NodeUndefined" else node.bl_label)
