"""What a file says is transparent is not there: a room of 5 x 4 x 2.6 m with a wall across its middle at x = 2.5 m.

A ray along x from (1, 2, 1.3) meets the wall after 1.5 m, and the end of the room after 4.0 m if the wall is passed.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene
from activestructure_gym.scenes.scene import Scene

SIZE = (5.0, 4.0, 2.6)
WALL = np.array([[2.5, 0, 0], [2.5, 4, 0], [2.5, 4, 2.6], [2.5, 0, 2.6]])
WALL_FACES = np.array([[0, 1, 2], [0, 2, 3]])
WALL_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype=np.float32)  # v down, as in glTF
SOLID, PASSED = 1.5, 4.0
OPENING = slice(8, 24), slice(8, 24)  # rows and columns of 32: the middle half of the wall both ways


def _distance(scene: Scene, y: float = 2.0, z: float = 1.3) -> float:
    return float(scene.raycaster.cast(np.array([[1.0, y, z]]), np.array([[1.0, 0.0, 0.0]])).distance[0])


def _load(path: Path) -> Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return load_mesh_scene(path, up="z")


def _picture(alpha: Any = None, mode: str = "RGBA") -> Image.Image:
    """Grey with an opening in the middle, or with one alpha."""
    rgba = np.full((32, 32, 4), 255, np.uint8)
    rgba[..., :3] = 128
    if alpha is None:
        rgba[(*OPENING, 3)] = 0
    else:
        rgba[..., 3] = alpha
    return Image.fromarray(rgba).convert(mode)


def _png(image: Image.Image) -> bytes:
    stream = io.BytesIO()
    image.save(stream, "PNG")
    return stream.getvalue()


class GltfRoom:
    def __init__(self, writer: Any, folder: Path, make_box: Callable[..., Any]) -> None:
        self.writer, self.folder = writer, folder
        writer.triangle_mesh(*make_box((0, 0, 0), SIZE))

    def with_wall(
        self, material: dict[str, Any] | None = None, *, colors: np.ndarray | None = None,
        picture: Image.Image | None = None, uv: np.ndarray = WALL_UV, sampler: dict[str, Any] | None = None,
    ) -> Path:  # fmt: skip
        writer = self.writer
        if material is not None:
            primitive = writer.triangle_mesh(WALL, WALL_FACES, material=0)
            writer.header["materials"] = [material]
            primitive["attributes"]["TEXCOORD_0"] = writer.accessor(uv.astype(np.float32))
            if colors is not None:
                primitive["attributes"]["COLOR_0"] = writer.accessor(colors, normalized=colors.dtype.kind == "u")
        if picture is not None:
            writer.header["images"] = [{"bufferView": writer.view(_png(picture)), "mimeType": "image/png"}]
            writer.header["textures"] = [{"source": 0, "sampler": 0}]
            writer.header["samplers"] = [sampler or {}]
        path: Path = writer.write(self.folder / "room.glb")
        return path


@pytest.fixture
def gltf_room(gltf, tmp_path, make_box):
    return GltfRoom(gltf, tmp_path, make_box)


def _pbr(alpha: float = 1.0, **texture: Any) -> dict[str, Any]:
    base = {"baseColorFactor": [0.5, 0.5, 0.5, alpha], "baseColorTexture": {"index": 0, **texture}}
    return {"pbrMetallicRoughness": base}


def _plain(alpha: float) -> dict[str, Any]:
    return {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, alpha]}}


@pytest.mark.parametrize(
    ("material", "distance"),
    [
        (_plain(0.0), SOLID),  # OPAQUE, the default, ignores alpha
        (_plain(0.0) | {"alphaMode": "OPAQUE"}, SOLID),
        (_plain(0.0) | {"alphaMode": "BLEND"}, PASSED),
        (_plain(0.49) | {"alphaMode": "BLEND"}, PASSED),
        (_plain(0.5) | {"alphaMode": "BLEND"}, SOLID),
        (_plain(0.0) | {"alphaMode": "BLEND", "alphaCutoff": 0.0}, PASSED),  # the cutoff is MASK's alone
        (_plain(0.49) | {"alphaMode": "MASK"}, PASSED),
        (_plain(0.5) | {"alphaMode": "MASK"}, SOLID),
        (_plain(0.5) | {"alphaMode": "MASK", "alphaCutoff": 0.6}, PASSED),
        (_plain(0.3) | {"alphaMode": "MASK", "alphaCutoff": 0.3}, SOLID),
        (_plain(1.0) | {"alphaMode": "MASK", "alphaCutoff": 1.1}, PASSED),
        (_plain(0.2) | {"alphaMode": "BLEND", "extensions": {"KHR_materials_unlit": {}}}, PASSED),
        ({"alphaMode": "BLEND", "extensions": {
            "KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [1, 1, 1, 0.1]}}}, PASSED),
        ({"alphaMode": "BLEND"}, SOLID),
    ],
)  # fmt: skip
def test_gltf_factors(gltf_room, material, distance):
    scene = _load(gltf_room.with_wall(material))
    assert _distance(scene) == pytest.approx(distance, abs=1e-4)
    left_out = any("2 faces are transparent in the file and are left out" in note for note in scene.notes)
    assert left_out == (distance == PASSED)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_gltf_colours_of_vertices(gltf_room, kind):
    """Alpha rises from 0 at y = 0 to 1 at y = 4: the half from y = 2 on is solid."""
    most = 1 if kind is np.float32 else np.iinfo(kind).max
    colors = (np.array([[1, 1, 1, 0], [1, 1, 1, 1], [1, 1, 1, 1], [1, 1, 1, 0]]) * most).astype(kind)
    scene = _load(gltf_room.with_wall(_plain(1.0) | {"alphaMode": "MASK"}, colors=colors))
    assert [_distance(scene, y) for y in (0.1, 1.98, 2.02, 3.9)] == pytest.approx([PASSED, PASSED, SOLID, SOLID])


def test_gltf_colours_without_alpha_are_opaque(gltf_room):
    scene = _load(gltf_room.with_wall(_plain(1.0) | {"alphaMode": "MASK"}, colors=np.zeros((4, 3), np.float32)))
    assert _distance(scene) == pytest.approx(SOLID)


@pytest.mark.parametrize("mode", ["MASK", "BLEND"])
def test_gltf_pictures_are_cut(gltf_room, mode):
    """The opening goes from 1 to 3 m across and from 0.65 to 1.95 m up; a pixel has 0.125 by 0.081 m."""
    scene = _load(gltf_room.with_wall(_pbr() | {"alphaMode": mode}, picture=_picture()))
    across = [_distance(scene, y) for y in (0.03, 0.95, 1.05, 2.0, 2.95, 3.05, 3.97)]
    assert across == pytest.approx([SOLID, SOLID, PASSED, PASSED, PASSED, SOLID, SOLID])
    upward = [_distance(scene, z=z) for z in (0.03, 0.62, 0.68, 1.92, 1.98, 2.57)]
    assert upward == pytest.approx([SOLID, SOLID, PASSED, PASSED, SOLID, SOLID])
    assert any("2 faces are transparent in parts and are cut into" in note for note in scene.notes)


def test_a_picture_of_an_opaque_material_is_solid(gltf_room):
    assert _distance(_load(gltf_room.with_wall(_pbr(), picture=_picture()))) == pytest.approx(SOLID)


def test_gltf_factor_picture_and_vertices_multiply(gltf_room):
    """0.8 x 0.8 x 0.8 = 0.512, and 0.8 x 0.8 x 0.75 = 0.48."""
    colors = np.tile(np.array([1, 1, 1, 0.8], np.float32), (4, 1))
    material = _pbr(0.8) | {"alphaMode": "BLEND"}
    assert _distance(_load(gltf_room.with_wall(material, colors=colors, picture=_picture(204)))) == pytest.approx(SOLID)
    gltf_room.writer.header["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"][3] = 0.75
    assert _distance(_load(gltf_room.writer.write(gltf_room.folder / "b.glb"))) == pytest.approx(PASSED)


@pytest.mark.parametrize(
    ("transform", "sampler", "opening"),
    [
        ({}, {}, (1.0, 3.0)),
        ({"offset": [0.25, 0]}, {}, (0.0, 2.0)),  # u + 0.25
        ({"scale": [0.5, 1]}, {}, (2.0, 4.0)),  # u / 2: the left half of the picture
        ({"offset": [1.0, 0]}, {}, (1.0, 3.0)),  # repeats
        ({"offset": [1.0, 0]}, {"wrapS": 33071}, None),  # the last column of the picture, which is solid
        ({"offset": [1.25, 0]}, {"wrapS": 33648}, (0.0, 2.0)),  # u 1.25 to 2.25, mirrored: 0.75 down to 0
    ],
)
def test_the_alpha_of_a_picture_lies_where_its_colour_lies(gltf_room, transform, sampler, opening):
    material = _pbr(extensions={"KHR_texture_transform": transform}) | {"alphaMode": "MASK"}
    scene = _load(gltf_room.with_wall(material, picture=_picture(), sampler=sampler))
    found = [_distance(scene, y) > 2 for y in (0.1, 0.9, 1.1, 1.9, 2.1, 2.9, 3.1, 3.9)]
    low, high = opening or (9, 9)
    assert found == [low < y < high for y in (0.1, 0.9, 1.1, 1.9, 2.1, 2.9, 3.1, 3.9)]


def test_gltf_gloss_and_second_coordinates(gltf_room):
    gloss = {"diffuseTexture": {"index": 0, "texCoord": 1}}
    material = {"alphaMode": "MASK", "extensions": {"KHR_materials_pbrSpecularGlossiness": gloss}}
    gltf_room.with_wall(material, picture=_picture())
    attributes = gltf_room.writer.header["meshes"][1]["primitives"][0]["attributes"]
    attributes["TEXCOORD_1"] = gltf_room.writer.accessor((WALL_UV + [0.5, 0]).astype(np.float32))
    scene = _load(gltf_room.writer.write(gltf_room.folder / "b.glb"))
    assert [_distance(scene, y) > 2 for y in (0.5, 2.0, 3.5)] == [True, False, True]


def test_a_black_surface_that_shines_keeps_the_alpha_of_its_base_colour(gltf_room):
    material = {
        "alphaMode": "BLEND",
        "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 0.2]},
        "emissiveTexture": {"index": 0},
        "emissiveFactor": [1, 1, 1],
    }
    assert _distance(_load(gltf_room.with_wall(material, picture=_picture(255)))) == pytest.approx(PASSED)


def test_a_picture_without_alpha_is_solid(gltf_room):
    material = _pbr() | {"alphaMode": "BLEND"}
    assert _distance(_load(gltf_room.with_wall(material, picture=_picture(mode="RGB")))) == pytest.approx(SOLID)


@pytest.mark.parametrize(
    ("extension", "said"),
    [
        ({"KHR_materials_transmission": {"transmissionFactor": 0.9}, "KHR_materials_volume": {}}, True),
        ({"KHR_materials_diffuse_transmission": {"diffuseTransmissionFactor": 0.9}}, True),
        ({"KHR_materials_transmission": {}}, False),
    ],
)
def test_glass_is_solid_and_said(gltf_room, extension, said):
    scene = _load(gltf_room.with_wall(_plain(1.0) | {"extensions": extension}))
    assert _distance(scene) == pytest.approx(SOLID)
    assert any("2 faces let light through" in note for note in scene.notes) == said


def test_translucent_faces_are_solid_and_said(gltf_room):
    scene = _load(gltf_room.with_wall(_plain(0.7) | {"alphaMode": "BLEND"}))
    assert any("2 faces are translucent in the file (opacity of 0.5 or more) and solid" in note for note in scene.notes)


def test_an_invisible_wall_leaves_the_room_as_it_is_without_it(gltf_room, gltf, tmp_path, make_box):
    """Free space and observable surface are derived from the content, which is the same."""
    with_wall = _load(gltf_room.with_wall(_plain(0.0) | {"alphaMode": "BLEND"}))
    gltf.header["meshes"].pop()
    gltf.header["nodes"] = [{"mesh": 0}]
    without = _load(gltf.write(tmp_path / "bare.glb"))
    assert with_wall.content_hash == without.content_hash


def test_free_space_and_observable_surface_see_through_an_opening(gltf_room, gltf, tmp_path):
    """The wall with an opening in its picture, and a wall that has the opening in its geometry."""
    by_picture = _load(gltf_room.with_wall(_pbr() | {"alphaMode": "MASK"}, picture=_picture()))
    low, high = np.array([1.0, 0.65]), np.array([3.0, 1.95])
    inner = np.array([[2.5, *low], [2.5, high[0], low[1]], [2.5, *high], [2.5, low[0], high[1]]])
    frame = np.array(
        [[k, (k + 1) % 4, 4 + k] for k in range(4)] + [[(k + 1) % 4, 4 + (k + 1) % 4, 4 + k] for k in range(4)]
    )
    gltf.header["meshes"].pop()
    gltf.header.pop("materials")
    gltf.triangle_mesh(np.concatenate([WALL, inner]), frame)
    by_geometry = _load(gltf.write(tmp_path / "frame.glb"))
    truths = [ground_truth_of(scene) for scene in (by_picture, by_geometry)]
    volumes = [truth.free_space.volume for truth in truths]
    assert volumes[0] == pytest.approx(volumes[1], rel=0.01) and volumes[0] > 30
    areas = [truth.observable_surface.area for truth in truths]
    assert areas[0] == pytest.approx(areas[1], rel=0.02)


def test_a_scene_of_nothing_visible_is_refused(gltf, tmp_path):
    gltf.triangle_mesh(WALL, WALL_FACES, material=0)
    gltf.header["materials"] = [_plain(0.0) | {"alphaMode": "BLEND"}]
    with pytest.raises(InputError, match="is transparent everywhere: each of its triangles has an opacity below 0.5"):
        load_mesh_scene(gltf.write(tmp_path / "ghost.glb"))


# OBJ


@pytest.fixture
def obj_room(tmp_path, make_box):
    """Writes the room with a wall whose material has the given lines."""
    vertices, faces = make_box((0, 0, 0), SIZE)

    def write(material: str, *, uv: bool = True) -> Path:
        lines = ["mtllib room.mtl", *(f"v {x} {y} {z}" for x, y, z in np.concatenate([vertices, WALL]))]
        lines += [f"vt {u} {1 - v}" for u, v in WALL_UV] if uv else []
        lines += ["usemtl plain", *(f"f {a} {b} {c}" for a, b, c in faces + 1), "usemtl wall"]
        corner = "{0}/{1}" if uv else "{0}"
        lines += ["f " + " ".join(corner.format(8 + k + 1, k + 1) for k in face) for face in WALL_FACES]
        (tmp_path / "room.obj").write_text("\n".join(lines) + "\n")
        (tmp_path / "room.mtl").write_text(f"newmtl plain\nKd 0.5 0.5 0.5\nnewmtl wall\nKd 0.9 0.1 0.1\n{material}\n")
        return tmp_path / "room.obj"

    return write


@pytest.mark.parametrize(
    ("lines", "distance"),
    [
        ("", SOLID),
        ("d 0", PASSED),
        ("d 0.49", PASSED),
        ("d 0.5", SOLID),
        ("D 0.0", PASSED),
        ("d -halo 0.2", PASSED),
        ("d -halo 0.6", SOLID),
        ("Tr 1", PASSED),
        ("Tr 0.51", PASSED),
        ("Tr 0.5", SOLID),
        ("Tr 1.0\nd 1.0", SOLID),  # `d` is the one that the format's authors know
        ("d 0.0\nTr 0.0", PASSED),
        ("d much", SOLID),
        ("d", SOLID),
        ("illum 4\nTf 0 0 0", SOLID),
    ],
)
def test_obj_materials(obj_room, lines, distance):
    scene = _load(obj_room(lines))
    assert _distance(scene) == pytest.approx(distance, abs=1e-4)
    assert any("2 faces are transparent" in note for note in scene.notes) == (distance == PASSED)


def test_obj_surfaces_without_coordinates(obj_room, tmp_path):
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "black.png")
    assert _distance(_load(obj_room("d 0", uv=False))) == pytest.approx(PASSED)
    scene = _load(obj_room("map_d black.png", uv=False))
    assert _distance(scene) == pytest.approx(SOLID)
    assert any("without usable texture coordinates (wall)" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("lines", "opening"),
    [
        ("map_d grey.png", (1, 3)),
        ("map_d alpha.png", (1, 3)),
        ("map_Kd alpha.png\nmap_d alpha.png", (1, 3)),
        ("map_Kd alpha.png", None),  # the alpha of a colour counts where the file says so
        ("d 0\nmap_d grey.png", (0, 4)),  # d times the picture
        ("map_d -imfchan m alpha.png", (1, 3)),
        ("map_d -imfchan l alpha.png", None),  # its grey of 128 is solid
        ("map_d -imfchan r red.png", (1, 3)),
        ("map_d -imfchan g red.png", (0, 4)),
        ("MAP_D -o 0.25 0 grey.png", (0, 2)),  # u + 0.25
        ("map_d -s 0.5 1 1 grey.png", (2, 4)),
        ("map_d gone.png", None),
    ],
)
def test_obj_pictures_of_opacity(obj_room, tmp_path, lines, opening):
    grey = np.full((32, 32), 255, np.uint8)
    grey[OPENING] = 0
    Image.fromarray(grey).save(tmp_path / "grey.png")
    Image.fromarray(np.stack([grey, 0 * grey, 0 * grey], axis=2)).save(tmp_path / "red.png")
    _picture().save(tmp_path / "alpha.png")
    scene = _load(obj_room(lines))
    low, high = opening or (9, 9)
    places = (0.1, 0.9, 1.1, 1.9, 2.1, 2.9, 3.1, 3.9)
    assert [_distance(scene, y) > 2 for y in places] == [low < y < high for y in places]
    assert any("gone.png" in note for note in scene.notes) == ("gone" in lines)


# Collada

DAE = """<COLLADA><asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_images><image id="i"><init_from>{picture}</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="s"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="t"><sampler2D><source>s</source></sampler2D></newparam>
<newparam sid="half"><float>0.4</float></newparam>
<technique sid="c"><lambert>
<diffuse><color>0.9 0.1 0.1 0</color></diffuse>{transparency}</lambert></technique></profile_COMMON></effect>
</library_effects><library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries>{geometries}</library_geometries>
<library_visual_scenes><visual_scene id="v">
<node><instance_geometry url="#room"/></node>
<node><instance_geometry url="#wall"><bind_material><technique_common>
<instance_material symbol="w" target="#m"/></technique_common></bind_material></instance_geometry></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#v"/></scene></COLLADA>"""

GEOMETRY = """<geometry id="{name}"><mesh>
<source id="{name}p"><float_array>{positions}</float_array>
<technique_common><accessor stride="3"/></technique_common></source>
<source id="{name}t"><float_array>0 0 1 0 1 1 0 1</float_array>
<technique_common><accessor stride="2"/></technique_common></source>
<vertices id="{name}v"><input semantic="POSITION" source="#{name}p"/></vertices>
<triangles material="w"><input semantic="VERTEX" source="#{name}v" offset="0"/>{more}<p>{faces}</p></triangles>
</mesh></geometry>"""


@pytest.fixture
def dae_room(tmp_path, make_box):
    def write(transparency: str, picture: str = "alpha.png") -> Path:
        geometries = ""
        for name, (vertices, faces) in {"room": make_box((0, 0, 0), SIZE), "wall": (WALL, WALL_FACES)}.items():
            more = f'<input semantic="TEXCOORD" source="#{name}t" offset="0"/>' if name == "wall" else ""
            numbers = [" ".join(map(str, np.asarray(array).reshape(-1))) for array in (vertices, faces)]
            geometries += GEOMETRY.format(name=name, positions=numbers[0], faces=numbers[1], more=more)
        path = tmp_path / "room.dae"
        path.write_text(DAE.format(picture=picture, transparency=transparency, geometries=geometries))
        return path

    return write


def _transparent(mode: str, color: str, factor: str = "") -> str:
    opaque = f' opaque="{mode}"' if mode else ""
    more = f"<transparency><float>{factor}</float></transparency>" if factor else ""
    return f"<transparent{opaque}><color>{color}</color></transparent>{more}"


@pytest.mark.parametrize(
    ("said", "distance"),
    [
        ("", SOLID),  # the alpha of a diffuse colour says nothing
        (_transparent("A_ONE", "1 1 1 0"), PASSED),
        (_transparent("", "1 1 1 0"), PASSED),  # A_ONE is the default
        (_transparent("A_ONE", "0 0 0 1"), SOLID),
        (_transparent("A_ONE", "1 1 1 1", "0.4"), PASSED),
        (_transparent("A_ONE", "1 1 1 0.8", "0.6"), PASSED),
        (_transparent("A_ONE", "1 1 1 0.8", "0.7"), SOLID),
        (_transparent("A_ZERO", "1 1 1 1"), PASSED),
        (_transparent("A_ZERO", "1 1 1 0"), SOLID),
        (_transparent("A_ZERO", "1 1 1 1", "0.4"), SOLID),
        (_transparent("RGB_ZERO", "1 1 1 1"), PASSED),
        (_transparent("RGB_ZERO", "0 0 0 0"), SOLID),
        (_transparent("RGB_ZERO", "1 1 1 1", "0.0"), SOLID),
        (_transparent("RGB_ZERO", "0 1 0 1"), PASSED),  # luminance 0.715
        (_transparent("RGB_ZERO", "1 0 0 1"), SOLID),  # 0.213
        (_transparent("RGB_ONE", "0 0 0 1"), PASSED),
        (_transparent("RGB_ONE", "1 1 1 0"), SOLID),
        ("<transparency><float>0.3</float></transparency>", PASSED),
        ("<transparency><float>1</float></transparency>", SOLID),
        ('<transparency><param ref="half"/></transparency>', PASSED),
    ],
)
def test_collada_colours(dae_room, said, distance):
    scene = _load(dae_room(said))
    assert _distance(scene) == pytest.approx(distance, abs=1e-4)
    assert any("2 faces are transparent" in note for note in scene.notes) == (distance == PASSED)


@pytest.mark.parametrize(
    ("mode", "picture", "factor", "opening"),
    [
        ("A_ONE", "alpha.png", "1", (1, 3)),
        ("A_ONE", "grey.png", "1", None),  # it has no alpha
        ("A_ONE", "grey.png", "0.4", (0, 4)),
        ("A_ZERO", "inverse.png", "1", (1, 3)),
        ("RGB_ZERO", "light.png", "1", (1, 3)),
        ("RGB_ONE", "grey.png", "1", (1, 3)),
        ("RGB_ZERO", "gone.png", "1", None),
    ],
)
def test_collada_pictures(dae_room, tmp_path, mode, picture, factor, opening):
    grey = np.full((32, 32), 255, np.uint8)
    grey[OPENING] = 0
    Image.fromarray(grey).save(tmp_path / "grey.png")
    Image.fromarray(255 - grey).save(tmp_path / "light.png")
    _picture().save(tmp_path / "alpha.png")
    _picture(255 - grey).save(tmp_path / "inverse.png")
    said = f'<transparent opaque="{mode}"><texture texture="t" texcoord="UV"/></transparent>'
    scene = _load(dae_room(f"{said}<transparency><float>{factor}</float></transparency>", picture))
    low, high = opening or (9, 9)
    places = (0.1, 0.9, 1.1, 2.0, 2.9, 3.1, 3.9)
    assert [_distance(scene, y) > 2 for y in places] == [low < y < high for y in places]
    assert any("gone.png" in note for note in scene.notes) == ("gone" in picture)


# PLY


def _ply(path: Path, make_box: Callable[..., Any], kind: str, alphas: list[float], full: float, of: str) -> Path:
    vertices, faces = make_box((0, 0, 0), SIZE)
    vertices, faces = np.concatenate([vertices, WALL]), np.concatenate([faces, WALL_FACES + 8])
    colors = [f"property {kind} {name}" for name in ("red", "green", "blue", "alpha")]
    given = [f"{full} {full / 2} 0 {alpha}" for alpha in [full] * (8 if of == "vertex" else 12) + alphas]
    if kind != "float":
        given = [text.replace(".0", "").replace(".5", "") for text in given]
    header = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in "xyz"] + (colors if of == "vertex" else [])
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header += [*(colors if of == "face" else []), "end_header"]
    points = [" ".join(map(str, point)) for point in vertices]
    corners = ["3 " + " ".join(map(str, face)) for face in faces]
    for k, text in enumerate(given):
        (points if of == "vertex" else corners)[k] += f" {text}"
    path.write_text("\n".join([*header, *points, *corners]) + "\n")
    return path


@pytest.mark.parametrize(("kind", "full"), [("uchar", 255), ("ushort", 65535), ("float", 1.0)])
def test_ply_colours_have_an_alpha(tmp_path, make_box, kind, full):
    scene = _load(_ply(tmp_path / "a.ply", make_box, kind, [0, full, full, 0], full, "vertex"))
    assert [_distance(scene, y) for y in (0.1, 1.9, 2.1, 3.9)] == pytest.approx([PASSED, PASSED, SOLID, SOLID])
    assert any("2 faces are transparent in parts" in note for note in scene.notes)
    scene = _load(_ply(tmp_path / "b.ply", make_box, kind, [0, full], full, "face"))
    # The first triangle lies below the diagonal from (y, z) = (0, 0) to (4, 2.6).
    assert [_distance(scene, 2.0, z) for z in (1.2, 1.4)] == pytest.approx([PASSED, SOLID])
    opaque = _load(_ply(tmp_path / "c.ply", make_box, kind, [full] * 4, full, "vertex"))
    assert _distance(opaque) == pytest.approx(SOLID)


def test_a_ply_file_of_nothing_visible_is_read_as_solid(tmp_path, make_box):
    path = _ply(tmp_path / "a.ply", make_box, "uchar", [0] * 4, 255, "vertex")
    path.write_text(path.read_text().replace(" 255 127 0 255", " 255 127 0 0"))
    scene = _load(path)
    assert _distance(scene) == pytest.approx(SOLID)
    assert any("every face is transparent in the file" in note for note in scene.notes)
    assert not any("left out" in note for note in scene.notes)
