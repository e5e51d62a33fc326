"""Compute the matrix of a COLLADA node from its transform elements."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from activestructure_gym.scenes.loaders.collada_numbers import fixed
from activestructure_gym.scenes.loaders.damage import UnreadableMesh


def node_matrix(node: ElementTree.Element) -> np.ndarray:  # [4, 4] parent_from_node
    """Return the product of the matrices of the node's transform elements, in their order."""
    matrix = np.eye(4)
    for element in node:
        step = np.eye(4)
        if element.tag == "matrix":
            step = fixed(element.text, 16, "matrix").reshape(4, 4)
        elif element.tag == "translate":
            step[:3, 3] = fixed(element.text, 3, "translate")
        elif element.tag == "scale":
            step[:3, :3] = np.diag(fixed(element.text, 3, "scale"))
        elif element.tag == "rotate":
            from scipy.spatial.transform import Rotation

            x, y, z, degrees = fixed(element.text, 4, "rotate")
            axis = np.array([x, y, z]) / max(np.linalg.norm([x, y, z]), 1e-12)
            step[:3, :3] = Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()
        elif element.tag == "skew":
            step[:3, :3] = _skew(fixed(element.text, 7, "skew"))
        elif element.tag == "lookat":
            step = _lookat(fixed(element.text, 9, "lookat").reshape(3, 3))
        else:
            continue
        matrix = matrix @ step
    return matrix


def _skew(numbers: np.ndarray) -> np.ndarray:  # [7] -> [3, 3]
    """Return a shear along the second axis by which the first axis turns towards it by an angle (as in RenderMan).

    ``numbers`` are the angle in degrees, the first axis and the second axis.
    """
    degrees, turned, along = numbers[0], _unit(numbers[1:4], "skew"), _unit(numbers[4:7], "skew")
    across = _unit(turned - (turned @ along) * along, "skew")
    before = np.arctan2(turned @ across, turned @ along)  # angle between the two axes, radians
    after = before - np.radians(degrees)
    if not 1e-6 < after < np.pi - 1e-6:
        raise UnreadableMesh(f"a <skew> of {degrees:g} degrees turns one of its axes beyond the other")
    return np.eye(3) + (1.0 / np.tan(after) - 1.0 / np.tan(before)) * np.outer(along, across)


def _lookat(rows: np.ndarray) -> np.ndarray:  # [3, 3] eye, point looked at, up -> [4, 4]
    """Return the matrix of a node at the eye, with its -z axis towards the point and its y axis up."""
    eye, point, up = rows
    back = _unit(eye - point, "lookat")
    right = _unit(np.cross(up, back), "lookat")
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(back, right), back, eye], axis=1)
    return matrix


def _unit(vector: np.ndarray, name: str) -> np.ndarray:
    length = np.linalg.norm(vector)
    if not 1e-9 < length < np.inf:
        raise UnreadableMesh(f"the directions of a <{name}> are zero or parallel")
    return vector / length
