"""Every model that the tests write or ship, read by us and by readers that share nothing with ours."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene
from tests.scenes import independent_readers as independent

DOORWAY = np.array([(0, 0), (1, 0), (1, 2), (2, 2), (2, 0), (5, 0), (5, 3), (0, 3)])


def ours(path) -> independent.Summary:
    mesh = load_mesh_scene(path, up="z", units="m", max_texture=8192).mesh
    corners = mesh.colors[mesh.faces].astype(float)
    if mesh.linear_colors:
        corners = independent.display(corners)
    for index, texture in enumerate(mesh.textures):
        faces = mesh.face_texture == index
        corners[faces] *= independent.texels(Image.fromarray(texture), mesh.uv[mesh.faces[faces]].astype(float))
    return independent.summary(iter([(mesh.vertices[mesh.faces].astype(float), corners)]))


def check(path) -> None:
    found, expected = ours(path), independent.summary(independent.read(path))
    np.testing.assert_allclose([found.low, found.high], [expected.low, expected.high], atol=1e-5)
    assert found.area == pytest.approx(expected.area, rel=1e-5)
    assert found.triangles == expected.triangles
    np.testing.assert_allclose(found.color, expected.color, atol=2e-3)


def exported(shape, path) -> None:
    import trimesh

    scene = trimesh.Scene(shape)
    if path.suffix == ".gltf":
        for name, data in scene.export(file_type="gltf").items():
            (path if name.endswith(".gltf") else path.parent / name).write_bytes(data)
    elif path.suffix == ".obj":
        text, others = trimesh.exchange.obj.export_obj(shape, return_texture=True, mtl_name="m.mtl")
        path.write_text(text)
        for name, data in others.items():
            (path.parent / name).write_bytes(data)
    elif path.suffix == ".glb":
        path.write_bytes(scene.export(file_type="glb"))
    else:
        shape.export(path)


def room(make_box, rng, look):
    import trimesh

    shape = trimesh.Trimesh(*make_box((0, 0, 0), (4, 3, 2.5)), process=False)
    if look == "coloured":
        shape.visual.vertex_colors = rng.integers(0, 255, (8, 3), dtype=np.uint8)
    if look == "textured":
        image = Image.fromarray(rng.integers(0, 255, (6, 8, 3), dtype=np.uint8))
        material = trimesh.visual.material.SimpleMaterial(image=image)
        # Beside the edges of texels, so that every reader means the same one.
        uv = (rng.integers(-16, 16, (8, 2)) + 0.5) / [8, 6]
        shape.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return shape


@pytest.mark.parametrize(
    "look, suffix",
    [("plain", suffix) for suffix in (".glb", ".gltf", ".obj", ".ply", ".stl")]
    + [("coloured", suffix) for suffix in (".glb", ".gltf", ".obj", ".ply")]
    + [("textured", suffix) for suffix in (".glb", ".gltf", ".obj")],
)
def test_rooms_that_trimesh_writes(tmp_path, make_box, rng, look, suffix):
    exported(room(make_box, rng, look), tmp_path / f"room{suffix}")
    check(tmp_path / f"room{suffix}")


def test_instances_turned_and_scaled(tmp_path, make_box, rng):
    import trimesh

    scene = trimesh.Scene()
    scene.add_geometry(room(make_box, rng, "textured"), geom_name="a", node_name="a")
    for k in range(3):
        matrix = trimesh.transformations.random_rotation_matrix(rng.random(3)) @ np.diag([1.5, 1.5, 1.5, 1])
        matrix[:3, 3] = 6 * k
        scene.add_geometry(room(make_box, rng, "coloured"), geom_name=f"b{k % 2}", node_name=f"b{k}", transform=matrix)
    (tmp_path / "many.glb").write_bytes(scene.export(file_type="glb"))
    check(tmp_path / "many.glb")


def test_walls_of_concave_polygons(tmp_path, make_box):
    points = np.stack([DOORWAY[:, 0] * 0.8, DOORWAY[:, 0] * 0.6, DOORWAY[:, 1]], axis=1)
    beside = points[[0, 5, 6, 7]] + [0.0, 0.0, 5.0]
    corners = np.concatenate([points, beside])
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in points) + "f -8 -7 -6 -5 -4 -3 -2 -1\n"
    text += "".join(f"v {x} {y} {z}\n" for x, y, z in beside) + "f -4 -3 -2 -1\n"
    (tmp_path / "wall.obj").write_text(text)
    lines = ["ply", "format ascii 1.0", "element vertex 12", *(f"property float {axis}" for axis in "xyz")]
    lines += ["element face 2", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(str, corner)) for corner in corners] + ["8 0 1 2 3 4 5 6 7", "4 8 9 10 11"]
    (tmp_path / "wall.ply").write_text("\n".join(lines) + "\n")
    for suffix in (".obj", ".ply"):
        check(tmp_path / f"wall{suffix}")
        wall = load_mesh_scene(tmp_path / f"wall{suffix}", up="z")
        through = np.array([[1.5, 1.0], [1.5, 2.5], [0.5, 1.0], [4.0, 1.0]])  # the doorway, above it, on both sides
        eyes = np.stack([through[:, 0] * 0.8, through[:, 0] * 0.6, through[:, 1]], axis=1) + [-0.6, 0.8, 0]
        hits = wall.raycaster.cast(eyes, np.tile([0.6, -0.8, 0.0], (4, 1)))
        np.testing.assert_allclose(hits.distance, [np.inf, 1.0, 1.0, 1.0], atol=1e-5)


DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_effects><effect id="e"><profile_COMMON><technique sid="t"><lambert><diffuse><color>{color} 1</color></diffuse>
</lambert></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="{count}">{positions}</float_array><technique_common>
<accessor source="#pa" count="{vertices}" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist count="{polygons}" material="s"><input semantic="VERTEX" source="#v" offset="0"/>
<vcount>{sizes}</vcount><p>{indices}</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><translate>1 2 3</translate><rotate>0 0 1 30</rotate>
<scale>1 2 1</scale><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="s" target="#m"/></technique_common></bind_material></instance_geometry></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


@pytest.mark.parametrize("polygons", ["triangles", "doorway"])
def test_collada_agrees_with_pycollada(tmp_path, make_box, polygons):
    pytest.importorskip("collada")
    vertices, faces = make_box((0, 0, 0), (4, 3, 2.5))
    if polygons == "doorway":
        vertices, faces = np.insert(DOORWAY, 1, 0, axis=1), np.arange(8)[None]
    path = tmp_path / "room.dae"
    path.write_text(
        DAE.format(
            color="0.8 0.3 0.1", count=vertices.size, vertices=len(vertices), polygons=len(faces),
            positions=" ".join(map(str, vertices.ravel())), indices=" ".join(map(str, faces.ravel())),
            sizes=" ".join(str(len(face)) for face in faces),
        )
    )  # fmt: skip
    check(path)


def test_the_replica_mesh(replica_folder):
    """Quads in a binary PLY."""
    check(replica_folder / "room_a" / "mesh.ply")


@pytest.mark.parametrize("name", ["bookstore", "garage", "home_theater", "hotel_room"])
def test_real_scenes(shared, name):
    check(shared / "scenes" / f"{name}.glb")
