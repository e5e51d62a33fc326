"""Write the mesh of a scene as a binary glTF file, for the page of the environment Mesh-v0."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from activestructure_gym.scenes import SceneMesh

_BUFFERS = {np.dtype(np.float32): 5126, np.dtype(np.uint32): 5125}  # component type by dtype (glTF 2.0, 3.6.2.2)


def write_glb(mesh: SceneMesh, path: Path) -> None:
    """Write the triangles, textures and vertex colours of ``mesh`` to the file ``path``.

    glTF needs y up and linear vertex colours (glTF 2.0, 3.4 and 3.9.2).
    """
    whole: dict[str, Any] = {
        "asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "images": [], "textures": [], "materials": [],
    }  # fmt: skip
    data = bytearray()

    def view(content: bytes) -> int:
        whole["bufferViews"].append({"buffer": 0, "byteOffset": len(data), "byteLength": len(content)})
        data.extend(content + b"\0" * (-len(content) % 4))
        return len(whole["bufferViews"]) - 1

    def accessor(values: np.ndarray) -> int:
        kind = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}[values.shape[1] if values.ndim == 2 else 1]
        of_values = {"bufferView": view(values.tobytes()), "componentType": _BUFFERS[values.dtype], "type": kind}
        limits = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()} if values.ndim == 2 else {}
        whole["accessors"].append({**of_values, "count": len(values), **limits})
        return len(whole["accessors"]) - 1

    colors = mesh.colors if mesh.linear_colors else linear(mesh.colors)
    y_up = mesh.vertices[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
    attributes = {
        "POSITION": accessor(y_up.astype(np.float32)),
        "COLOR_0": accessor(colors.astype(np.float32)),
        "TEXCOORD_0": accessor(mesh.uv.astype(np.float32)),
    }
    primitives = []
    for texture in np.unique(mesh.face_texture):
        pbr: dict[str, Any] = {"metallicFactor": 0.0}
        if texture >= 0:
            png = io.BytesIO()
            Image.fromarray(mesh.textures[texture]).save(png, "png")
            whole["images"].append({"bufferView": view(png.getvalue()), "mimeType": "image/png"})
            whole["textures"].append({"source": len(whole["images"]) - 1})
            pbr["baseColorTexture"] = {"index": len(whole["textures"]) - 1}
        whole["materials"].append({"pbrMetallicRoughness": pbr})
        corners = mesh.faces[mesh.face_texture == texture].astype(np.uint32).reshape(-1)
        material = len(whole["materials"]) - 1
        primitives.append({"attributes": attributes, "indices": accessor(corners), "material": material})
    whole |= {
        "meshes": [{"primitives": primitives}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}],
        "buffers": [{"byteLength": len(data)}],
    }  # fmt: skip
    text = json.dumps(whole).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(parts)) + parts)


def linear(srgb: np.ndarray) -> np.ndarray:
    """Convert sRGB values in 0..1 to linear light (IEC 61966-2-1)."""
    shown = np.clip(srgb, 0.0, 1.0)
    return np.asarray(np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4))
