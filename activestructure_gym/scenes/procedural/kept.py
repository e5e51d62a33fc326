"""Keep procedural scenes in the cache directory, so that each is made only once on a machine."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.scenes.cache import cached_arrays
from activestructure_gym.scenes.scene import PartLabels, Scene, SceneMesh

_MESH = {"vertices": ("f4", 2), "faces": ("i4", 2), "colors": ("f4", 2), "uv": ("f4", 2), "face_texture": ("i4", 1)}
_LABELS = {"face_part": ("i4", 1), "structural": ("b1", 1)}


def kept_scene(key: str, make: Callable[[], Scene]) -> Scene:
    """Return the scene of ``make()``, from the cache directory if it is there.

    ``key`` identifies the scene. Files made by other sources of this package or another numpy are not used.
    """
    arrays = cached_arrays(f"{key}-{_makers()}", lambda: _arrays(make()), _MESH | _LABELS)
    textures = sum(name.startswith("texture-") for name in arrays)
    mesh: dict[str, Any] = {name: arrays[name] for name in _MESH}
    return Scene(
        name=str(arrays["name"]),
        mesh=SceneMesh(textures=tuple(arrays[f"texture-{n}"] for n in range(textures)), **mesh),
        source=str(arrays["source"]),
        labels=PartLabels(arrays["face_part"], tuple(arrays["part_names"].tolist()), arrays["structural"]),
        generated=True,
    )


def _arrays(scene: Scene) -> dict[str, np.ndarray]:
    """Return the parts of a procedural scene as arrays."""
    assert scene.labels is not None
    return {
        "name": np.array(scene.name),
        "source": np.array(scene.source),
        **{name: getattr(scene.mesh, name) for name in _MESH},
        **{f"texture-{n}": texture for n, texture in enumerate(scene.mesh.textures)},
        "face_part": scene.labels.face_part,
        "part_names": np.array(scene.labels.names),
        "structural": scene.labels.structural,
    }


@cache
def _makers() -> str:
    """Return a checksum of all sources that a procedural scene depends on, and of numpy's version."""
    digest = hashlib.sha256(np.__version__.encode())
    for folder in (Path(__file__).parent, Path(__file__).parents[1]):
        for file in sorted(folder.glob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
