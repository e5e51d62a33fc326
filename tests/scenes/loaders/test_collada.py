from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.scenes.loaders.collada import read_collada
from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.mesh_parts import TextureStore
from activestructure_gym.scenes.scene import CLAMP, MIRROR, REPEAT

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


TEXTURE = '<texture texture="wood-sampler" texcoord="UV"/>'


def square(document, changes):
    """The textured square of the document, with words replaced, and the store of its textures."""
    text = DOCUMENT
    for before, after in changes.items():
        assert before in text
        text = text.replace(before, after)
    document.write_text(text)
    parts = read_collada(document, textures := TextureStore()).parts
    return next(part for part in parts if part.texture >= 0), textures


def corner_uv(part):
    """Coordinates at the square's corners (0, 0) and (1, 1), v up."""
    return (part.uv[[0, 2]] * [1, -1] + [0, 1]).tolist()


def extra(profile="MAYA", **values):
    said = "".join(f"<{name}>{value}</{name}>" for name, value in values.items())
    return TEXTURE.replace("/>", f'><extra><technique profile="{profile}">{said}</technique></extra></texture>')


@pytest.mark.parametrize(
    ("words", "wrap"),
    [
        ("", (REPEAT, REPEAT)),
        ("<wrap_s>CLAMP</wrap_s>", (CLAMP, REPEAT)),
        ("<wrap_s>WRAP</wrap_s><wrap_t> mirror </wrap_t>", (REPEAT, MIRROR)),
        ("<wrap_s>BORDER</wrap_s><wrap_t>NONE</wrap_t>", (CLAMP, CLAMP)),
        ("<wrap_s>MIRROR_ONCE</wrap_s><wrap_t>CLAMP</wrap_t>", (MIRROR, CLAMP)),
    ],
)
def test_wrap_modes_of_the_sampler(document, words, wrap):
    part, textures = square(document, {"</source></sampler2D>": f"</source>{words}</sampler2D>"})
    assert part.wrap == wrap and not textures.ignored  # a border is not seen where coordinates stay in the picture
    of_1_5 = {"<source>wood-surface</source></sampler2D>": f'<instance_image url="#wood-image"/>{words}</sampler2D>'}
    assert square(document, of_1_5)[0].wrap == wrap


def test_a_border_that_is_seen_and_a_word_that_is_no_wrap_mode_are_said(document):
    both = "<wrap_s>BORDER</wrap_s><wrap_t>FOLD</wrap_t></sampler2D>"
    _, textures = square(document, {"</sampler2D>": both, TEXTURE: extra(repeatU=2)})
    assert textures.ignored == ["wrap FOLD of wood-image", "wrap BORDER of wood-image"]


@pytest.mark.parametrize(
    ("placing", "expected", "wrap"),
    [
        (extra(repeatU=2, offsetU=0.5), [[0.5, 0], [2.5, 1]], (REPEAT, REPEAT)),
        (extra("OpenCOLLADA3dsMax", repeatV="3", offsetV="-1"), [[0, -1], [1, 2]], (REPEAT, REPEAT)),
        (extra(wrapU="TRUE", wrapV="FALSE", repeatU=1), [[0, 0], [1, 1]], (REPEAT, CLAMP)),
        (extra(wrapU=0, wrapV=1, mirrorV=1), [[0, 0], [1, 1]], (CLAMP, MIRROR)),
        (extra(wrapU=0, repeatU=4), [[0, 0], [4, 1]], (REPEAT, REPEAT)),
        (extra(translateFrameU=0.25, coverageU=2, coverageV=-1), [[-0.125, 0], [0.375, -1]], (REPEAT, REPEAT)),
        (extra(rotateUV=90), [[1, 0], [0, 1]], (REPEAT, REPEAT)),
        (extra(rotateUV=90, repeatU=2), [[1, 0], [0, 2]], (REPEAT, REPEAT)),
        (extra(rotateFrame=90, repeatU=2), [[2, 0], [0, 1]], (REPEAT, REPEAT)),
        (extra(rotateFrame=0, repeatU=1.0, offsetU=0, coverageU=1, noiseU=0, stagger="FALSE"), [[0, 0], [1, 1]],
         (REPEAT, REPEAT)),
    ],
)  # fmt: skip
def test_a_texture_is_placed_as_maya_does(document, placing, expected, wrap):
    part, textures = square(document, {TEXTURE: placing})
    np.testing.assert_allclose(corner_uv(part), expected, atol=1e-12)
    assert part.wrap == wrap and not textures.ignored


def test_what_cannot_be_followed_is_said(document):
    _, textures = square(document, {TEXTURE: extra(coverageV=0.5, noiseU=0.1, stagger=1, repeatU="2,5")})
    said = ["coverageV 0.5", "repeatU 2,5", "noiseU 0.1", "stagger"]
    assert sorted(textures.ignored) == sorted(f"{setting} of wood-image" for setting in said)


SECOND_SET = """<input semantic="TEXCOORD" source="#uvs" offset="2" set="0"/>
      <input semantic="TEXCOORD" source="#half" offset="2" set="1"/>"""
HALF = """<source id="half"><float_array id="half-array" count="8">.5 0 .75 0 .75 1 .5 1</float_array>
      <technique_common><accessor source="#half-array" count="4" stride="2"/></technique_common></source>
    <vertices"""


@pytest.mark.parametrize(
    ("texcoord", "binding", "u", "certain"),
    [
        ("UV", '<bind_vertex_input semantic="UV" input_semantic="TEXCOORD" input_set="1"/>', [0.5, 0.75], True),
        ("CHANNEL1", '<bind_vertex_input semantic="CHANNEL1" input_semantic="TEXCOORD" input_set="0"/>', [0, 1], True),
        ("UV", '<bind_vertex_input semantic="UV" input_semantic="TEXCOORD"/>', [0, 1], True),
        ("TEX1", "", [0.5, 0.75], True),
        ("CHANNEL0", "", [0, 1], True),
        ("", "", [0, 1], True),
        ("UVMap", "", [0, 1], False),
        ("UV", '<bind_vertex_input semantic="UV" input_semantic="TEXCOORD" input_set="7"/>', [0, 1], False),
    ],
)
def test_the_set_of_coordinates_that_is_bound(document, texcoord, binding, u, certain):
    part, textures = square(document, {
        '<input semantic="TEXCOORD" source="#uvs" offset="2" set="0"/>': SECOND_SET,
        "<vertices": HALF,
        'texcoord="UV"': f'texcoord="{texcoord}"',
        'target="#wood"/>': f'target="#wood">{binding}</instance_material>',
    })  # fmt: skip
    assert [corner[0] for corner in corner_uv(part)] == u
    assert textures.ignored == ([] if certain else [f"UV set {texcoord} of wood-image"])


def test_a_single_set_is_used_whatever_it_is_called(document):
    part, textures = square(document, {' set="0"/>': ' set="4"/>', 'texcoord="UV"': 'texcoord="CHANNEL2"'})
    assert corner_uv(part) == [[0, 0], [1, 1]] and not textures.ignored


def test_parameters_of_the_effect_and_of_the_material(document):
    sampler = '<newparam sid="wood-sampler"><sampler2D><source>wood-surface</source></sampler2D></newparam>'
    clamped = "<sampler2D><source>wood-surface</source><wrap_s>CLAMP</wrap_s></sampler2D>"
    of_effect = f'<effect id="wood-effect"><newparam sid="wood-sampler">{clamped}</newparam>'
    assert square(document, {sampler: "", '<effect id="wood-effect">': of_effect})[0].wrap == (CLAMP, REPEAT)
    of_material = f'"#wood-effect"><setparam ref="wood-sampler">{clamped}</setparam></instance_effect>'
    assert square(document, {'"#wood-effect"/>': of_material})[0].wrap == (CLAMP, REPEAT)


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


@pytest.mark.parametrize(
    ("transform", "expected"),
    [
        ("<skew>45 0 1 0 1 0 0</skew>", [[0, 0, 0], [1, 0, 0], [2, 1, 0], [1, 1, 0]]),  # x + y
        ("<skew>-45 0 2 0 3 0 0</skew>", [[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 1, 0]]),
        ("<skew>45 1 1 0 1 0 0</skew>", None),  # the diagonal would become the axis itself
        ("<skew>30 1 0 0 2 0 0</skew>", None),
        # By hand: at (1, 2, 3), x of the node along y of the scene, y along z.
        ("<lookat>1 2 3 0 2 3 0 0 1</lookat>", [[1, 2, 3], [1, 3, 3], [1, 3, 4], [1, 2, 4]]),
        ("<lookat>1 2 3 1 2 3 0 0 1</lookat>", None),
        ("<translate>5 0 0</translate><skew>45 0 1 0 0 0 1</skew>", [[5, 0, 0], [6, 0, 0], [6, 1, 1], [5, 1, 1]]),
    ],
)
def test_skews_and_lookats_place_a_node(document, transform, expected):
    outer, inner = "<translate>10 0 0</translate><rotate>0 0 1 90</rotate>", "<scale>2 2 2</scale>"
    if expected is None:
        with pytest.raises(UnreadableMesh, match="beyond the other|zero or parallel"):
            square(document, {outer: "", inner: transform})
    else:
        np.testing.assert_allclose(square(document, {outer: "", inner: transform})[0].vertices, expected, atol=1e-12)


# The square's left edge (corners 0 and 3) hangs on one joint, its right edge on two joints in equal parts.
SKIN = """<library_controllers><controller id="skin"><skin source="#square">
  <bind_shape_matrix>10 0 0 0 0 10 0 0 0 0 10 0 0 0 0 1</bind_shape_matrix>
  <source id="names"><Name_array id="names-array" count="2">first second</Name_array></source>
  <source id="binds"><float_array id="binds-array" count="32">
    .1 0 0 0 0 .1 0 0 0 0 .1 0 0 0 0 1 .1 0 0 0 0 .1 0 0 0 0 .1 0 0 0 0 1</float_array></source>
  <source id="weights"><float_array id="weights-array" count="2">1 .5</float_array></source>
  <joints><input semantic="JOINT" source="#names"/><input semantic="INV_BIND_MATRIX" source="#binds"/></joints>
  <vertex_weights count="4"><input semantic="JOINT" source="#names" offset="0"/>
    <input semantic="WEIGHT" source="#weights" offset="1"/>
    <vcount>1 2 2 1</vcount><v>0 0 0 1 1 1 0 1 1 1 0 0</v></vertex_weights>
</skin></controller></library_controllers><library_visual_scenes>"""
JOINTS = """<node id="bones" name="root"><translate>0 0 5</translate><node id="a" sid="first"/>
  <node id="b" sid="second"><translate>4 0 0</translate></node></node></visual_scene>"""
INSTANCE = {
    '<instance_geometry url="#square">': '<instance_controller url="#skin"><skeleton>#bones</skeleton>',
    "</instance_geometry>": "</instance_controller>",
}


def test_a_skin_stands_where_its_joints_are(document):
    changes = {"<library_visual_scenes>": SKIN, "</visual_scene>": JOINTS, **INSTANCE}
    part, _ = square(document, changes)
    # By hand: the node's move, turn and scale do not count; the right edge moves by half of 4.
    np.testing.assert_allclose(part.vertices, [[0, 0, 5], [3, 0, 5], [3, 1, 5], [0, 1, 5]], atol=1e-12)
    by_id = SKIN.replace("first second", "a b").replace("Name_array", "IDREF_array")
    part_by_id, _ = square(document, {**changes, "<library_visual_scenes>": by_id})
    np.testing.assert_array_equal(part_by_id.vertices, part.vertices)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("first second", "first third", "the joint 'third' of a skin is not a node"),
        ("<vcount>1 2 2 1", "<vcount>1 2 2", "weights for 3 of 4 vertices"),
        ("1 0 1 1 1 0 0</v>", "1 0 1 1 1 7 0</v>", "joints or weights that do not exist"),
        (".1 0 0 0 0 .1 0 0 0 0 .1 0 0 0 0 1 .1", ".1", "2 joints needs 16 numbers of a bind matrix for each, got 16"),
        ('<joints><input semantic="JOINT" source="#names"/>', "<joints>", "no <input> for JOINT"),
    ],
)
def test_a_damaged_skin_is_said_in_words(document, before, after, said):
    assert before in SKIN
    damaged = SKIN.replace(before, after)
    part, textures = square(document, {"<library_visual_scenes>": damaged, "</visual_scene>": JOINTS, **INSTANCE})
    assert len(textures.notes) == 1 and textures.notes[0].startswith("a skin or morph is shown without its pose: ")
    assert said in textures.notes[0]
    np.testing.assert_allclose(part.vertices[0], [10, 0, 0], atol=1e-12)  # where its node stands


@pytest.mark.parametrize(("method", "height"), [("", 1.5), (' method="RELATIVE"', 1.5)])
def test_morph_targets_move_the_vertices(document, method, height):
    up = "0 0 3 1 0 3 1 1 3 0 1 3" if not method else "0 0 3 0 0 3 0 0 3 0 0 3"
    morph = f"""<geometry id="up"><mesh><source id="up-places"><float_array id="ups" count="12">{up}</float_array>
      <technique_common><accessor source="#ups" count="4" stride="3"/></technique_common></source>
      <vertices id="up-corners"><input semantic="POSITION" source="#up-places"/></vertices></mesh></geometry>
    </library_geometries><library_controllers><controller id="skin"><morph source="#square"{method}>
      <source id="t"><IDREF_array id="ts" count="1">up</IDREF_array></source>
      <source id="w"><float_array id="ws" count="1">.5</float_array></source>
      <targets><input semantic="MORPH_TARGET" source="#t"/><input semantic="MORPH_WEIGHT" source="#w"/></targets>
    </morph></controller></library_controllers>"""
    outer, inner = "<translate>10 0 0</translate><rotate>0 0 1 90</rotate>", "<scale>2 2 2</scale>"
    part, _ = square(document, {"</library_geometries>": morph, outer: "", inner: "", **INSTANCE})
    expected = [[0, 0, height], [1, 0, height], [1, 1, height], [0, 1, height]]
    np.testing.assert_allclose(part.vertices, expected, atol=1e-12)


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
        ("0 0 0 1 0 0 1 1 0 0 1 0", "0 0 0 one 0 0 1 1 0 0 1 0", "'one' was found where numbers are expected"),
        ("<p>0 1 2 0 2 3", "<p>0 1 2 0 2 9", "a corner has the VERTEX 9, but there are 4"),
        ("<p>0 0 0 1 0 1 2", "<p>0 0 0 1 0 1 2 2", "not rows of 3"),
        ("<vcount>4", "<vcount>5", "counts 5 corners and has 4"),
        ('count="4" stride="3"', 'count="4" stride="2"', "have 2 numbers instead of 3"),
    ],
)
def test_damage_is_said_in_words(document, before, after, said):
    assert before in DOCUMENT
    document.write_text(DOCUMENT.replace(before, after))
    with pytest.raises(UnreadableMesh, match=said):
        read_collada(document, TextureStore())
