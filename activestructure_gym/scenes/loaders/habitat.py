"""Load datasets of Habitat by their ``*.scene_dataset_config.json``, and single stages by ``*.stage_config.json``.

Supported are the sections ``stages``, ``objects`` and ``scene_instances``:

- their ``paths`` (folders and patterns of configurations or .glb files) and ``default_attributes``;
- their ``configs``: templates with a ``template_handle``, whose ``attributes`` change an ``original_file`` or the
  defaults;
- of a configuration: ``render_asset``, ``up``, ``front``, ``scale``, ``units_to_meters`` and, for objects, ``COM``;
- of an instance: ``translation``, ``rotation`` (w first), ``uniform_scale``, ``non_uniform_scale`` and
  ``translation_origin``.

Articulated objects, lights, semantics and physics are ignored. Habitat's world is y up; the scene returned is z up.
Source of the format: [habitat], its documentation of attributes as JSON, and its reader for ``configs``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from glob import escape
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from activestructure_gym.errors import InputError, short_repr, unknown_name
from activestructure_gym.scenes.loaders.budget import LimitError
from activestructure_gym.scenes.loaders.json_files import read_json
from activestructure_gym.scenes.loaders.mesh_loader import (
    check_visible,
    finished_scene,
    read_parts,
    solid_parts,
    texture_notes,
    upright,
)
from activestructure_gym.scenes.loaders.mesh_parts import (
    MeshPart,
    TextureStore,
    assemble,
)
from activestructure_gym.scenes.loaders.references import find_reference
from activestructure_gym.scenes.scene import Scene

ENDING = ".scene_dataset_config.json"
_ENDINGS = {
    "stages": ".stage_config.json",
    "objects": ".object_config.json",
    "scene_instances": ".scene_instance.json",
}
_MAX_FILES = 200_000  # maximum number of files of one kind
_MAX_OBJECTS = 20_000  # maximum number of objects of a scene


def load_habitat_scene(
    path: str | os.PathLike[str], *, scene: str = "", objects: bool = True, max_texture: int = 512
) -> Scene:
    """Load a scene of a dataset configured for Habitat.

    Parameters
    ----------
    path
        The ``*.scene_dataset_config.json``, or a ``*.stage_config.json``.
    scene
        A scene instance, or a stage if the dataset has no instances, by name, end of path or whole words of it, such as
        ``00800-TEEsavR23oF``. Optional if there is only one.
    objects
        Whether to include the objects of a scene instance.
    max_texture
        Pixels; larger textures are shrunk.

    Raises
    ------
    InputError
        If a file is missing or damaged, or the scene does not exist.
    """
    if max_texture < 1:
        raise InputError(f"max_texture is the largest side of a texture in pixels, at least 1, got {max_texture}")
    dataset = _Dataset.of(Path(os.path.abspath(os.path.expanduser(path))))
    textures = TextureStore(max_texture)
    instances, stages = dataset.templates("scene_instances"), dataset.templates("stages")
    name, chosen = _chosen(instances or stages, scene, dataset.path)
    if not instances:
        parts, _ = dataset.placed("stages", chosen, textures)
    else:
        content = dataset.attributes("scene_instances", chosen)
        where = chosen.file
        stage = content.get("stage_instance")
        if not isinstance(stage, Mapping):
            raise InputError(f"'{where}' names no stage_instance, which is the building itself")
        parts = _instance(dataset, "stages", stage, textures, where, "")
        listed = content.get("object_instances") or []
        if not isinstance(listed, list) or len(listed) > _MAX_OBJECTS:
            raise InputError(f"object_instances of '{where}' must be a list of at most {_MAX_OBJECTS}")
        origin = str(content.get("translation_origin", ""))
        for one in listed if objects else ():
            if not isinstance(one, Mapping):
                raise InputError(f"'{where}' has an object instance that is not a table: {short_repr(one)}")
            parts += _instance(dataset, "objects", one, textures, where, origin)
    check_visible(chosen.file, parts)
    turned = [replace(part, vertices=upright(part.vertices, "y")) for part in parts]
    mesh = assemble(turned, textures.images)
    doubts = [*dict.fromkeys(dataset.doubts), *texture_notes(textures)]
    return finished_scene(mesh, chosen.file, name=name.rpartition("/")[2].removesuffix(".basis"), doubts=doubts)


def is_habitat(path: Path) -> bool:
    """Return whether the path is a dataset's configuration, or that of a stage whose mesh is no .ply.

    Replica's stage configurations name a .ply. It identifies paths given without a loader prefix.
    """
    if not path.name.endswith(_ENDINGS["stages"]):
        return path.name.endswith(ENDING)
    try:
        asset = _table(path, "a stage config (JSON with render_asset)").get("render_asset")
    except InputError:
        return False
    return isinstance(asset, str) and not asset.lower().endswith(".ply")


@dataclass(frozen=True, eq=False)
class _Template:
    """Hold a configuration or mesh, and the attributes that the dataset's ``configs`` change."""

    file: Path  # assets are relative to its folder; the dataset's configuration for a template without original_file
    changes: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class _Dataset:
    """Hold the configuration of a dataset, and the files and meshes that were read from it."""

    path: Path
    content: Mapping[str, Any]
    known: dict[str, dict[str, _Template]] = field(default_factory=dict)  # templates of a kind by handle
    assets: dict[_Template, tuple[list[MeshPart], np.ndarray]] = field(default_factory=dict)  # results of `placed`
    doubts: list[str] = field(default_factory=list)  # for the user

    @classmethod
    def of(cls, path: Path) -> _Dataset:
        if not path.is_file():
            raise InputError(f"there is no dataset configuration '{path}', a file *{ENDING} or *{_ENDINGS['stages']}")
        if path.name.endswith(_ENDINGS["stages"]):
            return cls(path, {"stages": {"paths": {".json": [escape(path.name)]}}})
        return cls(path, _table(path, "a dataset's configuration (JSON with stages)"))

    def templates(self, kind: str) -> dict[str, _Template]:
        """Return the templates of the section ``kind`` by handle: configurations, meshes and entries of ``configs``.

        A handle is the path of a file relative to the dataset's folder, without the ending, or a ``template_handle``.
        """
        if kind not in self.known:
            root = self.path.parent
            found: dict[str, _Template] = {}
            for file in islice(_listed(self._section(kind), kind, root), _MAX_FILES):
                ending = _ENDINGS[kind] if file.name.endswith(_ENDINGS[kind]) else file.suffix
                # A configuration overrides a bare mesh of the same name.
                found.setdefault(file.relative_to(root).as_posix().removesuffix(ending), _Template(file))
            self._add_configs(kind, found)
            self.known[kind] = dict(sorted(found.items()))
        return self.known[kind]

    def _add_configs(self, kind: str, found: dict[str, _Template]) -> None:
        """Add the templates that the ``configs`` of a section define, in their order.

        As in Habitat, an entry without ``template_handle`` changes its original, and an entry whose original is not
        among the templates is left out.
        """
        entries = self._section(kind).get("configs", [])
        if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
            raise InputError(f"configs of {kind} in '{self.path}' must be a list of tables, got {short_repr(entries)}")
        originals = {template.file.name: handle for handle, template in found.items()}
        originals |= {template.file.relative_to(self.path.parent).as_posix(): name for name, template in found.items()}
        for entry in entries[:_MAX_FILES]:
            changes, original, handle = (entry.get(key) for key in ("attributes", "original_file", "template_handle"))
            template = _Template(self.path)
            if isinstance(original, str):
                known = originals.get(os.path.normpath(original).lstrip("/"))
                if known is None:
                    continue
                template, handle = found[known], known if handle is None else handle
            if not isinstance(changes, Mapping) or not isinstance(handle, str):
                raise InputError(
                    f"configs of {kind} in '{self.path}' has an entry without attributes, or without original_file "
                    f"and template_handle: {short_repr(entry)}"
                )
            found[handle] = replace(template, changes={**template.changes, **changes})

    def attributes(self, kind: str, template: _Template) -> dict[str, Any]:
        """Return the attributes of a template: the section's defaults, those of its file, and the changes."""
        default = self._section(kind).get("default_attributes")
        told = dict(default) if isinstance(default, Mapping) else {}
        if template.file.name.endswith(".json") and not template.file.name.endswith(ENDING):
            told |= _table(template.file, "a configuration (JSON table)")
        return told | dict(template.changes)

    def placed(self, kind: str, template: _Template, textures: TextureStore) -> tuple[list[MeshPart], np.ndarray]:
        """Return the parts of a stage or object in Habitat's axes, and their centre of mass [3]; read each one once.

        Habitat's axes are y up and -z front, in metres. The centre of mass is from the configuration, else the centre
        of the bounding box.
        """
        if template not in self.assets:
            file, told = template.file, self.attributes(kind, template)
            asset = file
            if file.name.endswith(".json") or "render_asset" in template.changes:
                asset = self._asset(file, told.get("render_asset"))
            scale = _vector(told, "scale", file, (1.0,) * 3)  # along Habitat's axes, not the asset's
            motion = scale[:, None] * _turn(told, file) * _factor(told, file)
            if kind == "stages" and _vector(told, "origin", file, (0.0,) * 3).any():
                raise InputError(f"'{file}' moves its stage by an origin, which is not read; move the mesh")
            parts = [_moved(part, motion, np.zeros(3)) for part in read_parts(_plain(asset), textures)]
            corners = np.concatenate([part.vertices for part in parts])
            middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
            parts = solid_parts(parts, textures)  # the box is that of the whole asset
            centre = scale * _vector(told, "COM", file, (0.0,) * 3) if "COM" in told else middle
            self.assets[template] = parts, centre
        return self.assets[template]

    def _section(self, kind: str) -> Mapping[str, Any]:
        section = self.content.get(kind, {})
        if not isinstance(section, Mapping):
            raise InputError(f"'{kind}' of '{self.path}' must be a table, got {short_repr(section)}")
        return section

    def _asset(self, file: Path, reference: Any) -> Path:
        if not isinstance(reference, str):
            raise InputError(f"'{file}' names no render_asset, the mesh that is seen")
        climb = max(1, len(file.parent.relative_to(self.path.parent).parts))
        try:
            return find_reference(file.parent, reference, climb=climb)
        except FileNotFoundError:
            raise InputError(f"'{file}' names the mesh {short_repr(reference)}, which is not in the dataset") from None


def _plain(asset: Path) -> Path:
    """Return the mesh next to its copy with Basis textures, which cannot be read, if there is one, as in HM3D."""
    plain = asset.with_name(f"{asset.name.removesuffix('.basis.glb')}.glb")
    return plain if asset.name.endswith(".basis.glb") and plain.is_file() else asset


def _listed(section: Mapping[str, Any], kind: str, root: Path) -> Iterator[Path]:
    """Yield the files in the dataset's folder ``root`` that the ``paths`` of a section refer to.

    Files outside of the folder are left out.
    """
    paths = section.get("paths", {})
    for suffix in (".json", ".glb"):
        patterns = paths.get(suffix, []) if isinstance(paths, Mapping) else []
        ending = _ENDINGS[kind] if suffix == ".json" else suffix
        for pattern in patterns if isinstance(patterns, list) else []:
            try:
                matches = sorted(root.glob(str(pattern).strip("/") or "."))
                files = [f for match in matches for f in (sorted(match.iterdir()) if match.is_dir() else [match])]
            except (ValueError, NotImplementedError, IndexError):
                raise InputError(f"{kind} names a path that is not a pattern: {short_repr(pattern)}") from None
            except OSError as error:
                raise InputError(f"{kind} names a path that cannot be read: {error}") from None
            for file in map(Path, map(os.path.abspath, files)):
                if file.is_relative_to(root) and file.name.lower().endswith(ending) and os.path.isfile(file):
                    yield file


def _chosen(templates: Mapping[str, _Template], wanted: str, where: Path) -> tuple[str, _Template]:
    """Return handle and template of the scene ``wanted``; without a name, the only one.

    Raises `InputError` if there is no such template or more than one; ``where`` is the dataset's configuration.
    """
    if not templates:
        raise InputError(f"'{where}' has paths without stages and scene_instances; check that the dataset is complete")
    if not wanted and len(templates) == 1:
        return next(iter(templates.items()))
    found = _called(templates, wanted) or _containing(templates, wanted)
    if len(found) == 1:
        return found[0], templates[found[0]]
    names = [handle.rpartition("/")[2] for handle in templates]
    if not wanted or found:
        some = ", ".join((found or names)[:5])
        raise InputError(f"'{where}' holds {len(templates)} scenes; choose one with ?scene=NAME, such as: {some}")
    raise unknown_name(f"scene of '{where.name}'", wanted, names)


def _called(templates: Mapping[str, _Template], wanted: str) -> list[str]:
    """Return the handles that the name ``wanted`` matches: the handle of this name, else all handles that end in it."""
    return [wanted] if wanted in templates else [handle for handle in templates if handle.endswith(f"/{wanted}")]


def _containing(templates: Mapping[str, _Template], wanted: str) -> list[str]:
    """Return the handles that contain ``wanted`` as whole words, as ``room_0`` contains ``room``.

    Habitat searches for any part of a handle.
    """
    whole = re.compile(rf"(?<![^\W_]){re.escape(wanted)}(?![^\W_])")
    return [handle for handle in templates if wanted and whole.search(handle)]


def _instance(
    dataset: _Dataset, kind: str, told: Mapping[str, Any], textures: TextureStore, where: Path, origin: str
) -> list[MeshPart]:
    """Return the parts of one instance of a stage or object, transformed to its place in the scene.

    ``told`` is the table of the instance, and ``where`` the file with it. ``origin`` is the scene's
    ``translation_origin``.
    """
    template = told.get("template_name")
    if not isinstance(template, str):
        raise InputError(f"'{where}' has an instance without a template_name: {short_repr(told)}")
    templates = dataset.templates(kind)
    ends = _called(templates, template)
    if len(ends) > 1:
        raise InputError(f"'{where}' names '{template}', which fits several {kind}: {', '.join(ends[:5])}")
    if not ends:
        ends = _containing(templates, template)
        if len(ends) > 1:
            some = ", ".join(ends[:5])
            dataset.doubts.append(f"'{template}' fits several {kind}: {some}; the first is used, as in Habitat")
    if not ends:
        names = [handle.rpartition("/")[2] for handle in templates]
        raise unknown_name(f"template among the {kind} of '{dataset.path.name}'", template, names)
    parts, middle = dataset.placed(kind, templates[ends[0]], textures)
    try:
        textures.budget.take("meshes and copies of them", len(parts))
        textures.budget.take("triangles", sum(len(part.faces) for part in parts))
        textures.budget.take("vertices", sum(len(part.vertices) for part in parts))
    except LimitError as error:
        raise InputError(f"'{where}' is too large: {error}") from None
    scale = _vector(told, "non_uniform_scale", where, (1.0,) * 3) * float(
        _vector(told, "uniform_scale", where, (1.0,))[0]
    )
    quaternion = _vector(told, "rotation", where, (1.0, 0.0, 0.0, 0.0))
    if not 0.5 < np.linalg.norm(quaternion) < 2.0:
        raise InputError(f"'{where}' has a rotation that is not a unit quaternion [w, x, y, z]: {short_repr(told)}")
    motion = Rotation.from_quat(quaternion, scalar_first=True).as_matrix() * scale
    moved_by = _vector(told, "translation", where, (0.0,) * 3)
    if kind == "objects" and str(told.get("translation_origin", origin)).lower() != "asset_local":
        moved_by = moved_by - motion @ middle  # by default the centre of mass is placed
    return [_moved(part, motion, moved_by) for part in parts]


def _moved(part: MeshPart, motion: np.ndarray, by: np.ndarray) -> MeshPart:
    faces = part.faces if np.linalg.det(motion) > 0 else part.faces[:, ::-1]  # mirrored: reverse the winding
    return replace(part, vertices=part.vertices @ motion.T + by, faces=faces)


def _turn(told: Mapping[str, Any], where: Path) -> np.ndarray:  # [3, 3]
    """Return the rotation from the axes of an asset to Habitat's axes (y up, -z front)."""
    up, front = _vector(told, "up", where, (0.0, 1.0, 0.0)), _vector(told, "front", where, (0.0, 0.0, -1.0))
    right = np.cross(front, up)
    lengths = [float(np.linalg.norm(axis)) for axis in (right, up, front)]
    if min(lengths) < 1e-6 or abs(up @ front) > 1e-3 * lengths[1] * lengths[2]:
        raise InputError(f"up and front of '{where}' must be perpendicular, got {up.tolist()} and {front.tolist()}")
    return np.stack([right / lengths[0], up / lengths[1], -front / lengths[2]])


def _factor(told: Mapping[str, Any], where: Path) -> float:
    value = float(_vector(told, "units_to_meters", where, (1.0,))[0])
    if not value > 0:
        raise InputError(f"units_to_meters of '{where}' must be above 0, got {value:g}")
    return value


def _vector(told: Mapping[str, Any], name: str, where: Path, usual: Sequence[float]) -> np.ndarray:
    """Return the value ``name`` of a table as an array of as many numbers as the default ``usual``.

    Raises `InputError` for another value.
    """
    given = told.get(name, list(usual))
    values = given if isinstance(given, list) else [given]
    good = len(values) == len(usual) and all(
        isinstance(v, int | float) and not isinstance(v, bool) and abs(v) < 1e6 for v in values
    )
    if not good:
        raise InputError(f"{name} of '{where}' must be {len(usual)} finite numbers, got {short_repr(given)}")
    return np.array(values, dtype=np.float64)


def _table(path: Path, what: str) -> Mapping[str, Any]:
    return read_json(path, what, lambda given: dict(given))
