"""Define the parts that every mesh reader returns, and join them into one `SceneMesh`.

Readers (`gltf`, `collada`, `trimesh_reader`) return `MeshPart`s in the file's units and axes; scaling, rotation and all
checks are done once, in `mesh_loader`.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from activestructure_gym.scenes.loaders.budget import LimitError, SceneBudget
from activestructure_gym.scenes.loaders.images import eight_bits, opened_image
from activestructure_gym.scenes.loaders.opacity import Opacity, opacity_picture
from activestructure_gym.scenes.loaders.references import PICTURE_FOLDERS, find_reference
from activestructure_gym.scenes.scene import REPEAT, SceneMesh

if TYPE_CHECKING:
    from PIL.Image import Image

# sRGB value, 0..1, of all three channels of a surface without a colour of its own.
PLAIN_GREY = 0.7


@dataclass(frozen=True)
class MeshPart:
    """Hold triangles that share one material."""

    vertices: np.ndarray  # [V, 3] float64, file units, node transforms applied
    faces: np.ndarray  # [F, 3] integers
    colors: np.ndarray  # [V, 3] or [3] in 0..1: vertex colour times material colour
    uv: np.ndarray | None = None  # [V, 2], v down from the image's top row
    texture: int = -1  # index in the `TextureStore`, -1 = none
    wrap: tuple[int, int] = (REPEAT, REPEAT)  # wrap modes of the texture, across and down
    linear: bool = False  # True: colours are linear light; False: display-referred
    opacity: Opacity | None = None  # None = solid; `cut_out` removes transparent parts


@dataclass
class TextureStore:
    """Store the textures of one scene; an image that occurs several times or under several names is stored once."""

    max_size: int = 512  # pixels; larger images are shrunk, so that 50 textures stay below 50 MB
    budget: SceneBudget = field(default_factory=SceneBudget)  # budget of the whole scene, shared with its readers
    images: list[np.ndarray] = field(default_factory=list)  # [h, w, 3] uint8
    unreadable: list[str] = field(default_factory=list)  # names of images that could not be read
    searched: Path | None = None  # the mesh's folder, if an image was not found in or around it
    # Materials with an image that are used on a surface without texture coordinates.
    without_uv: list[str] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)  # unsupported placement settings of images
    notes: list[str] = field(default_factory=list)  # readers' messages on deviations from the file
    _by_key: dict[Hashable, int] = field(default_factory=dict)
    _opacities: dict[Hashable, np.ndarray | None] = field(default_factory=dict)

    def add_bytes(self, data: bytes, name: str) -> int:
        """Store an encoded image (PNG, JPEG, WebP, ...) and return its index, -1 if it cannot be decoded."""
        try:
            self.budget.take("bytes of pictures", len(data))
        except LimitError as error:
            return self._missing(("bytes", name), f"{name}: {error}")
        return self.add(hashlib.sha256(data).digest(), lambda: opened_image(data), name)

    def add_file(self, base: Path, reference: str) -> int:
        """Store the image ``reference`` of a file in the folder ``base`` and return its index, -1 if it is missing."""
        key = ("file", base, reference)
        if key not in self._by_key:
            try:
                file = find_reference(base, reference, folders=PICTURE_FOLDERS)
                self._by_key[key] = self.add_bytes(self.budget.read(file), reference)
            except LimitError as error:
                return self._missing(key, f"{reference}: {error}")
            except OSError:
                self.searched = base
                return self._missing(key, reference)
        return self._by_key[key]

    def add(self, key: Hashable, decode: Callable[[], Image], name: str) -> int:
        """Store the image that ``decode`` returns and return its index, -1 if it fails.

        ``decode`` is called once for each ``key``; ``name`` is used in messages.
        """
        if key in self._by_key:
            return self._by_key[key]
        try:
            image = decode()
            shrink = min(1.0, self.max_size / max(image.size))
            self.budget.take("pixels", image.width * image.height)
            self.budget.take("pixels after shrinking", int(image.width * image.height * shrink**2))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # Pillow's warnings on palettes and metadata; real faults raise
                pixels = _shrunk_pixels(image, self.max_size)
        except LimitError as error:
            return self._missing(key, f"{name}: {error}")
        except Exception:  # Pillow raises any error of the codec
            return self._missing(key, name)
        # The same image is often stored under several keys: keep one copy per pixel content.
        content = ("pixels", pixels.shape, hashlib.sha256(pixels.tobytes()).digest())
        if content not in self._by_key:
            self._by_key[content] = len(self.images)
            self.images.append(pixels)
        self._by_key[key] = self._by_key[content]
        return self._by_key[key]

    def opacity_of(self, data: bytes, name: str, channel: str) -> np.ndarray | None:  # [h, w] uint8
        """Return the opacity of an encoded image (see `opacity_picture`), None if it has none or is unreadable."""
        key = (hashlib.sha256(data).digest(), channel)
        if key not in self._opacities:
            self._opacities[key] = None
            try:
                image = opened_image(data)
                self.budget.take("pixels", image.width * image.height)
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    self._opacities[key] = opacity_picture(image, channel)
            except Exception as error:  # Pillow raises any error of the codec
                self.note_unreadable(f"{name}: {error}" if isinstance(error, LimitError) else name)
        return self._opacities[key]

    def opacity_of_file(self, base: Path, reference: str, channel: str) -> np.ndarray | None:  # [h, w] uint8
        """Return the opacity of the image ``reference`` of a file in the folder ``base``, None if there is none."""
        key = ("file", base, reference, channel)
        if key not in self._opacities:
            self._opacities[key] = None
            try:
                data = self.budget.read(find_reference(base, reference, folders=PICTURE_FOLDERS))
                self._opacities[key] = self.opacity_of(data, reference, channel)
            except LimitError as error:
                self.note_unreadable(f"{reference}: {error}")
            except OSError:
                self.searched = base
                self.note_unreadable(reference)
        return self._opacities[key]

    def _missing(self, key: Hashable, name: str) -> int:
        if key not in self._by_key:
            self._by_key[key] = -1
            self.note_unreadable(name)
        return -1

    def note_unreadable(self, name: str) -> None:
        """Record the name of an unreadable file as one short line."""
        self.unreadable.append(" ".join(str(name).split())[:200])


def _shrunk_pixels(image: Image, max_size: int) -> np.ndarray:  # [h, w, 3] uint8
    from PIL import Image as images

    image = eight_bits(image)
    if max(image.size) > max_size:
        scale = max_size / max(image.size)
        size = (max(1, round(image.width * scale)), max(1, round(image.height * scale)))
        image = (image if image.mode == "RGB" else image.convert("RGB")).resize(size, images.Resampling.BOX)
    return np.ascontiguousarray(image.convert("RGB"), dtype=np.uint8)


def placed(vertices: np.ndarray, world_from_part: np.ndarray) -> np.ndarray:  # [V, 3], [4, 4] -> [V, 3]
    """Transform vertices by the matrix of their node; non-finite values remain, and the loader reports them."""
    with np.errstate(invalid="ignore", over="ignore"):
        return vertices @ world_from_part[:3, :3].T + world_from_part[:3, 3]


def full_scale(colors: Sequence[np.ndarray]) -> float:
    """Return the value that represents 1 in a file's colours: 255 or 65535 for integers, 1 or 255 for floats."""
    if all(one.dtype == np.uint8 for one in colors):
        return 255.0
    seen = np.concatenate([one[np.isfinite(one) & (one > 0)] for one in colors])
    highest = seen.max(initial=0)
    if all(one.dtype.kind in "iu" for one in colors):
        return 65535.0 if highest > 255 else 255.0
    # Rounding, and sometimes baked light, exceeds 1.
    return 255.0 if highest > 1.5 and np.median(seen) > 1.0 else 1.0


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    """Convert linear to display-referred values (IEC 61966-2-1), clipped to [0, 1]; glTF factors are linear."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1.0 / 2.4) - 0.055)


def linear_from_srgb(srgb: np.ndarray) -> np.ndarray:
    """Convert display-referred (sRGB) values in 0..1 to linear light; the inverse of `srgb_from_linear`."""
    srgb = np.clip(srgb, 0.0, 1.0)
    return np.where(srgb <= 0.04045, srgb / 12.92, np.power((srgb + 0.055) / 1.055, 2.4))


def assemble(parts: Sequence[MeshPart], textures: Sequence[np.ndarray]) -> SceneMesh:
    """Join all parts into one mesh, in order; ``textures`` are the images that the parts refer to by index.

    The mesh has linear colours only if the vertex colours of a part in linear light vary.
    """
    linear = any(part.linear and _varies(part.colors) for part in parts)
    wrapped = _WrappedTextures(list(textures))
    vertices, faces, colors, uv, face_texture = [], [], [], [], []
    offset = 0
    for part in parts:
        count = len(part.vertices)
        vertices.append(np.asarray(part.vertices, dtype=np.float32))
        faces.append(np.asarray(part.faces, dtype=np.int32) + np.int32(offset))
        colors.append(np.broadcast_to(np.asarray(_colors(part, linear), dtype=np.float32), (count, 3)))
        textured = part.texture >= 0 and part.uv is not None
        uv.append(np.asarray(part.uv, np.float32) if textured else np.zeros((count, 2), np.float32))
        texture = wrapped.index(part.texture, part.wrap) if textured else -1
        face_texture.append(np.full(len(part.faces), texture, np.int32))
        offset += count
    return SceneMesh(
        vertices=np.concatenate(vertices),
        faces=np.concatenate(faces),
        colors=np.concatenate(colors),
        uv=np.concatenate(uv),
        face_texture=np.concatenate(face_texture),
        textures=tuple(wrapped.images),
        texture_wrap=wrapped.wraps,
        linear_colors=linear,
    )


def _varies(colors: np.ndarray) -> bool:
    return colors.ndim == 2 and bool((colors != colors[:1]).any())


def _colors(part: MeshPart, linear: bool) -> np.ndarray:
    if part.linear == linear:
        return part.colors
    return linear_from_srgb(part.colors) if linear else srgb_from_linear(part.colors)


@dataclass
class _WrappedTextures:
    """List the images of a mesh with one wrap mode each; an image that is used with two modes is listed twice."""

    images: list[np.ndarray]
    _places: dict[tuple[int, tuple[int, int]], int] = field(default_factory=dict)

    def index(self, image: int, wrap: tuple[int, int]) -> int:
        """Return the index in the list for image number ``image`` with this wrap mode; add an entry if needed."""
        if (image, wrap) not in self._places:
            place = image
            if any(image == known for known, _ in self._places):
                place = len(self.images)
                self.images.append(self.images[image])
            self._places[image, wrap] = place
        return self._places[image, wrap]

    @property
    def wraps(self) -> tuple[tuple[int, int], ...]:
        """Return the wrap mode of each image; () if all repeat."""
        wraps = [(REPEAT, REPEAT)] * len(self.images)
        for (_, wrap), place in self._places.items():
            wraps[place] = wrap
        return tuple(wraps) if any(map(any, wraps)) else ()
