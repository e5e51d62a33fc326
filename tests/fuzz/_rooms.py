"""Small valid scenes in every format: what the fuzzers damage."""

from __future__ import annotations

import io
import json
import struct
import warnings
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from activestructure_gym.errors import InputWarning

if TYPE_CHECKING:
    from activestructure_gym.scenes import Scene

SIZE = np.array([4.0, 3.0, 2.5])  # metres
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * SIZE
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
FACES = QUADS[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
COLORS = (CORNERS * 60 % 256).astype(np.uint8)
_COMPONENTS = {"u1": 5121, "u2": 5123, "u4": 5125, "f4": 5126, "i2": 5122}


def encoded(kind: str, size: tuple[int, int] = (16, 12), **options: Any) -> bytes:
    """A picture with some structure."""
    pixels = np.add.outer(np.arange(size[1]) * 7, np.arange(size[0]) * 5)[..., None] + [0, 60, 120]
    stream = io.BytesIO()
    Image.fromarray((pixels % 256).astype(np.uint8)).save(stream, kind, **options)
    return stream.getvalue()


def glb_bytes(header: dict[str, Any], data: bytes) -> bytes:
    text = json.dumps(header).encode()
    return glb_of(text + b" " * (-len(text) % 4), data + b"\0" * (-len(data) % 4))


def glb_of(text: bytes, data: bytes) -> bytes:
    """A glb container of two chunks."""
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


class Gltf:
    """A glTF header with its binary chunk, to be spoilt before it is written."""

    def __init__(self) -> None:
        self.data = b""
        self.header: dict[str, Any] = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": []}

    def view(self, data: bytes) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        self.header["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        self.data += data
        return len(self.header["bufferViews"]) - 1

    def accessor(self, values: np.ndarray, **extra: Any) -> int:
        columns = values.shape[1] if values.ndim == 2 else 1
        self.header["accessors"].append(
            {
                "bufferView": self.view(np.ascontiguousarray(values).tobytes()),
                "componentType": _COMPONENTS[values.dtype.str[1:]],
                "count": len(values),
                "type": "SCALAR" if columns == 1 else f"VEC{columns}",
                **extra,
            }
        )
        return len(self.header["accessors"]) - 1

    def write(self, path: Path) -> Path:
        self.header.setdefault("buffers", [{"byteLength": len(self.data)}])
        if path.suffix == ".gltf":
            if "uri" not in self.header["buffers"][0]:
                self.header["buffers"][0]["uri"] = f"{path.stem}.bin"
                path.with_suffix(".bin").write_bytes(self.data)
            path.write_text(json.dumps(self.header))
        else:
            path.write_bytes(glb_bytes(self.header, self.data))
        return path


def gltf_room(picture: bytes | None = None, uri: str | None = None) -> Gltf:
    """A box with vertex colours beside a textured one, under nodes with transforms."""
    gltf = Gltf()
    position = gltf.accessor(CORNERS.astype(np.float32))
    indices = gltf.accessor(FACES.astype(np.uint16).reshape(-1))
    colors = gltf.accessor(np.hstack([COLORS, np.full((8, 1), 255, np.uint8)]), normalized=True)
    uv = gltf.accessor((CORNERS[:, :2] / 4).astype(np.float32))
    spare = gltf.accessor(CORNERS.astype(np.float32))
    gltf.header["accessors"][spare]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": gltf.view(np.array([7], np.uint16).tobytes()), "componentType": 5123},
        "values": {"bufferView": gltf.view(SIZE.astype(np.float32).tobytes())},
    }
    if uri is None:
        image = {"bufferView": gltf.view(picture or encoded("PNG")), "mimeType": "image/png", "name": "paper"}
    else:
        image = {"uri": uri}
    gltf.header |= {
        "images": [image],
        "samplers": [{"wrapS": 33071, "wrapT": 33648}],
        "textures": [{"source": 0, "sampler": 0}],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.7, 0.6, 1.0]}},
            {
                "pbrMetallicRoughness": {
                    "baseColorTexture": {
                        "index": 0,
                        "extensions": {"KHR_texture_transform": {"rotation": 0.1, "scale": [2, 2], "offset": [0, 0.5]}},
                    }
                }
            },
        ],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": position, "COLOR_0": colors}, "indices": indices,
                             "material": 0}]},
            {"primitives": [{"attributes": {"POSITION": spare, "TEXCOORD_0": uv}, "indices": indices,
                             "material": 1, "mode": 4}]},
        ],
        "nodes": [
            {"mesh": 0, "children": [1]},
            {"translation": [0.5, 0.5, 0.0], "rotation": [0.0, 0.0, 0.38268, 0.92388], "scale": [0.5, 0.5, 0.5],
             "children": [2]},
            {"mesh": 1, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]},
        ],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }  # fmt: skip
    return gltf


def placed_room() -> Gltf:
    """The room with all that a glTF can say of where a mesh is and of what is transparent."""
    gltf = gltf_room(encoded("PNG"))
    weights = np.zeros((8, 4), np.float32)
    weights[:, 0] = 1.0
    skinned, moved = (dict(gltf.header["meshes"][k]["primitives"][0]["attributes"]) for k in (0, 1))
    skinned |= {"JOINTS_0": gltf.accessor(np.zeros((8, 4), np.uint8)), "WEIGHTS_0": gltf.accessor(weights)}
    inverse = gltf.accessor(np.eye(4, dtype=np.float32).reshape(1, 16))
    gltf.header["accessors"][inverse] |= {"type": "MAT4", "count": 1}
    indices = gltf.header["meshes"][0]["primitives"][0]["indices"]
    target = {"POSITION": gltf.accessor(np.full((8, 3), 0.2, np.float32))}
    places = {
        "TRANSLATION": gltf.accessor(np.array([[0, 0, 0], [1, 1, 0]], np.float32)),
        "ROTATION": gltf.accessor(np.array([[0, 0, 0, 32767], [0, 0, 23170, 23170]], np.int16), normalized=True),
        "SCALE": gltf.accessor(np.full((2, 3), 0.5, np.float32)),
    }
    gltf.header["meshes"] += [
        {"primitives": [{"attributes": skinned, "indices": indices, "material": 2}]},
        {"primitives": [{"attributes": moved, "indices": indices, "targets": [target]}], "weights": [0.5]},
    ]
    texture = {"index": 0, "texCoord": 0}
    gltf.header["materials"] += [{"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.4]}}]
    gltf.header["materials"][1] |= {"alphaMode": "MASK", "alphaCutoff": 0.4}
    gltf.header["materials"][1]["pbrMetallicRoughness"] = {"baseColorTexture": texture}
    gltf.header["skins"] = [{"joints": [4], "inverseBindMatrices": inverse}]
    gltf.header["nodes"] += [
        {"mesh": 2, "skin": 0},
        {"translation": [0.1, 0.0, 0.0]},
        {"mesh": 3, "weights": [1.0], "extensions": {"EXT_mesh_gpu_instancing": {"attributes": places}}},
        {"mesh": 1, "extensions": {"KHR_node_visibility": {"visible": False}}},
    ]
    gltf.header["scenes"] = [{"nodes": [0, 3, 4, 5, 6]}]
    gltf.header["extensionsUsed"] = ["EXT_mesh_gpu_instancing", "KHR_node_visibility", "KHR_texture_transform"]
    return gltf


def _rows(array: np.ndarray) -> list[str]:
    return [" ".join(f"{value:g}" for value in row) for row in array]


def obj_text(faces: str = "") -> str:
    lines = ["mtllib room.mtl", *(f"v {row}" for row in _rows(CORNERS)), *(f"vt {row}" for row in _rows(CORNERS / 4))]
    lines += ["o walls", "usemtl paper", *(f"f {' '.join(f'{k + 1}/{k + 1}' for k in quad)}" for quad in QUADS[:4])]
    lines += ["usemtl red", "f -8 -6 -2 -4", "g ceiling", *(f"f {' '.join(str(k + 1) for k in f)}" for f in FACES[10:])]
    return "\n".join(lines) + "\n" + faces


MTL = "newmtl paper\nKd 1 1 1\nmap_Kd paper.png\nnewmtl red\nKd 0.8 0.2 0.2\nNs 10\nd 1.0\n"

PLACED_MTL = """newmtl paper
Kd 1 1 1
map_Kd -s 2 2 1 -o 0.5 0 0 -clamp on -mm 0 1 paper.png
map_d -imfchan l -s 3 paper.png
newmtl red
Kd 0.8 0.2 0.2
Tr 0.4
d -halo 0.7
"""


def ply_text(kind: str = "ascii") -> bytes:
    """Quads with the colours of vertices (binary: of faces)."""
    header = ["ply", f"format {kind} 1.0", "comment made by hand", "element vertex 8"]
    header += [f"property float {axis}" for axis in "xyz"]
    color = [f"property uchar {name}" for name in ("red", "green", "blue")]
    if kind == "ascii":
        header += [*color, "element face 6", "property list uchar int vertex_indices", "end_header"]
        body = [f"{a} {b}" for a, b in zip(_rows(CORNERS), _rows(COLORS))] + [f"4 {row}" for row in _rows(QUADS)]
        return ("\n".join([*header, *body]) + "\n").encode()
    header += ["element face 6", "property list uchar int vertex_indices", *color, "end_header"]
    face = np.zeros(6, [("count", "u1"), ("corners", "<i4", 4), ("color", "u1", 3)])
    face["count"], face["corners"], face["color"] = 4, QUADS, COLORS[:6]
    return ("\n".join(header) + "\n").encode() + CORNERS.astype("<f4").tobytes() + face.tobytes()


def stl_text() -> bytes:
    lines = ["solid room"]
    for corners in CORNERS[FACES]:
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {row}" for row in _rows(corners)), "endloop"]
        lines += ["endfacet"]
    return ("\n".join([*lines, "endsolid room"]) + "\n").encode()


def stl_binary() -> bytes:
    record = np.zeros(12, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")])
    record["corners"] = CORNERS[FACES]
    return b"by hand".ljust(80) + struct.pack("<I", 12) + record.tobytes()


DAE = """<?xml version="1.0"?>
<COLLADA version="1.4.1"><asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_images><image id="paper"><init_from>paper.png</init_from></image></library_images>
<library_effects><effect id="glued"><profile_COMMON>
<newparam sid="surface"><surface type="2D"><init_from>paper</init_from></surface></newparam>
<newparam sid="sampler"><sampler2D><source>surface</source></sampler2D></newparam>
<technique><phong><diffuse><texture texture="sampler" texcoord="uv"/></diffuse></phong></technique>
</profile_COMMON></effect>
<effect id="red"><profile_COMMON><technique><lambert><diffuse><color>0.8 0.2 0.2 1</color></diffuse></lambert>
</technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m1"><instance_effect url="#glued"/></material>
<material id="m2"><instance_effect url="#red"/></material></library_materials>
<library_geometries><geometry id="walls"><mesh>
<source id="p"><float_array count="24">{positions}</float_array>
<technique_common><accessor count="8" stride="3"/></technique_common></source>
<source id="t"><float_array count="16">{uv}</float_array>
<technique_common><accessor count="8" stride="2"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="8" material="a"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="TEXCOORD" source="#t" offset="1" set="0"/><p>{triangles}</p></triangles>
<polylist count="2" material="b"><input semantic="VERTEX" source="#v" offset="0"/>
<vcount>4 4</vcount><p>{quads}</p></polylist>{more}
</mesh></geometry></library_geometries>
<library_nodes>{library}
<node id="low"><scale>0.3 0.3 0.3</scale><instance_geometry url="#walls"/></node></library_nodes>
<library_visual_scenes><visual_scene id="s"><node id="root"><translate>0 0 0</translate>
<rotate>0 0 1 90</rotate><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix>
<instance_geometry url="#walls"><bind_material><technique_common>
<instance_material symbol="a" target="#m1"/><instance_material symbol="b" target="#m2"/>
</technique_common></bind_material></instance_geometry>
<node><instance_node url="#low"/></node>{nodes}</node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""


def dae_text(**parts: str) -> str:
    """The room; ``library``, ``nodes`` and ``more`` add text to its node library, its root node and its mesh."""
    pairs = np.repeat(FACES[:8].reshape(-1), 2)
    given = {
        "positions": " ".join(_rows(CORNERS)),
        "uv": " ".join(_rows(CORNERS[:, :2] / 4)),
        "triangles": " ".join(map(str, pairs)),
        "quads": " ".join(map(str, QUADS[4:].reshape(-1))),
        "library": "",
        "nodes": "",
        "more": "",
    }
    return DAE.format(**{**given, **parts})


def placed_dae() -> str:
    """The room with wrap modes, Maya's placement, what is transparent, and nodes of every kind of transform."""
    clear = '<transparent opaque="A_ONE"><color>1 1 1 0.7</color></transparent>'
    clear += "<transparency><float>0.9</float></transparency>"
    maya = "<repeatU>2</repeatU><offsetV>0.5</offsetV><rotateUV>30</rotateUV>"
    maya = f'<extra><technique profile="MAYA">{maya}</technique></extra>'
    text = dae_text(nodes="<node><skew>30 0 1 0 1 0 0</skew><lookat>0 0 1 1 0 1 0 0 1</lookat></node>")
    text = text.replace("</source></sampler2D>", "</source><wrap_s>MIRROR</wrap_s><wrap_t>CLAMP</wrap_t></sampler2D>")
    text = text.replace('texcoord="uv"/>', f'texcoord="uv">{maya}</texture>')
    bound = '<bind_vertex_input semantic="uv" input_semantic="TEXCOORD" input_set="0"/>'
    text = text.replace('target="#m1"/>', f'target="#m1">{bound}</instance_material>')
    return text.replace("0.8 0.2 0.2 1</color></diffuse>", f"0.8 0.2 0.2 1</color></diffuse>{clear}")


@lru_cache(maxsize=1)
def rooms() -> dict[str, dict[str, bytes]]:
    """Files by name of each kind of room; the first is the one to load."""
    glb, gltf = gltf_room(), gltf_room(uri="paper%20roll.jpg")
    gltf.header["buffers"] = [{"byteLength": len(gltf.data), "uri": "room.bin"}]
    webp = gltf_room(encoded("WEBP"))
    placed = placed_room()
    paper = {"paper.png": encoded("PNG")}
    return {
        "glb": {"room.glb": glb_bytes(glb.header | {"buffers": [{"byteLength": len(glb.data)}]}, glb.data)},
        "placed": {"room.glb": glb_bytes(placed.header | {"buffers": [{"byteLength": len(placed.data)}]}, placed.data)},
        "webp": {"room.glb": glb_bytes(webp.header | {"buffers": [{"byteLength": len(webp.data)}]}, webp.data)},
        "gltf": {
            "room.gltf": json.dumps(gltf.header, indent=1).encode(),
            "room.bin": gltf.data,
            "paper roll.jpg": encoded("JPEG", progressive=True),
        },
        "obj": {"room.obj": obj_text().encode(), "room.mtl": MTL.encode(), **paper},
        "obj-placed": {"room.obj": obj_text().encode(), "room.mtl": PLACED_MTL.encode(), **paper},
        "ply": {"room.ply": ply_text()},
        "ply-binary": {"room.ply": ply_text("binary_little_endian")},
        "stl": {"room.stl": stl_text()},
        "stl-binary": {"room.stl": stl_binary()},
        "dae": {"room.dae": dae_text().encode(), **paper},
        "dae-placed": {"room.dae": placed_dae().encode(), **paper},
    }


def load(path: str | Path, **options: Any) -> Scene:
    """Read a scene; what is accepted must be sound."""
    from activestructure_gym.scenes import load_scene

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        scene = load_scene(str(path), **options)
    mesh = scene.mesh
    assert all(np.isfinite(array).all() for array in (mesh.vertices, mesh.colors, mesh.uv)), "numbers that are none"
    assert mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices), "vertices that do not exist"
    assert len(mesh.colors) == len(mesh.uv) == len(mesh.vertices) and len(mesh.face_texture) == len(mesh.faces)
    assert mesh.face_texture.max() < len(mesh.textures), "textures that do not exist"
    return scene
