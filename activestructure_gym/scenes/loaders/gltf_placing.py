"""Place the meshes of a glTF file: visible nodes, instances, skins and morph targets.

Specification: [gltf], sections 3.5 and 3.7; KHR_node_visibility, EXT_mesh_gpu_instancing, MSFT_lod. Animations are not
played. A skin is in the stored pose of its joints, and a morph target has the weight stored in its node or mesh.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from activestructure_gym.geometry.rotations import matrix_rows
from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.gltf_data import GltfData
from activestructure_gym.scenes.loaders.mesh_parts import placed

Rows = slice | np.ndarray  # vertices of an array to use


@dataclass(frozen=True)
class Placement:
    """Hold one occurrence of a mesh in the scene."""

    mesh: int  # index in the file's meshes
    world_from_mesh: np.ndarray  # [4, 4]
    weights: tuple[float, ...] = ()  # weights of its morph targets
    world_from_bind: np.ndarray | None = None  # [J, 4, 4] for the joints of its skin


def placements(data: GltfData) -> Iterator[Placement]:
    """Yield every occurrence of a mesh in the default scene, or in the whole file if it has no scene."""
    nodes = data.header.get("nodes", [])
    if not nodes:  # a mesh library without a scene
        for index in range(len(data.header.get("meshes", []))):
            yield Placement(index, np.eye(4), _weights(data, {}, index))
    joints = _Joints(data)
    stack = [(root, np.eye(4)) for root in reversed(_roots(data, nodes))]
    visited = set()
    while stack:
        index, world_from_parent = stack.pop()
        if index in visited:  # every node has one parent
            raise UnreadableMesh("its nodes form a loop or share children")
        visited.add(index)
        data.budget.take("nodes", 1)
        node = data.entry("nodes", index)
        if _extension(node, "KHR_node_visibility").get("visible") is False:  # hides its children too
            continue
        world_from_node = world_from_parent @ _node_matrix(node)
        if "mesh" in node:
            yield from _appearances(data, node, world_from_node, joints)
        stack.extend((child, world_from_node) for child in reversed(node.get("children", [])))


def morphed(data: GltfData, primitive: dict[str, Any], name: str, weights: tuple[float, ...], rows: Rows) -> np.ndarray:
    """Return the values of the attribute ``name`` after morphing, [V, columns]; integer colours are normalised.

    ``weights`` are the weights of the morph targets, ``rows`` the vertices to use.
    """
    values = _shares(data.accessor(primitive["attributes"][name])[rows], name)
    for weight, target in zip(weights, primitive.get("targets", [])):
        if weight and name in target:
            delta = _shares(data.accessor(target[name])[rows], name)
            if delta.shape != values.shape:
                raise UnreadableMesh(
                    f"a morph target has {len(delta)} values of {name} for {len(values)} vertices; export it again"
                )
            data.budget.take("numbers in arrays", values.size)
            values = values + weight * delta
    return values


def _shares(values: np.ndarray, name: str) -> np.ndarray:
    # Some exporters omit the normalised flag of integer colours.
    return values / np.iinfo(values.dtype).max if name.startswith("COLOR") and values.dtype.kind in "iu" else values


def placed_positions(data: GltfData, primitive: dict[str, Any], placement: Placement, rows: Rows) -> np.ndarray:
    """Return the world positions [V, 3] of a primitive, morphed and then moved by its skin's joints or its node."""
    positions = morphed(data, primitive, "POSITION", placement.weights, rows).astype(np.float64)
    if placement.world_from_bind is None or "JOINTS_0" not in primitive["attributes"]:
        return placed(positions, placement.world_from_mesh)
    index, weight = _influences(data, primitive["attributes"], rows)
    if index.size and not 0 <= index.min() <= index.max() < len(placement.world_from_bind):
        raise UnreadableMesh(
            f"a vertex is bound to joint {index.max()}, and its skin has {len(placement.world_from_bind)} joints; "
            "export it again"
        )
    data.budget.take("numbers in arrays", 4 * weight.size)
    moved = np.zeros_like(positions)
    for k in range(index.shape[1]):
        matrices = placement.world_from_bind[index[:, k]]
        moved += weight[:, k, None] * (np.einsum("vij,vj->vi", matrices[:, :3, :3], positions) + matrices[:, :3, 3])
    return moved


def _influences(data: GltfData, attributes: dict[str, int], rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each vertex, the indices of its joints [V, 4 n] and their weights [V, 4 n], which sum to 1.

    n is the number of sets JOINTS_k and WEIGHTS_k of the primitive.
    """
    sets = [name.removeprefix("JOINTS_") for name in attributes if name.startswith("JOINTS_")]
    if missing := [k for k in sets if f"WEIGHTS_{k}" not in attributes]:
        raise UnreadableMesh(f"it has JOINTS_{missing[0]} without WEIGHTS_{missing[0]}; export it again")
    index = np.concatenate([data.accessor(attributes[f"JOINTS_{k}"])[rows] for k in sets], axis=1).astype(np.int64)
    weight = np.concatenate([data.accessor(attributes[f"WEIGHTS_{k}"])[rows] for k in sets], axis=1).astype(np.float64)
    total = weight.sum(axis=1, keepdims=True)
    bound = total[:, 0] > 0
    weight[~bound] = np.eye(1, weight.shape[1])  # a vertex without weights follows its first joint
    return index, weight / np.where(bound[:, None], total, 1.0)


class _Joints:
    """Compute the matrices of the joints of skins, each skin once."""

    def __init__(self, data: GltfData) -> None:
        self._data = data
        self._parents: dict[Any, int] | None = None
        self._world: dict[int, np.ndarray] = {}  # world_from_node [4, 4], including hidden nodes and other scenes
        self._skins: dict[int, np.ndarray] = {}

    def of(self, skin_index: int) -> np.ndarray:  # [J, 4, 4] world_from_bind
        """Return world_from_node times inverse bind matrix of each of the J joints of a skin."""
        if skin_index not in self._skins:
            skin = self._data.entry("skins", skin_index)
            world = np.stack([self._world_from(joint) for joint in skin["joints"]])
            if "inverseBindMatrices" in skin:
                columns = self._data.accessor(skin["inverseBindMatrices"])
                if columns.shape[1] != 16 or len(columns) < len(world):
                    raise UnreadableMesh(
                        f"a skin has {len(world)} joints and {len(columns)} inverse bind matrices; export it again"
                    )
                inverse = columns[: len(world)].astype(np.float64).reshape(-1, 4, 4)
                world = world @ inverse.transpose(0, 2, 1)  # glTF stores matrices by column
            self._skins[skin_index] = world
        return self._skins[skin_index]

    def _world_from(self, index: int) -> np.ndarray:  # [4, 4]
        if self._parents is None:
            nodes = self._data.header.get("nodes", [])
            self._parents = {child: k for k, node in enumerate(nodes) for child in node.get("children", [])}
        chain = [index]
        while chain[-1] in self._parents and chain[-1] not in self._world:
            if len(chain) > len(self._parents):
                raise UnreadableMesh("its nodes form a loop or share children")
            chain.append(self._parents[chain[-1]])
        matrix = np.eye(4)
        for node in reversed(chain):
            if node not in self._world:
                self._world[node] = matrix @ _node_matrix(self._data.entry("nodes", node))
            matrix = self._world[node]
        return matrix


def _appearances(
    data: GltfData, node: dict[str, Any], world_from_node: np.ndarray, joints: _Joints
) -> Iterator[Placement]:
    mesh, weights = node["mesh"], _weights(data, node, node["mesh"])
    if "skin" in node:  # its joints place it; the node's transform is ignored
        yield Placement(mesh, world_from_node, weights, joints.of(node["skin"]))
        return
    attributes = _extension(node, "EXT_mesh_gpu_instancing").get("attributes")
    if not attributes:
        yield Placement(mesh, world_from_node, weights)
        return
    for node_from_instance in _instances(data, attributes):
        yield Placement(mesh, world_from_node @ node_from_instance, weights)


def _instances(data: GltfData, attributes: dict[str, int]) -> np.ndarray:  # [N, 4, 4] node_from_instance
    """Return the matrices of the N instances of a mesh; all attributes must have N values, also unknown ones."""
    counts = {name: data.entry("accessors", index)["count"] for name, index in attributes.items()}
    if len(set(counts.values())) > 1:
        said = ", ".join(f"{name} {str(count)[:20]}" for name, count in list(counts.items())[:6])
        raise UnreadableMesh(f"the instances of one of its nodes have arrays of different lengths ({said})")
    values = {name: data.accessor(attributes[name]) for name in _INSTANCED if name in attributes}
    for name, given in values.items():
        if given.shape[1] != _INSTANCED[name]:
            raise UnreadableMesh(f"the {name} of its instances has {given.shape[1]} numbers and not {_INSTANCED[name]}")
    count = int(next(iter(counts.values())))
    data.budget.take("nodes", count)
    matrices = np.tile(np.eye(4), (count, 1, 1))
    if "ROTATION" in values:
        quaternions = values["ROTATION"].astype(np.float64)  # integers are normalised to unit length too
        quaternions = quaternions / np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), 1e-12)
        x, y, z, w = quaternions.T
        matrices[:, :3, :3] = np.moveaxis(np.array(matrix_rows(w, x, y, z)), -1, 0)
    if "SCALE" in values:
        matrices[:, :3, :3] *= values["SCALE"].astype(np.float64)[:, None, :]
    if "TRANSLATION" in values:
        matrices[:, :3, 3] = values["TRANSLATION"]
    return matrices


_INSTANCED = {"TRANSLATION": 3, "ROTATION": 4, "SCALE": 3}


def _roots(data: GltfData, nodes: list[dict[str, Any]]) -> list[int]:
    scenes = data.header.get("scenes")
    if scenes:
        roots: list[int] = data.entry("scenes", data.header.get("scene", 0)).get("nodes", [])
        return roots
    children = {child for node in nodes for child in node.get("children", [])}
    coarser = {level for node in nodes for level in _extension(node, "MSFT_lod").get("ids", [])}
    return [index for index in range(len(nodes)) if index not in children | coarser]


def _extension(holder: dict[str, Any], name: str) -> dict[str, Any]:
    given = holder.get("extensions", {}).get(name, {})
    return given if isinstance(given, dict) else {}


def _weights(data: GltfData, node: dict[str, Any], mesh: int) -> tuple[float, ...]:
    return tuple(map(float, node.get("weights", data.entry("meshes", mesh).get("weights", ()))))


def _node_matrix(node: dict[str, Any]) -> np.ndarray:  # [4, 4] parent_from_node
    if "matrix" in node:
        return np.asarray(node["matrix"], dtype=np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    matrix[:3, :3] = matrix_rows(w, x, y, z)
    matrix[:3, :3] *= node.get("scale", (1.0, 1.0, 1.0))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix
