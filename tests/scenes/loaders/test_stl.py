from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.loaders.stl import read_stl


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_trimesh_reads_the_same_triangles(make_box, kind):
    import trimesh

    mesh = trimesh.Trimesh(*make_box((0, 0, 0), (4, 3, 2.5)), process=False)
    data = mesh.export(file_type=kind)
    (part,) = read_stl(data if isinstance(data, bytes) else data.encode())
    np.testing.assert_array_equal(part.vertices[part.faces], mesh.triangles)
    np.testing.assert_array_equal(part.colors, 0.7)


def test_solids_are_joined_and_their_names_are_no_corners():
    solid = b"solid vertex 9 9 9\nfacet\nvertex 0 0 0\nVertex 1e0 0 0\nvertex 0 1 0\nendsolid vertex 1 2 3\n"
    (part,) = read_stl(solid * 2)
    assert part.faces.tolist() == [[0, 1, 2], [3, 4, 5]] and part.vertices.max() == 1


@pytest.mark.parametrize(
    "data, said", [(b"solid a\nvertex 0 0 0\n", "1 corners"), (b"\0" * 90, "90 bytes where its header says 84")]
)
def test_what_is_no_stl(data, said):
    with pytest.raises(ValueError, match=said):
        read_stl(data)
