from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.scenes.loaders.collada import read_collada
from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.mesh_parts import TextureStore

# A unit square in the x, y plane as one quad (polylist) and as two triangles, shown by nested, turned nodes.
DOCUMENT = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="centimeter" meter="0.01"/><up_axis>Y_UP</up_axis></asset>
  <library_images><image id="wood-image"><init_from>../maps/wood.png</init_from></image></library_images>
  <library_effects>
    <effect id="wood-effect"><profile_COMMON>
      <newparam sid="wood-surface"><surface type="2D"><init_from>wood-image</init_from></surface></newparam>
      <newparam sid="wood-sampler"><sampler2D><source>wood-surface</source></sampler2D></newparam>
      <technique sid="common"><lambert><diffuse><texture texture="wood-sampler" texcoord="UV"/></diffuse></lambert>
      </technique></profile_COMMON></effect>
    <effect id="red-effect"><profile_COMMON><technique sid="common"><phong>
      <diffuse><color>0.8 0.1 0.2 1</color></diffuse></phong></technique></profile_COMMON></effect>
  </library_effects>
  <library_materials>
    <material id="wood"><instance_effect url="#wood-effect"/></material>
    <material id="red"><instance_effect url="#red-effect"/></material>
  </library_materials>
  <library_geometries><geometry id="square"><mesh>
    <source id="positions"><float_array id="positions-array" count="12">0 0 0 1 0 0 1 1 0 0 1 0</float_array>
      <technique_common><accessor source="#positions-array" count="4" stride="3"/></technique_common></source>
    <source id="uvs"><float_array id="uvs-array" count="8">0 0 1 0 1 1 0 1</float_array>
      <technique_common><accessor source="#uvs-array" count="4" stride="2"/></technique_common></source>
    <vertices id="corners"><input semantic="POSITION" source="#positions"/></vertices>
    <polylist material="first" count="1">
      <input semantic="VERTEX" source="#corners" offset="0"/>
      <input semantic="NORMAL" source="#positions" offset="1"/>
      <input semantic="TEXCOORD" source="#uvs" offset="2" set="0"/>
      <vcount>4</vcount><p>0 0 0 1 0 1 2 0 2 3 0 3</p>
    </polylist>
    <triangles material="second" count="2">
      <input semantic="VERTEX" source="#corners" offset="0"/><p>0 1 2 0 2 3</p>
    </triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="scene">
    <node id="outer"><translate>10 0 0</translate><rotate>0 0 1 90</rotate>
      <node id="inner"><scale>2 2 2</scale>
        <instance_geometry url="#square"><bind_material><technique_common>
          <instance_material symbol="first" target="#wood"/><instance_material symbol="second" target="#red"/>
        </technique_common></bind_material></instance_geometry>
      </node></node>
  </visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>"""


@pytest.fixture
def document(tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "models").mkdir()
    Image.new("RGB", (4, 4), (120, 80, 40)).save(tmp_path / "maps" / "wood.png")
    path = tmp_path / "models" / "square.dae"
    path.write_text(DOCUMENT)
    return path


def test_unit_axis_nodes_materials_and_textures(document):
    file = read_collada(document, textures := TextureStore())
    assert file.metres_per_unit == 0.01 and file.up == "y"
    quad, triangles = file.parts
    # By hand: scale 2, turn x to y, move by 10: (x, y) -> (10 - 2y, 2x).
    np.testing.assert_allclose(quad.vertices, [[10, 0, 0], [10, 2, 0], [8, 2, 0], [8, 0, 0]], atol=1e-12)
    assert quad.faces.tolist() == [[0, 1, 2], [0, 2, 3]] and quad.texture == 0
    np.testing.assert_array_equal(quad.uv, [[0, 1], [1, 1], [1, 0], [0, 0]])  # v counts down
    assert tuple(textures.images[0][0, 0]) == (120, 80, 40)
    np.testing.assert_allclose(triangles.colors, [0.8, 0.1, 0.2])
    np.testing.assert_allclose(triangles.vertices[triangles.faces], quad.vertices[quad.faces])


@pytest.mark.parametrize("texture", ["wood-sampler", "wood-image"])  # by the book, and as the FBX exporter writes it
def test_both_ways_to_name_a_texture(document, texture):
    document.write_text(DOCUMENT.replace('texture="wood-sampler"', f'texture="{texture}"').replace("wood", "Map #1"))
    (document.parent.parent / "maps" / "wood.png").rename(document.parent.parent / "maps" / "Map #1.png")
    quad = read_collada(document, textures := TextureStore()).parts[0]
    assert quad.texture == 0 and not textures.unreadable


def test_polygons_strips_and_fans_cover_the_same_square(document):
    before = '<triangles material="second" count="2">'
    cases = {
        "polygons": "<p>0 1 2 3</p>",
        "trifans": "<p>0 1 2 3</p>",
        "tristrips": "<p>0 1 3 2</p>",
    }
    for tag, indices in cases.items():
        text = DOCUMENT.replace(before, f'<{tag} material="second" count="1">')
        text = text.replace("<p>0 1 2 0 2 3</p>\n    </triangles>", f"{indices}\n    </{tag}>")
        document.write_text(text)
        part = read_collada(document, TextureStore()).parts[1]
        corners = part.vertices[part.faces]
        area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        assert len(area) == 2 and area.sum() == pytest.approx(4.0), tag
        assert len(np.unique(corners.mean(axis=1).round(6), axis=0)) == 2, tag  # not the same half twice


def test_instances_from_the_node_library_and_missing_textures(document):
    (document.parent.parent / "maps" / "wood.png").unlink()
    node = DOCUMENT[DOCUMENT.index('<node id="outer">') : DOCUMENT.index("</visual_scene>")]
    text = DOCUMENT.replace(node, '<node><translate>0 0 5</translate><instance_node url="#outer"/></node>')
    text = text.replace("<library_visual_scenes>", f"<library_nodes>{node}</library_nodes><library_visual_scenes>")
    document.write_text(text)
    parts = read_collada(document, textures := TextureStore()).parts
    assert len(parts) == 2 and (parts[0].vertices[:, 2] == 5).all()
    assert parts[0].texture == -1 and textures.unreadable == ["../maps/wood.png"]


def test_another_xml_file_is_refused(tmp_path):
    path = tmp_path / "x.dae"
    path.write_text("<html/>")
    with pytest.raises(UnreadableMesh, match="not <COLLADA>"):
        read_collada(path, TextureStore())


DOORWAY = "0 0 0 1 0 0 1 0 2 2 0 2 2 0 0 5 0 0 5 0 3 0 0 3"  # 13 m2; a fan over it has 19
HOLED = "0 0 0 4 0 0 4 0 4 0 0 4 1 0 1 2 0 1 2 0 3 1 0 3"  # a window of 2 in a wall of 16


@pytest.mark.parametrize(
    "corners, primitives, area",
    [
        (DOORWAY, '<polylist count="1">{}<vcount>8</vcount><p>0 1 2 3 4 5 6 7</p></polylist>', 13.0),
        (DOORWAY, '<polygons count="1">{}<p>0 1 2 3 4 5 6 7</p></polygons>', 13.0),
        (HOLED, '<polygons count="1">{}<ph><p>0 1 2 3</p><h>4 5 6 7</h></ph></polygons>', 14.0),
    ],
)
def test_doorways_and_windows_stay_open(tmp_path, corners, primitives, area):
    path = tmp_path / "wall.dae"
    path.write_text(
        f"""<COLLADA><library_geometries><geometry><mesh><source id="p"><float_array>{corners}</float_array>
        <technique_common><accessor stride="3"/></technique_common></source>
        <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>"""
        + primitives.format('<input semantic="VERTEX" source="#v" offset="0"/>')
        + "</mesh></geometry></library_geometries></COLLADA>"
    )
    (part,) = read_collada(path, TextureStore()).parts
    found = part.vertices[part.faces]
    areas = 0.5 * np.linalg.norm(np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0]), axis=1)
    assert areas.sum() == pytest.approx(area)


def test_a_texture_replaces_vertex_colours_and_a_plain_colour_takes_them(document):
    colors = '<input semantic="COLOR" source="#black" offset="0"/>'
    source = '<source id="black"><float_array>{}</float_array><technique_common><accessor stride="3"/>'
    source = source.format("0.5 0 1 " * 4) + "</technique_common></source>"
    text = DOCUMENT.replace('<vertices id="corners">', source + '<vertices id="corners">')
    document.write_text(
        text.replace("<vcount>", colors + "<vcount>").replace("<p>0 1 2 0 2 3", colors + "<p>0 1 2 0 2 3")
    )
    quad, triangles = read_collada(document, TextureStore()).parts
    assert quad.texture == 0
    np.testing.assert_allclose(np.broadcast_to(quad.colors, (4, 3)), 1.0)
    np.testing.assert_allclose(triangles.colors, np.tile([0.4, 0.0, 0.2], (6, 1)))


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('<instance_material symbol="second" target="#red"/>', ""),
        ("<diffuse><color>0.8 0.1 0.2 1</color></diffuse>", ""),
        ("<color>0.8 0.1 0.2 1</color>", '<texture texture="gone" texcoord="UV"/>'),
    ],
)
def test_vertex_colours_without_a_material_s_own_are_seen_as_they_are(document, before, after):
    source = f'<source id="own"><float_array>{"0.8 0.4 0.2 " * 4}</float_array><technique_common>'
    source += '<accessor stride="3"/></technique_common></source>'
    text = DOCUMENT.replace('<vertices id="corners">', source + '<vertices id="corners">').replace(before, after)
    document.write_text(text)
    grey = read_collada(document, TextureStore()).parts[1]
    np.testing.assert_allclose(np.broadcast_to(grey.colors, (6, 3)), 0.7)
    colors = '<input semantic="COLOR" source="#own" offset="0"/>'
    document.write_text(text.replace("<p>0 1 2 0 2 3", colors + "<p>0 1 2 0 2 3"))
    painted = read_collada(document, TextureStore()).parts[1]
    np.testing.assert_allclose(painted.colors, np.tile([0.8, 0.4, 0.2], (6, 1)))


@pytest.mark.parametrize(
    "before, after, said",
    [
        ("0 0 0 1 0 0 1 1 0 0 1 0", "0 0 0 1,0 0 0 1 1 0 0 1 0", "written with commas"),
        ("0 0 0 1 0 0 1 1 0 0 1 0", "0 0 0 one 0 0 1 1 0 0 1 0", "'one' stands where numbers are expected"),
        ("<p>0 1 2 0 2 3", "<p>0 1 2 0 2 9", "its corners name VERTEX 9 of 4"),
        ("<p>0 0 0 1 0 1 2", "<p>0 0 0 1 0 1 2 2", "no rows of 3"),
        ("<vcount>4", "<vcount>5", "counts 5 corners and has 4"),
        ('count="4" stride="3"', 'count="4" stride="2"', "have 2 numbers instead of 3"),
    ],
)
def test_damage_is_said_in_words(document, before, after, said):
    assert before in DOCUMENT
    document.write_text(DOCUMENT.replace(before, after))
    with pytest.raises(UnreadableMesh, match=said):
        read_collada(document, TextureStore())
