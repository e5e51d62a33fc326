from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.loaders.mesh_parts import TextureStore
from activestructure_gym.scenes.loaders.stl import read_stl


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_trimesh_reads_the_same_triangles(make_box, kind):
    import trimesh

    mesh = trimesh.Trimesh(*make_box((0, 0, 0), (4, 3, 2.5)), process=False)
    data = mesh.export(file_type=kind)
    (part,) = read_stl(data if isinstance(data, bytes) else data.encode(), TextureStore())
    np.testing.assert_array_equal(part.vertices[part.faces], mesh.triangles)
    np.testing.assert_array_equal(part.colors, 0.7)


def test_solids_are_joined_and_their_names_are_no_corners():
    solid = b"solid vertex 9 9 9\nfacet\nvertex 0 0 0\nVertex 1e0 0 0\nvertex 0 1 0\nendsolid vertex 1 2 3\n"
    (part,) = read_stl(solid * 2, TextureStore())
    assert part.faces.tolist() == [[0, 1, 2], [3, 4, 5]] and part.vertices.max() == 1


@pytest.mark.parametrize(
    "data, said", [(b"solid a\nvertex 0 0 0\n", "1 corners"), (b"\0" * 90, "90 bytes where its header says 84")]
)
def test_what_is_no_stl(data, said):
    with pytest.raises(ValueError, match=said):
        read_stl(data, TextureStore())


def binary_stl(attributes, header=b""):
    """Triangles side by side with these two free bytes each."""
    records = np.zeros(len(attributes), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records["corners"] = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    records["attribute"] = attributes
    return header.ljust(80, b" ") + np.uint32(len(attributes)).tobytes() + records.tobytes()


@pytest.mark.parametrize("extra", [1, 2, 50, 1000])
def test_bytes_behind_the_last_triangle_are_said(extra):
    (part,) = read_stl(binary_stl([0, 0]) + b"\0" * extra, textures := TextureStore())
    assert len(part.faces) == 2 and textures.notes == [f"{extra} bytes behind its 2 triangles were not read"]
    with pytest.raises(ValueError, match="its header says"):
        read_stl(binary_stl([]) + b"\0" * extra, TextureStore())


RED, GREEN, BLUE, GREY = [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.7] * 3
MAGICS = b"COLOR=\xff\x00\x33\xff,MATERIAL="


@pytest.mark.parametrize(
    ("header", "attributes", "expected"),
    [
        (b"", [0x0000, 0x0000], None),
        (b"", [0x801F, 0xFC00], [BLUE, RED]),  # VisCAM and SolidView: blue in the lowest bits
        (b"", [0x83E0, 0x0000], [GREEN, GREY]),
        (MAGICS, [0x0000, 0x0000], [[1, 0, 0.2]] * 2),
        (MAGICS, [0x001F, 0x7C00], [RED, BLUE]),  # Magics: red in the lowest bits
        (MAGICS, [0x03E0, 0x8000], [GREEN, [1, 0, 0.2]]),
        (MAGICS, [0x0000, 0xFFFF], [[0, 0, 0], [1, 0, 0.2]]),
        (b"solid".ljust(72) + b"COLOR=", [0x0000, 0x0000], None),  # cut off
    ],
)
def test_colours_in_both_conventions(header, attributes, expected):
    (part,) = read_stl(binary_stl(attributes, header), textures := TextureStore())
    corners = np.broadcast_to(part.colors, part.vertices.shape)[part.faces]
    np.testing.assert_allclose(corners, np.repeat(np.array(expected or [GREY] * 2)[:, None], 3, axis=1))
    assert not textures.notes


def test_free_bytes_that_are_no_colours_are_said():
    (part,) = read_stl(binary_stl([7, 0x8000]), textures := TextureStore())
    np.testing.assert_array_equal(part.colors, GREY)
    assert textures.notes == ["the colours of its triangles follow no known convention and were not read"]
