"""Classify a glTF file's extensions: supported, harmless, refused, or reported in a note."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.loaders.damage import UnreadableMesh

# Extensions that contain geometry or images, with a message and a remedy. If an extension is not required, the file
# holds a copy without it, which is read.
_WITHOUT_COMPRESSION = "export it without compression"
REFUSED = {
    "EXT_meshopt_compression": ("its geometry is compressed with meshopt", _WITHOUT_COMPRESSION),
    "KHR_meshopt_compression": ("its geometry is compressed with meshopt", _WITHOUT_COMPRESSION),
    "KHR_draco_mesh_compression": ("its geometry is compressed with Draco", _WITHOUT_COMPRESSION),
    "KHR_texture_basisu": ("its textures are KTX2 / Basis", "export them as PNG or JPEG"),
}
_READ = (
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_transform",
)
# Extensions of glass, which is treated as solid; a note gives the number of faces.
TRANSMITTING = ("KHR_materials_transmission", "KHR_materials_diffuse_transmission")
# Extensions that change neither position nor presence of surfaces. They are listed by full name, since a new extension
# of the same family may change them.
_HARMLESS = (
    *TRANSMITTING,
    *(
        f"KHR_materials_{name}"
        for name in (
            "anisotropy", "clearcoat", "dispersion", "emissive_strength", "ior", "iridescence", "sheen", "specular",
            "unlit", "variants", "volume", "volume_scatter",
        )
    ),
    "EXT_lights_ies",
    "EXT_lights_image_based",
    "KHR_lights_punctual",
    "KHR_animation_pointer",  # the scene is static
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MSFT_lod",  # the node itself is the finest level
)  # fmt: skip


def check_extensions(path: Path, header: dict[str, Any]) -> list[str]:
    """Return the names of used extensions that are neither supported nor harmless.

    Raises `InputError` if the file requires one of them.
    """
    refuse(path, [name for name in _names(header, "extensionsRequired") if name not in (*_READ, *_HARMLESS)])
    known = (*_READ, *_HARMLESS, *REFUSED)
    return [name for name in dict.fromkeys(_names(header, "extensionsUsed")) if name not in known]


def _names(header: dict[str, Any], key: str) -> list[str]:
    names = header.get(key, [])
    if not isinstance(names, list):
        raise UnreadableMesh(f"its {key} is not a list")
    return [str(name) for name in names]


def refuse(path: Path, extensions: list[str]) -> None:
    """Raise `InputError` with reasons and remedies if ``extensions`` is not empty; it lists unsupported ones."""
    if not extensions:
        return
    unknown = ("it needs the glTF extension {0}", "export it without {0}")
    faults = [[words.format(name) for words in REFUSED.get(name, unknown)] for name in extensions]
    reasons, remedies = (list(dict.fromkeys(words)) for words in zip(*faults))
    otherwise = "convert it with gltf-transform or Blender"
    if remedies == [_WITHOUT_COMPRESSION]:
        unpacked = path.with_name(f"{path.stem}_uncompressed{path.suffix}")
        otherwise = f"run: npx @gltf-transform/cli copy {shlex.quote(str(path))} {shlex.quote(str(unpacked))}"
    raise InputError(
        f"'{path}' cannot be read: {' and '.join(reasons)} ({', '.join(extensions)}); {' and '.join(remedies)}, or "
        f"{otherwise}"
    )
