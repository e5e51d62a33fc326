"""Read glTF 2.0 (`.glb` and `.gltf`).

trimesh reads glTF too, but it does not normalise integer coordinates, skips sparse accessors, texture transforms and
second UV sets, and does not report missing images; common exporters write all of these. Specification: [gltf];
KHR_texture_transform, KHR_mesh_quantization, EXT_texture_webp, KHR_materials_pbrSpecularGlossiness. `gltf_extensions`
lists the supported extensions; `gltf_placing` places the meshes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.gltf_data import GltfData, data_uri
from activestructure_gym.scenes.loaders.gltf_extensions import REFUSED, TRANSMITTING, check_extensions, refuse
from activestructure_gym.scenes.loaders.gltf_placing import Placement, Rows, morphed, placed_positions, placements
from activestructure_gym.scenes.loaders.mesh_parts import PLAIN_GREY, MeshPart, TextureStore
from activestructure_gym.scenes.loaders.opacity import SOLID_FROM, Opacity
from activestructure_gym.scenes.scene import CLAMP, MIRROR, REPEAT

_TYPES = {"POSITION": ("VEC3",)}
_NUMBERED_TYPES = {"COLOR": ("VEC3", "VEC4"), "TEXCOORD": ("VEC2",), "JOINTS": ("VEC4",), "WEIGHTS": ("VEC4",)}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_WRAPS = {33071: CLAMP, 33648: MIRROR, 10497: REPEAT}

_PLAIN = [((PLAIN_GREY + 0.055) / 1.055) ** 2.4] * 3  # grey in linear light; the default white would hide all shading


@dataclass(frozen=True)
class GltfFile:
    """Hold the parts of a glTF file in its own axes, and the declared up axis."""

    parts: list[MeshPart]
    up: str | None  # text of "up" in the extras of the asset or default scene, None if absent


def read_gltf(path: Path, textures: TextureStore) -> GltfFile:
    """Read all triangles of the default scene. Raises `InputError` with the reason for an unreadable file."""
    data = GltfData(path, textures.budget)
    if unread := check_extensions(path, data.header):
        textures.notes.append(
            f"the file uses glTF extensions that are not read ({', '.join(unread)[:200]}): what they place, hide or "
            "paint is missing or wrong"
        )
    document = _Document(data, textures)
    parts = list(document.parts())
    if document.transmitting:
        names = " or ".join(TRANSMITTING)
        textures.notes.append(f"{document.transmitting} faces let light through ({names}) and are solid here")
    return GltfFile(parts, _declared_up(data.header))


def _declared_up(header: dict[str, Any]) -> str | None:
    """Return the up axis that the file declares under "up" in the extras of its asset or scene; None without it.

    This entry is specific to this project: glTF has one up axis, +y (glTF 2.0, section 3.4), and no field for another.
    """
    scenes = header.get("scenes") or [{}]
    for holder in (header.get("asset", {}), scenes[header.get("scene", 0)]):
        extras = holder.get("extras")  # any program may write any type of value here
        if isinstance(extras, dict) and isinstance(extras.get("up"), str):
            return extras["up"].strip().lower()
    return None


class _Document:
    """Convert the meshes of one glTF file to `MeshPart`s; images are decoded once, on first use."""

    def __init__(self, data: GltfData, textures: TextureStore) -> None:
        self.data = data
        self.textures = textures
        self._images: dict[int, int] = {}
        self.transmitting = 0  # number of faces of glass

    def parts(self) -> Iterator[MeshPart]:
        for placement in placements(self.data):
            for primitive in self.data.entry("meshes", placement.mesh)["primitives"]:
                part = self._part(primitive, placement)
                if part is not None:
                    yield part

    def _part(self, primitive: dict[str, Any], placement: Placement) -> MeshPart | None:
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN):  # points and lines
            return None
        attributes = primitive["attributes"]
        self._check_attributes(primitive, attributes)
        positions = self.data.accessor(attributes["POSITION"])
        self.data.budget.take("meshes and copies of them", 1)
        indices = self.data.accessor(primitive["indices"]).reshape(-1) if "indices" in primitive else None
        count = len(positions) if indices is None else len(indices)
        self.data.budget.take("triangles", count // 3 if mode == _TRIANGLES else max(0, count - 2))
        self.data.budget.take("vertices", min(count, len(positions)))
        # Exporters let many primitives share one vertex array; each keeps only the vertices that it uses.
        used: Rows = slice(None)
        if indices is None:
            indices = np.arange(len(positions))
        elif 0 < len(indices) < len(positions) and indices.max() < len(positions):
            used, indices = np.unique(indices, return_inverse=True)
        material = self._material(primitive.get("material"))
        if "COLOR_0" in attributes:
            colors = morphed(self.data, primitive, "COLOR_0", placement.weights, used)
            linear = colors[:, :3] * np.asarray(material.get("factor", [1.0] * 4)[:3])
        else:
            linear = np.asarray(material.get("factor", _PLAIN)[:3], dtype=np.float64)
        source, uv, wrap = self._texture(material.get("texture"), primitive, placement, used)
        texture = self._image(source) if source is not None else -1
        faces = _triangles(indices.astype(np.int64), mode)
        self.transmitting += len(faces) * bool(material.get("transmits"))
        return MeshPart(
            vertices=placed_positions(self.data, primitive, placement, used),
            faces=faces,
            colors=np.clip(linear, 0.0, 1.0),
            uv=uv,
            texture=texture,
            wrap=wrap,
            linear=True,
            opacity=self._opacity(material, primitive, placement, used),
        )

    def _opacity(
        self, material: dict[str, Any], primitive: dict[str, Any], placement: Placement, used: Rows
    ) -> Opacity | None:
        """Return the opacity of the surface; None for opaque materials, whatever their alpha (glTF 2.0, 3.9.4)."""
        mode = material.get("mode")
        if mode not in ("MASK", "BLEND"):
            return None
        base = [float(value) for value in material["base"]]
        vertices = None
        if "COLOR_0" in primitive["attributes"]:
            colors = morphed(self.data, primitive, "COLOR_0", placement.weights, used)
            vertices = colors[:, 3] if colors.shape[1] == 4 else None
        source, uv, wrap = self._texture(material["base_texture"], primitive, placement, used)
        return Opacity(
            factor=base[3] if len(base) > 3 else 1.0,
            cutoff=float(material["cutoff"]) if mode == "MASK" else SOLID_FROM,
            vertices=vertices,
            picture=self._picture(source) if source is not None else None,
            uv=uv,
            wrap=wrap,
            blended=mode == "BLEND",
        )

    def _check_attributes(self, primitive: dict[str, Any], attributes: dict[str, int]) -> None:
        accessors = {name: self.data.entry("accessors", index) for name, index in attributes.items()}
        # Draco geometry is stored outside the accessors; if the extension is not required, they may hold a copy.
        compressed = [name for name in primitive.get("extensions", {}) if name in REFUSED]
        if compressed and "bufferView" not in accessors["POSITION"]:
            refuse(self.data.path, compressed)
        counts = {name: accessor["count"] for name, accessor in accessors.items()}
        if len(set(counts.values())) > 1:
            said = ", ".join(f"{name} {str(count)[:20]}" for name, count in list(counts.items())[:6])
            raise UnreadableMesh(f"the arrays of one of its meshes have different lengths ({said}); export it again")
        for name, accessor in accessors.items():
            kind, numbered, _ = name.partition("_")
            wanted = _NUMBERED_TYPES.get(kind) if numbered else _TYPES.get(name)
            if wanted and accessor["type"] not in wanted:
                raise UnreadableMesh(f"its {name} is {str(accessor['type'])[:20]} instead of {' or '.join(wanted)}")

    def _material(self, index: int | None) -> dict[str, Any]:
        """Return the properties of a material by name; {} without a material.

        "factor" (linear light) and "texture" are the visible colour; "base" and "base_texture" are the base colour with
        its alpha.
        """
        if index is None:
            return {}
        material = self.data.entry("materials", index)
        gloss = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
        if gloss is not None:
            factor, texture = gloss.get("diffuseFactor", [1.0] * 4), gloss.get("diffuseTexture")
        else:
            metallic = material.get("pbrMetallicRoughness", {})
            factor, texture = metallic.get("baseColorFactor", [1.0] * 4), metallic.get("baseColorTexture")
        base, base_texture = factor, texture
        # Baked scenes are often exported as a black surface with an emissive texture.
        if material.get("emissiveTexture") and max(factor[:3]) < 1e-3:
            factor, texture = material.get("emissiveFactor", [1.0] * 3), material["emissiveTexture"]
        given = material.get("extensions", {})
        return {
            "factor": factor,
            "texture": texture,
            "base": base,
            "base_texture": base_texture,
            "mode": material.get("alphaMode"),
            "cutoff": material.get("alphaCutoff", SOLID_FROM),
            "transmits": any(_transmission(given.get(name)) > 0 for name in TRANSMITTING),
        }

    def _texture(
        self, info: dict[str, Any] | None, primitive: dict[str, Any], placement: Placement, used: Rows
    ) -> tuple[int | None, np.ndarray | None, tuple[int, int]]:
        """Return the index of a texture's image in the file, coordinates [V, 2], and wrap modes across and down.

        ``info`` is the reference to the texture in the material. Index and coordinates are None without a texture.
        """
        nothing = None, None, (REPEAT, REPEAT)
        if info is None:
            return nothing
        transform = info.get("extensions", {}).get("KHR_texture_transform", {})
        uv_name = f"TEXCOORD_{transform.get('texCoord', info.get('texCoord', 0))}"
        if uv_name not in primitive["attributes"]:
            self.textures.without_uv.append(f"texture {info['index']}")
            return nothing
        uv = morphed(self.data, primitive, uv_name, placement.weights, used).astype(np.float64)
        if transform:
            angle = transform.get("rotation", 0.0)
            # Counter-clockwise in the image, whose v axis points down.
            rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            uv = (uv * transform.get("scale", [1.0, 1.0])) @ rotation.T + transform.get("offset", [0.0, 0.0])
        texture = self.data.entry("textures", info["index"])
        source = texture.get("extensions", {}).get("EXT_texture_webp", {}).get("source", texture.get("source"))
        if source is None:
            self.textures.note_unreadable(f"texture {info['index']}")
            return nothing
        sampler = self.data.entry("samplers", texture["sampler"]) if "sampler" in texture else {}
        across, down = (_WRAPS.get(sampler.get(key, 0), REPEAT) for key in ("wrapS", "wrapT"))
        return source, uv, (across, down)

    def _image(self, index: int) -> int:
        if index not in self._images:
            name, data, file = self._encoded(index)
            folder, textures = self.data.path.parent, self.textures
            self._images[index] = textures.add_file(folder, file) if data is None else textures.add_bytes(data, name)
        return self._images[index]

    def _picture(self, index: int) -> np.ndarray | None:
        if self._image(index) < 0:  # unreadable; a note was added
            return None
        name, data, file = self._encoded(index)
        if data is None:
            return self.textures.opacity_of_file(self.data.path.parent, file, "alpha")
        return self.textures.opacity_of(data, name, "alpha")

    def _encoded(self, index: int) -> tuple[str, bytes | None, str]:
        """Return the name of an image, its bytes if embedded in the file, else the file that it refers to."""
        image = self.data.entry("images", index)
        name = image.get("name") or image.get("uri", "")[:60] or f"image {index}"
        if "bufferView" in image:
            return name, self.data.view_bytes(image["bufferView"]), ""
        if image["uri"].startswith("data:"):
            return name, data_uri(image["uri"]), ""
        return name, None, image["uri"]


def _transmission(extension: Any) -> float:
    """Return the fraction of light that a glTF transmission extension lets through; 0 without the extension."""
    given: dict[str, Any] = extension if isinstance(extension, dict) else {}
    return float(given.get("transmissionFactor", given.get("diffuseTransmissionFactor", 0.0)))


def _triangles(indices: np.ndarray, mode: int) -> np.ndarray:  # [F, 3]; the winding is irrelevant here
    if mode == _TRIANGLES:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    if mode == _STRIP:
        return np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
    return np.stack([np.broadcast_to(indices[:1], len(indices[1:-1])), indices[1:-1], indices[2:]], axis=1)
