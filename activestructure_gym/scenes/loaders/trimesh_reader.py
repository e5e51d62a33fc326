"""Read Wavefront OBJ and PLY with trimesh's parsers.

trimesh's scene objects are avoided, since they take a minute for 20,000 materials.
"""

from __future__ import annotations

import io
import logging
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np

from activestructure_gym.ply_header import MAGIC
from activestructure_gym.scenes.loaders.budget import LimitError
from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.images import opened_image
from activestructure_gym.scenes.loaders.mesh_parts import (
    PLAIN_GREY,
    MeshPart,
    TextureStore,
    full_scale,
)
from activestructure_gym.scenes.loaders.mtl_text import OPACITY_CHANNELS, dissolve, texture_map
from activestructure_gym.scenes.loaders.obj_text import plain_obj
from activestructure_gym.scenes.loaders.opacity import Opacity
from activestructure_gym.scenes.loaders.plain_ply import plain_ply
from activestructure_gym.scenes.loaders.polygons import concave_corners, triangulated
from activestructure_gym.scenes.loaders.references import find_reference
from activestructure_gym.scenes.scene import REPEAT

_COLORS = ("vertex_colors", "face_colors")


def read_with_trimesh(path: Path, textures: TextureStore) -> list[MeshPart]:
    """Return the parts of an OBJ or PLY file: all triangles, with polygons split, and their colours and textures."""
    import trimesh
    from trimesh.exchange import obj, ply

    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # relevant messages are given by the loader
    data = textures.budget.read(path)
    with np.errstate(invalid="ignore"):  # non-finite values are reported by the loader
        if path.suffix.lower() == ".obj":
            text, libraries = _with_one_library(_obj_text(data))
            _check_materials(text)
            resolver = _resolver(path, textures, libraries)
            loaded = obj.load_obj(io.StringIO(text), resolver=resolver)
            _note_unknown_materials(text, resolver.materials, textures)
        else:
            data, pictures = plain_ply(data)
            _check_ply(data, textures)
            textures.ignored += [f"TextureFile {name}" for name in pictures[1:]]
            try:
                loaded = ply.load_ply(io.BytesIO(data), resolver=_resolver(path, textures))
            except ValueError as error:
                if "unexpected length" not in str(error):
                    raise
                raise UnreadableMesh(
                    "it is cut off, or its faces differ in their number of corners: triangulate it or export it as "
                    "ASCII PLY"
                ) from error
        # Points and lines have no faces.
        meshes = [given for given in loaded.get("geometry", {"": loaded}).values() if given.get("faces") is not None]
        alphas = [_alpha(given) if path.suffix.lower() == ".ply" else None for given in meshes]
        unpainted = _in_range(meshes)
        geometries = [trimesh.Trimesh(**given, process=False) for given in meshes]
    return [
        _part(path, geometry, textures, broken, alpha)
        for geometry, broken, alpha in zip(geometries, unpainted, alphas)
        if len(geometry.faces)
    ]


def _alpha(mesh: dict[str, Any]) -> np.ndarray | None:  # [N] in 0..1
    """Return the alpha of a PLY file's vertex or face colours, before trimesh changes them; None without one."""
    colors = next((np.asarray(mesh[kind]) for kind in _COLORS if kind in mesh and np.ndim(mesh[kind]) == 2), None)
    if colors is None or colors.shape[1] < 4:
        return None
    alpha = colors[:, 3]
    # Float colours and alpha may have different scales; integers share one.
    alpha = alpha / full_scale([alpha] if alpha.dtype.kind == "f" else [colors])
    return alpha if (alpha < 1.0).any() else None


def _in_range(meshes: list[dict[str, Any]]) -> list[np.ndarray]:  # of each [N] bool
    """Scale the colours of ``meshes`` in place to the range that trimesh expects.

    trimesh expects floats in 0 to 1 and integers in 0 to 255; files also have floats up to 255 and 16-bit integers.
    Returns, for each mesh, which of its N coloured vertices or faces have a colour that is not finite.
    """
    kinds = [next((kind for kind in _COLORS if kind in mesh and np.ndim(mesh[kind]) == 2), "") for mesh in meshes]
    colors = [
        np.asarray(mesh[kind])[:, :3] if kind else np.zeros((0, 3), np.uint8) for mesh, kind in zip(meshes, kinds)
    ]
    broken = [np.logical_not(np.isfinite(one).all(axis=1)) for one in colors]
    scale = full_scale(colors)
    for mesh, kind, one in zip(meshes, kinds, colors):
        if kind and scale != (1.0 if one.dtype.kind == "f" else 255.0):
            mesh[kind] = one / scale
    return broken


def _decoded(data: bytes) -> str:
    """Return ``data`` decoded as UTF-8, as UTF-16 if it has a byte order mark, or as Latin-1 of older exporters."""
    try:
        return data.decode("utf-16" if data[:2] in (BOM_UTF16_LE, BOM_UTF16_BE) else "utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _obj_text(data: bytes) -> str:
    text = _decoded(data)
    if "\0" in text:
        raise UnreadableMesh("it is not OBJ text, but binary or UTF-16 without a byte-order mark: save it as UTF-8")
    return plain_obj(text)


_LIBRARY = re.compile(r"^mtllib +(.*)\n?", re.MULTILINE)
_BETWEEN_LIBRARIES = re.compile(r"(?<=\.mtl) +", re.IGNORECASE)
_ALL_LIBRARIES = "all libraries.mtl"


def _with_one_library(text: str) -> tuple[str, list[str]]:
    """Return the text of an OBJ file with at most one material library, and the names of the libraries in the file.

    trimesh reads only one library. Several are replaced by the name `_ALL_LIBRARIES`, which `_resolver` resolves.
    """
    lines = (line.strip() for line in _LIBRARY.findall(text))
    names = list(dict.fromkeys(name for line in lines for name in _BETWEEN_LIBRARIES.split(line)))
    if len(names) < 2:
        return text, names
    return f"mtllib {_ALL_LIBRARIES}\n{_LIBRARY.sub('', text)}", names


def _note_unknown_materials(text: str, known: set[str], textures: TextureStore) -> None:
    """Record the materials used in an OBJ ``text`` that are in no library; ``known`` are the names in libraries.

    A missing library is reported elsewhere.
    """
    used = dict.fromkeys(name.strip() for name in re.findall(r"^usemtl (.*)", text, re.MULTILINE))
    for name in used if known else ():
        if name not in known and name not in _NO_MATERIAL:
            textures.note_unreadable(f"material {name}")


_NO_MATERIAL = ("", "None", "(null)")  # written by exporters for no material


# Maximum of materials times vertices. trimesh loops over all vertices for every material, 2 ns each.
_MAX_PASSES = 5_000_000_000
_LINE_ENDS = (b"\n", b"\r", b"\v", b"\f", b"\x1c", b"\x1d", b"\x1e")


def _check_materials(text: str) -> None:
    materials, vertices = len(set(re.findall(r"^usemtl.*", text, re.MULTILINE))), text.count("\nv ")
    if materials * vertices > _MAX_PASSES:
        raise UnreadableMesh(
            f"it has {materials:,} materials over {vertices:,} vertices, which takes minutes; join its materials"
        )


def _check_ply(data: bytes, textures: TextureStore) -> None:
    if not data.startswith(MAGIC):
        raise UnreadableMesh("it does not begin with the letters 'ply'")
    if b"ascii" in data[:1000].lower():  # every line becomes an array
        textures.budget.take("numbers in arrays", 16 * sum(data.count(end) for end in _LINE_ENDS))


# Texture statements are replaced by a word that trimesh does not understand. It would decode an image once for every
# material that uses it.
_MAP = re.compile(r"^[ \t]*map_(kd|d)[ \t]+(.*?)[ \t]*$", re.MULTILINE | re.IGNORECASE)
_TEXTURE, _OPACITY = "statement_of_kd", "statement_of_d"
_MATERIAL = re.compile(r"^[ \t]*newmtl[ \t]+(.*)", re.MULTILINE | re.IGNORECASE)


def _resolver(path: Path, textures: TextureStore, libraries: Sequence[str] = ()) -> Any:
    """Return a resolver that finds referenced files with `find_reference`; trimesh's own ignores missing files."""
    from trimesh.resolvers import FilePathResolver

    class NearbyResolver(FilePathResolver):
        materials: set[str] = set()  # names in the libraries read so far

        def get(self, name: str) -> bytes:
            if name != _ALL_LIBRARIES or len(libraries) < 2:
                return self._file(name)
            texts = []
            for library in libraries:
                with suppress(Exception):  # noted; other libraries may exist
                    texts.append(self._file(library))
            return b"\n".join(texts)

        def _file(self, name: str) -> bytes:
            try:
                data = textures.budget.read(find_reference(path.parent, name))
                if name.lower().endswith(".mtl"):
                    text = _decoded(data).replace("\r\n", "\n").replace("\r", "\n")
                    self.materials = self.materials | {" ".join(name.split()) for name in _MATERIAL.findall(text)}
                    return _MAP.sub(lambda found: f"statement_of_{found[1].lower()} {quote(found[2])}", text).encode()
                opened_image(data)  # trimesh would open any kind of image
                return data
            except LimitError as error:
                textures.note_unreadable(f"{name}: {error}")
                raise
            except Exception:  # missing, or not an image: Pillow raises any error of the codec
                textures.note_unreadable(name)
                raise

    return NearbyResolver(str(path))


def _part(path: Path, geometry: Any, textures: TextureStore, broken: np.ndarray, alpha: np.ndarray | None) -> MeshPart:
    """Convert a geometry of trimesh to a part.

    ``broken`` [N] is True for coloured vertices or faces whose colour is not finite; ``alpha`` [N] is their opacity.
    """
    vertices = np.asarray(geometry.vertices, dtype=np.float64)
    faces, polygon = _triangles(geometry)
    visual = geometry.visual
    colors: np.ndarray = np.full(3, PLAIN_GREY)
    uv, texture, wrap = None, -1, (REPEAT, REPEAT)
    opacity = None
    if visual.kind == "vertex":
        colors = _srgb(visual.vertex_colors, broken)
    elif visual.kind == "face":
        # A vertex has one colour, so every face gets its own three vertices.
        colors = np.repeat(_srgb(visual.face_colors, broken)[polygon], 3, axis=0)
        vertices, faces = vertices[faces.reshape(-1)], np.arange(3 * len(faces)).reshape(-1, 3)
        alpha = None if alpha is None else np.repeat(alpha[polygon], 3)
    elif visual.kind == "texture":
        material = visual.material
        name = str(getattr(material, "name", "texture"))
        statement = (getattr(material, "kwargs", None) or {}).get(_TEXTURE)
        image = getattr(material, "image", None)  # only materials of a PLY file have one
        lies = texture_map(unquote(statement[0]) if statement else "")
        fits = visual.uv is not None and len(visual.uv) == len(vertices)
        if not fits and (statement or image is not None):
            textures.without_uv.append(name)
        elif statement:
            texture, wrap = textures.add_file(path.parent, lies.reference), lies.wrap
            textures.ignored += [f"{option} of {lies.reference}" for option in lies.ignored]
        elif image is not None:
            texture = textures.add(id(image), lambda: image, name)
        if texture >= 0:
            uv = _downward(lies.placed(np.asarray(visual.uv, dtype=np.float64)))
            # The colour Kd is not used with a texture, since exporters leave it at 0, 0.8 or 1.
            colors = np.ones(3)
        elif getattr(material, "diffuse", None) is not None and getattr(material, "name", None) is not None:
            colors = _srgb(np.asarray(material.diffuse))
        opacity = _opacity_of_material(path, material, textures, visual.uv if fits else None)
    if alpha is not None and len(alpha) == len(vertices):
        opacity = Opacity(vertices=alpha)
    return MeshPart(
        vertices=vertices,
        faces=faces,
        colors=colors,
        uv=uv,
        texture=texture,
        wrap=wrap,
        opacity=opacity,
    )


def _opacity_of_material(path: Path, material: Any, textures: TextureStore, uv: np.ndarray | None) -> Opacity | None:
    """Return the opacity from an MTL file: `d`, or else 1 - `Tr`, times the image of `map_d`.

    The alpha of `map_Kd` is ignored.
    """
    given = getattr(material, "kwargs", None) or {}
    factor = dissolve(given.get("d"), given.get("tr"))
    lies = texture_map(unquote(given[_OPACITY][0]) if given.get(_OPACITY) else "")
    picture = None
    if lies.reference and uv is None:
        textures.without_uv.append(str(getattr(material, "name", "texture")))
    elif lies.reference:
        picture = textures.opacity_of_file(path.parent, lies.reference, OPACITY_CHANNELS.get(lies.channel, "either"))
        textures.ignored += [f"{option} of {lies.reference}" for option in lies.ignored]
    if picture is None:
        return Opacity(factor) if factor < 1.0 else None
    return Opacity(factor, picture=picture, uv=_downward(lies.placed(np.asarray(uv, np.float64))), wrap=lies.wrap)


def _downward(uv: np.ndarray) -> np.ndarray:  # [V, 2]
    return uv * [1.0, -1.0] + [0.0, 1.0]


def _triangles(geometry: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles [F, 3] of a geometry, and for each the index of its face in the file.

    Concave polygons of a PLY file are split by ear clipping, since trimesh splits them into fans.
    """
    faces = np.asarray(geometry.faces)
    sizes = _polygon_sizes(geometry.metadata.get("_ply_raw"))
    if not (sizes > 3).any() or (sizes - 2).sum() != len(faces) or faces.max() >= len(geometry.vertices):
        return faces, np.arange(len(faces))
    # trimesh returns triangles first, then the first and second halves (c, d, a) of quads, then all other fans.
    polygons = np.concatenate([np.flatnonzero(chosen) for chosen in (sizes == 3, sizes == 4, sizes > 4)])
    triangles, quads, sizes = (sizes == 3).sum(), (sizes == 4).sum(), sizes[polygons]
    halves = np.split(faces[triangles : triangles + 2 * quads], 2)
    in_order = faces.copy()
    in_order[triangles : triangles + 2 * quads : 2] = halves[0]
    in_order[triangles + 1 : triangles + 2 * quads : 2] = np.roll(halves[1], 1, axis=1)
    # The first triangle of a fan has three corners of its polygon; each following triangle adds its last corner.
    own = np.tile([False, False, True], (len(faces), 1))
    own[np.cumsum(sizes - 2) - (sizes - 2)] = True
    around = in_order[own]
    corners = np.asarray(geometry.vertices, dtype=np.float64)[around]
    if geometry.visual.kind != "face" and not len(concave_corners(corners, sizes)[0]):
        return faces, np.arange(len(faces))
    split, polygon = triangulated(corners, sizes)
    return around[split], polygons[polygon]


def _polygon_sizes(elements: Any) -> np.ndarray:  # [P] corners of each face of a PLY file, empty for other files
    data = (elements or {}).get("face", {}).get("data", {})
    names = data if isinstance(data, dict) else data.dtype.names or ()
    for name in ("vertex_index", "vertex_indices"):
        if name in names:
            lists = data[name] if isinstance(data, dict) else data[name]["f1"]
            return np.array([len(face) for face in lists]) if lists.ndim == 1 else np.full(len(lists), lists.shape[1])
    return np.zeros(0, np.int64)


def _srgb(rgba: np.ndarray, broken: np.ndarray | bool = False) -> np.ndarray:  # uint8 [..., 4] -> float [..., 3]
    colors = np.asarray(rgba, dtype=np.float64)[..., :3] / 255.0
    return np.where(np.asarray(broken)[..., None], np.nan, colors) if np.any(broken) else colors
