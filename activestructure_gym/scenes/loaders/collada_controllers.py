"""Apply skins and morphs of COLLADA in the stored pose.

A skin's vertex follows its joints: v' = sum of weight x joint's world matrix x inverse bind matrix x bind shape matrix
x v ([collada], chapter 4, "Skin Deformation (or Skinning) in COLLADA"). The node of the skin does not move it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from activestructure_gym.scenes.loaders.collada_numbers import attribute, fixed, floats, integers
from activestructure_gym.scenes.loaders.damage import UnreadableMesh

Element = ElementTree.Element
Target = Callable[[str | None], Element | None]  # returns the element of a url


@dataclass(frozen=True)
class Controlled:
    """Hold a geometry and the controllers that move its vertices: a skin, a morph, both or neither."""

    geometry: Element
    skin: Element | None = None
    morph: Element | None = None

    @property
    def controls(self) -> bool:
        """Return whether a controller moves the geometry."""
        return self.skin is not None or self.morph is not None

    def positions(
        self, values: np.ndarray, target: Target, worlds: Mapping[Element, np.ndarray], instance: Element
    ) -> np.ndarray:  # [N, 3] -> [N, 3]
        """Return the moved vertices ``values``: in the world frame with a skin, else in the node's frame.

        ``worlds`` are the matrices world_from_node of all nodes, and ``instance`` is the element that places the
        controller. Raises `UnreadableMesh` if the controllers are damaged.
        """
        if values.shape[1] != 3:
            raise UnreadableMesh(f"its positions have {values.shape[1]} numbers")
        if self.morph is not None:
            values = _morphed(self.morph, values, target)
        if self.skin is not None:
            values = _skinned(self.skin, values, target, worlds, instance)
        return values


def controlled(url: str | None, target: Target) -> Controlled | None:
    """Return the geometry that a url refers to, directly or through controllers; None if there is none."""
    element, found = target(url), {}
    while element is not None and element.tag == "controller":
        control = next((child for child in element if child.tag in ("skin", "morph")), None)
        if control is None or control.tag in found:
            return None
        found[control.tag] = control
        element = target(control.get("source"))
    return Controlled(element, **found) if element is not None else None


def _input(holder: Element | None, semantic: str) -> Element:
    found = holder.find(f"input[@semantic='{semantic}']") if holder is not None else None
    if found is None:
        raise UnreadableMesh(f"a controller has no <input> for {semantic}")
    return found


def _array(holder: Element | None, semantic: str, target: Target) -> Element:
    """Return the element with the numbers or names of the input ``semantic`` of ``holder``.

    Raises `UnreadableMesh` if there is none.
    """
    source = target(_input(holder, semantic).get("source"))
    found = next((child for child in source if child.tag.endswith("_array")), None) if source is not None else None
    if found is None:
        raise UnreadableMesh(f"a controller has no values for {semantic}")
    return found


def _morphed(morph: Element, values: np.ndarray, target: Target) -> np.ndarray:
    """Return the vertices ``values`` [N, 3], blended with the morph targets by their weights."""
    targets = morph.find("targets")
    names = (_array(targets, "MORPH_TARGET", target).text or "").split()
    weights = floats(_array(targets, "MORPH_WEIGHT", target).text)
    relative = morph.get("method", "NORMALIZED") == "RELATIVE"
    moved = values * (1.0 if relative else 1.0 - weights.sum())
    for name, weight in zip(names, weights):
        geometry = target(name)
        vertices = geometry.find("mesh/vertices") if geometry is not None else None
        positions = floats(_array(vertices, "POSITION", target).text)
        if len(positions) != values.size:
            raise UnreadableMesh(f"the morph target '{name[:40]}' has another number of vertices than its base")
        moved = moved + weight * positions.reshape(values.shape)
    return moved


def _skinned(
    skin: Element, values: np.ndarray, target: Target, worlds: Mapping[Element, np.ndarray], instance: Element
) -> np.ndarray:
    """Return the vertices ``values`` [N, 3] moved by the joints of the skin; the module's docstring has the formula."""
    shape = skin.findtext("bind_shape_matrix")
    bind_shape = fixed(shape, 16, "bind_shape_matrix").reshape(4, 4) if shape else np.eye(4)
    names = _array(skin.find("joints"), "JOINT", target)
    inverse_bind = floats(_array(skin.find("joints"), "INV_BIND_MATRIX", target).text)
    joints = _joints((names.text or "").split(), target, worlds, instance)
    if len(inverse_bind) != 16 * len(joints):
        raise UnreadableMesh(
            f"a skin with {len(joints)} joints needs 16 numbers of a bind matrix for each, got {len(inverse_bind)}"
        )
    matrices = np.stack([*joints, np.eye(4)]) @ np.stack([*inverse_bind.reshape(-1, 4, 4), np.eye(4)])
    vertex, joint, weight = _weights(skin.find("vertex_weights"), len(values), len(joints), target)
    total = np.bincount(vertex, weight, minlength=len(values))
    blended = np.zeros((len(values), 4, 4))
    np.add.at(blended, vertex, weight[:, None, None] * matrices[joint])
    blended[total > 0] /= total[total > 0, None, None]
    blended[total <= 0] = np.eye(4)
    homogeneous = np.concatenate([values, np.ones((len(values), 1))], axis=1) @ bind_shape.T
    return np.einsum("nij,nj->ni", blended, homogeneous)[:, :3]


def _joints(
    names: list[str], target: Target, worlds: Mapping[Element, np.ndarray], instance: Element
) -> list[np.ndarray]:
    """Return the matrix [4, 4] world_from_node of each joint.

    A name is the sid of a node, preferably below a skeleton of the instance, else the id or the name of a node.
    """
    roots = [root for root in (target(element.text) for element in instance.findall("skeleton")) if root is not None]
    near = [node for root in roots for node in root.iter("node") if node in worlds]
    known: dict[str, Element] = {}
    for key in ("sid", "id", "name"):
        for node in (*near, *worlds):
            known.setdefault(node.get(key, ""), node)
    for name in names:
        if name not in known:
            raise UnreadableMesh(f"the joint '{name[:40]}' of a skin is not a node of its scene")
    return [worlds[known[name]] for name in names]


def _weights(
    holder: Element | None, vertices: int, joints: int, target: Target
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertex index, joint index and weight of every influence of a joint on a vertex.

    The joint -1 means the position in the bind shape.
    """
    values = floats(_array(holder, "WEIGHT", target).text)
    if holder is None:
        raise UnreadableMesh("a skin has no weights")
    inputs = holder.findall("input")
    width = 1 + max(attribute(element, "offset") for element in inputs)
    counts, rows = integers(holder.findtext("vcount")), integers(holder.findtext("v"))
    if len(counts) != vertices or (counts < 0).any() or counts.sum() * width != len(rows):
        raise UnreadableMesh(
            f"a skin has weights for {len(counts)} of {vertices} vertices, or not all of their indices"
        )
    rows = rows.reshape(-1, width)
    joint = rows[:, attribute(_input(holder, "JOINT"), "offset")]
    index = rows[:, attribute(_input(holder, "WEIGHT"), "offset")]
    if len(rows) and (joint.min() < -1 or joint.max() >= joints or index.min() < 0 or index.max() >= len(values)):
        raise UnreadableMesh("a skin names joints or weights that do not exist")
    return np.repeat(np.arange(vertices), counts), joint, values[index]
