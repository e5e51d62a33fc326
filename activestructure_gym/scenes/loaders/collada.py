"""Read COLLADA (`.dae`) with the standard library's XML parser.

pycollada, which trimesh needs for it, supports less of what exporters write, and rounds (docs/notebook/lab_notes.md).
Supported is what a still scene needs: triangles and polygons, node transforms, instances, skins and morphs in their
stored pose, diffuse colours and textures, unit and up axis. Specification: [collada].
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from activestructure_gym.scenes.loaders.budget import LimitError
from activestructure_gym.scenes.loaders.collada_controllers import Controlled, controlled
from activestructure_gym.scenes.loaders.collada_nodes import node_matrix
from activestructure_gym.scenes.loaders.collada_numbers import attribute, fixed, floats
from activestructure_gym.scenes.loaders.collada_opacity import ColladaOpacity, opacity_of
from activestructure_gym.scenes.loaders.collada_polygons import Input, corners_and_triangles
from activestructure_gym.scenes.loaders.collada_textures import (
    ColladaTexture,
    chosen_set,
    leaves_picture,
    texture_of,
)
from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.mesh_parts import PLAIN_GREY, MeshPart, TextureStore, placed
from activestructure_gym.scenes.loaders.opacity import Opacity

Element = ElementTree.Element
_POLYGONS = ("triangles", "polylist", "polygons", "tristrips", "trifans")


@dataclass(frozen=True)
class ColladaFile:
    """Hold the parts of a COLLADA file in its own units, with the declared unit and up axis."""

    parts: list[MeshPart]
    metres_per_unit: float
    up: str  # "x", "y" or "z", or any other declared value


def read_collada(path: Path, textures: TextureStore) -> ColladaFile:
    """Read all triangles of the visual scene that a file shows; store its images in ``textures``.

    Raises `UnreadableMesh` for a damaged file.
    """
    root = ElementTree.fromstring(textures.budget.read(path))
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]  # the namespace differs between versions 1.4 and 1.5
    if root.tag != "COLLADA":
        raise UnreadableMesh(f"its root element is <{root.tag}>, not <COLLADA>")
    unit = root.find("asset/unit")
    up = (root.findtext("asset/up_axis") or "Y_UP").strip()
    document = _Document(path, root, textures)
    return ColladaFile(
        parts=list(document.parts()),
        metres_per_unit=_metres(unit),
        up=up[:1].lower(),
    )


def _metres(unit: Element | None) -> float:
    metres = float(fixed(unit.get("meter", "1"), 1, "meter")[0]) if unit is not None else 1.0
    if not (np.isfinite(metres) and metres > 0):
        raise UnreadableMesh(f"it says that its unit has {metres:g} metres")
    return metres


@dataclass
class _Document:
    path: Path
    root: Element
    textures: TextureStore
    by_id: dict[str, Element] = field(default_factory=dict)
    # Results of `_once` by function and element, since many instances can share long arrays.
    _made: dict[tuple[str, Any], Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.by_id = {element.get("id", ""): element for element in self.root.iter() if element.get("id")}

    def target(self, url: str | None) -> Element | None:
        return self.by_id.get((url or "").removeprefix("#"))

    def _once(self, make: Callable[..., Any], of: Element | str, *more: Any) -> Any:
        """Return ``make(of, *more)``, computed once for each element ``of``, whatever ``more`` is."""
        key = (make.__name__, of)
        if key not in self._made:
            self._made[key] = make(of, *more)
        return self._made[key]

    def parts(self) -> Iterator[MeshPart]:
        shown = self.root.find("scene/instance_visual_scene")
        scene = self.target(shown.get("url")) if shown is not None else None
        if scene is None:
            scene = self.root.find("library_visual_scenes/visual_scene")
        if scene is None:  # geometry without a scene: everything at the origin
            for geometry in self.root.iterfind("library_geometries/geometry"):
                yield from self._geometry(geometry, np.eye(4), {})
            return
        for node, world_from_node in self._placed_nodes(scene):
            for instance in node:
                shape = None
                if instance.tag in ("instance_geometry", "instance_controller"):
                    shape = controlled(instance.get("url"), self.target)
                if shape is None:
                    continue
                pose = partial(self._posed, scene, shape, instance) if shape.controls else None
                yield from self._geometry(shape.geometry, world_from_node, self._once(_bindings, instance), pose)

    def _posed(
        self, scene: Element, shape: Controlled, instance: Element, positions: np.ndarray, world_from_node: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return positions [N, 3] in the pose of their skin or morph, and the transform that still has to be applied.

        A skin already gives world positions, so its transform is the identity.
        """
        self.textures.budget.take("numbers in arrays", 40 * len(positions))
        try:
            worlds = self._once(self._worlds, scene) if shape.skin is not None else {}
            moved = shape.positions(positions[:, :3], self.target, worlds, instance)
        except LimitError:
            raise
        except UnreadableMesh as error:
            self.textures.notes.append(f"a skin or morph is shown without its pose: {error}")
            return positions, world_from_node
        return moved, np.eye(4) if shape.skin is not None else world_from_node

    def _worlds(self, scene: Element) -> dict[Element, np.ndarray]:
        """Return the matrix [4, 4] world_from_node of every node, for the joints of skins.

        A node that is placed several times has the matrix of its first placement.
        """
        worlds: dict[Element, np.ndarray] = {}
        for node, world_from_node in self._placed_nodes(scene):
            worlds.setdefault(node, world_from_node)
        return worlds

    def _placed_nodes(self, scene: Element) -> Iterator[tuple[Element, np.ndarray]]:
        stack = [(node, np.eye(4), 0) for node in reversed(scene.findall("node"))]
        while stack:
            node, world_from_parent, depth = stack.pop()
            if depth > 200:
                raise UnreadableMesh("its nodes form a loop")
            self.textures.budget.take("nodes", 1 + len(node))
            world_from_node = world_from_parent @ self._once(node_matrix, node)
            yield node, world_from_node
            placed_elsewhere = (self.target(element.get("url")) for element in node.findall("instance_node"))
            children = [*(child for child in placed_elsewhere if child is not None), *node.findall("node")]
            self.textures.budget.take("nodes", len(children))
            stack.extend((child, world_from_node, depth + 1) for child in reversed(children))

    def _geometry(
        self,
        geometry: Element,
        world_from_node: np.ndarray,
        bindings: dict[str, _Binding],
        pose: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None,
    ) -> Iterator[MeshPart]:
        mesh = geometry.find("mesh")
        if mesh is None:  # splines and convex hulls
            return
        self.textures.budget.take("nodes", len(mesh))
        posed: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        for primitives in mesh:
            if primitives.tag not in _POLYGONS:
                continue
            inputs, sets, width = self._once(self._inputs, primitives)
            corners, triangles = self._once(corners_and_triangles, primitives, width, inputs["VERTEX"])
            self.textures.budget.take("meshes and copies of them", 1)
            if not len(triangles):
                continue
            self.textures.budget.take("triangles", len(triangles))
            self.textures.budget.take("vertices", len(corners))
            vertex, world = inputs["VERTEX"], world_from_node
            if pose is not None:
                if id(vertex.values) not in posed:  # primitives share positions
                    posed[id(vertex.values)] = pose(vertex.values, world)
                values, world = posed[id(vertex.values)]
                vertex = replace(vertex, values=values)
            symbol = primitives.get("material", "")
            bound = bindings.get(symbol, _Binding(symbol))
            color, texture, lies = self._once(self._material, bound.material)
            uv = self._coordinates(sets, corners, lies, bound.sets) if sets else None
            if texture >= 0 and uv is None:
                self.textures.without_uv.append(symbol or "without a name")
                texture = -1
            # A texture replaces vertex colours, which exporters often write as black.
            painted = "COLOR" in inputs and texture < 0
            if color is None:
                color = np.full(3, 1.0 if painted else PLAIN_GREY)
            if painted:
                color = color * inputs["COLOR"].of(corners, 3)
            yield MeshPart(
                vertices=placed(vertex.of(corners, 3), world),
                faces=triangles,
                colors=color,
                uv=uv,
                texture=texture,
                wrap=lies.wrap,
                opacity=self._opacity(bound, sets, corners),
            )

    def _opacity(self, bound: _Binding, sets: dict[int, Input], corners: np.ndarray) -> Opacity | None:
        """Return the opacity of a part with ``corners`` and the material ``bound``; None if it is not defined."""
        said, picture = self._once(self._transparency, bound.material)
        if said is None:
            return None
        if picture is None:
            return Opacity(said.plain)
        if not sets:  # the image cannot be placed
            return None
        uv = self._coordinates(sets, corners, said.lies, bound.sets)
        return Opacity(picture=picture, uv=uv, wrap=said.lies.wrap)

    def _transparency(self, name: str) -> tuple[ColladaOpacity | None, np.ndarray | None]:
        """Return a material's opacity, and its opacity image."""
        shader, parameters = self._shader(name)
        said = opacity_of(shader, parameters) if shader is not None else None
        if said is None or said.lies is None:
            return said, None
        reference = self._reference(said.lies.image)
        picture = None
        if reference is not None:
            picture = self.textures.opacity_of_file(self.path.parent, reference, said.channel)
        if picture is None and (said.channel, said.start) != ("alpha", 0.0):  # unreadable; a note was added
            return None, None
        return said, said.of(picture) if picture is not None else None

    def _coordinates(
        self, sets: dict[int, Input], corners: np.ndarray, lies: ColladaTexture, bound: dict[str, int]
    ) -> np.ndarray:  # [C, 2], v down
        """Return the texture coordinates of the C corners for the texture ``lies``, transformed by its placement."""
        chosen, certain = chosen_set(sets, lies.texcoord, bound)
        if not certain:
            self._ignore(f"UV set {lies.texcoord}", lies)
        uv = lies.placed(sets[chosen].of(corners, 2))
        if lies.bounded and leaves_picture(uv):
            self._ignore(", ".join(lies.bounded), lies)
        return uv * [1.0, -1.0] + [0.0, 1.0]

    def _ignore(self, setting: str, lies: ColladaTexture) -> None:
        self.textures.ignored.append(f"{setting[:60]} of {lies.image[:60]}")

    def _inputs(self, primitives: Element) -> tuple[dict[str, Input], dict[int, Input], int]:
        """Return the inputs of a <triangles> or similar element.

        They are the first set of each semantic, all sets of texture coordinates, and the number of columns of <p>.
        """
        inputs: dict[str, Input] = {}
        sets: dict[int, Input] = {}
        width = 0
        for element in sorted(primitives.findall("input"), key=lambda element: attribute(element, "set")):
            semantic, offset = element.get("semantic", ""), attribute(element, "offset")
            width = max(width, offset + 1)
            if semantic == "VERTEX":
                vertices = self.target(element.get("source"))
                for shared in vertices.findall("input") if vertices is not None else ():
                    shared_semantic = "VERTEX" if shared.get("semantic") == "POSITION" else shared.get("semantic", "")
                    values = Input(shared_semantic, offset, self._source(shared))
                    inputs.setdefault(shared_semantic, values)
                    if shared_semantic == "TEXCOORD":
                        sets.setdefault(attribute(shared, "set"), values)
            elif semantic == "TEXCOORD":
                sets.setdefault(attribute(element, "set"), Input(semantic, offset, self._source(element)))
            elif semantic == "COLOR":
                inputs.setdefault(semantic, Input(semantic, offset, self._source(element)))
        if "VERTEX" not in inputs:
            raise UnreadableMesh(f"a <{primitives.tag}> has no vertex positions")
        return inputs, sets, width

    def _source(self, element: Element) -> np.ndarray:  # [count, stride]
        source = self.target(element.get("source"))
        if source is None or source.find("float_array") is None:
            raise UnreadableMesh(f"the source '{element.get('source')}' is missing")
        return self._once(_array, source)

    def _material(self, name: str) -> tuple[np.ndarray | None, int, ColladaTexture]:
        """Return a material's diffuse colour [3] (sRGB or None), texture index (-1 = none), and texture placement."""
        nothing = ColladaTexture("")
        shader, parameters = self._shader(name)
        # <constant> has no diffuse colour; its emission is its visible colour.
        channel = shader.find("emission" if shader.tag == "constant" else "diffuse") if shader is not None else None
        if channel is None:
            return None, -1, nothing
        reference = channel.find("texture")
        if reference is not None:
            lies = texture_of(reference, parameters)
            for setting in lies.ignored:
                self._ignore(setting, lies)
            index = self._image(lies.image)
            return (np.ones(3) if index >= 0 else None), index, lies
        color = floats(channel.findtext("color"))
        return (np.clip(color[:3], 0.0, 1.0) if len(color) >= 3 else None), -1, nothing

    def _shader(self, name: str) -> tuple[Element | None, dict[str, Element]]:
        """Return the shader of a material, and its parameters by name."""
        material = self.target(name)
        instance = material.find("instance_effect") if material is not None else None
        effect = self.target(instance.get("url")) if instance is not None else None
        profile = effect.find("profile_COMMON") if effect is not None else None
        if instance is None or effect is None or profile is None:
            return None, {}
        new = (*effect.findall("newparam"), *profile.iter("newparam"))
        parameters = {element.get("sid", ""): element for element in new}
        parameters |= {element.get("ref", ""): element for element in instance.findall("setparam")}
        return next((s for s in profile.iterfind("technique/*") if s.tag in _SHADERS), None), parameters

    def _image(self, name: str) -> int:
        reference = self._reference(name)
        return self.textures.add_file(self.path.parent, reference) if reference is not None else -1

    def _reference(self, name: str) -> str | None:
        """Return the file name of the image with the id ``name``; None if there is no such image."""
        image = self.by_id.get(name)
        if image is None:
            self.textures.note_unreadable(name)
            return None
        return image.findtext("init_from/ref") or image.findtext("init_from") or ""


def _array(source: Element) -> np.ndarray:  # [count, stride]
    accessor = source.find("technique_common/accessor")
    stride = attribute(accessor, "stride", 1) if accessor is not None else 3
    offset = attribute(accessor, "offset") if accessor is not None else 0
    if stride < 1:
        raise UnreadableMesh(f"the source '{source.get('id')}' has a stride of 0")
    values = floats(source.findtext("float_array"))[offset:]
    return values[: len(values) // stride * stride].reshape(-1, stride)


_SHADERS = ("phong", "lambert", "blinn", "constant")


@dataclass(frozen=True)
class _Binding:
    """Hold the material that an instance of a geometry uses for one of the material symbols in it."""

    material: str  # id of the material
    sets: dict[str, int] = field(default_factory=dict)  # texture coordinate sets by the name used in effects


def _bindings(instance: Element) -> dict[str, _Binding]:
    """Return the materials that an instance of a geometry uses, by the symbol in the geometry."""
    return {
        bound.get("symbol", ""): _Binding(
            bound.get("target", "").removeprefix("#"),
            {
                vertex.get("semantic", ""): attribute(vertex, "input_set")
                for vertex in bound.iterfind("bind_vertex_input")
                if vertex.get("input_semantic", "TEXCOORD") == "TEXCOORD"
            },
        )
        for bound in instance.iterfind("bind_material/technique_common/instance_material")
    }
