from __future__ import annotations

import warnings

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.scenes.loaders.mesh_parts import (
    MeshPart,
    TextureStore,
    assemble,
    srgb_from_linear,
)


def test_srgb_by_hand():
    # Ends are fixed; 0.0031308 is where the two pieces meet; linear 0.2140 is middle grey 0.5.
    linear = np.array([0.0, 1.0, 0.0031308, 0.21404])
    np.testing.assert_allclose(srgb_from_linear(linear), [0, 1, 0.04045, 0.5], atol=1e-4)


def test_each_picture_is_kept_once_however_often_it_is_named(tmp_path):
    Image.new("RGB", (8, 4), (10, 20, 30)).save(tmp_path / "a.png")
    Image.new("RGB", (8, 4), (10, 20, 30)).save(tmp_path / "b.bmp")  # other bytes, same pixels
    Image.new("RGB", (8, 4), (99, 20, 30)).save(tmp_path / "c.png")
    store = TextureStore()
    assert [store.add_file(tmp_path, name) for name in ("a.png", "a.png", "b.bmp", "c.png")] == [0, 0, 0, 1]
    assert len(store.images) == 2


def test_large_pictures_shrink_and_keep_their_shape(tmp_path):
    Image.new("RGBA", (1000, 250), (255, 0, 0, 10)).save(tmp_path / "wide.png")
    store = TextureStore(max_size=100)
    store.add_file(tmp_path, "wide.png")
    assert store.images[0].shape == (25, 100, 3)
    assert (store.images[0] == [255, 0, 0]).all()


@pytest.mark.parametrize(
    ("values", "ending", "shade"),
    [
        (np.full((4, 6), 30000, np.uint16), "png", 117),  # 30000 / 65535 * 255
        (np.full((4, 6), 65535, np.uint16), "png", 255),
        (np.full((4, 6), 30000, np.int32), "tiff", 117),
        (np.full((4, 6), 200, np.int32), "tiff", 200),  # 8 bits in a wide type
        (np.full((4, 6), 0.5, np.float32), "tiff", 128),
        (np.full((4, 6), 120.0, np.float32), "tiff", 120),
    ],
)
@pytest.mark.parametrize("max_size", [512, 3])
def test_grey_of_more_bits_is_brought_to_eight(tmp_path, values, ending, shade, max_size):
    Image.fromarray(values).save(tmp_path / f"a.{ending}")
    store = TextureStore(max_size)
    assert store.add_file(tmp_path, f"a.{ending}") == 0
    assert (store.images[0] == shade).all() and store.images[0].shape[2] == 3


@pytest.mark.parametrize("value", [np.int32(1 << 20), np.float32(1000), np.float32(-1), np.float32(np.nan)])
def test_grey_of_no_scale_is_said_and_not_guessed(tmp_path, value):
    Image.fromarray(np.full((4, 4), value)).save(tmp_path / "a.tiff")
    store = TextureStore()
    assert store.add_file(tmp_path, "a.tiff") == -1 and "a.tiff: has values from" in store.unreadable[0]


def test_what_cannot_be_read_is_remembered_once(tmp_path):
    (tmp_path / "broken.png").write_bytes(b"no picture")
    store = TextureStore()
    assert [store.add_file(tmp_path, n) for n in ("gone.png", "gone.png", "broken.png")] == [-1, -1, -1]
    assert store.unreadable == ["gone.png", "broken.png"]


def test_warnings_of_the_decoder_do_not_reach_the_terminal(tmp_path):
    image = Image.new("P", (4, 4), 1)
    image.putpalette([0, 0, 0, 120, 80, 40])
    image.save(tmp_path / "p.png", transparency=b"\x00\x80")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert (store := TextureStore()).add_file(tmp_path, "p.png") == 0
        assert store.opacity_of_file(tmp_path, "p.png", "luminance") is not None
    assert tuple(store.images[0][0, 0]) == (120, 80, 40)


def test_parts_keep_their_order_and_their_own_vertices():
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=float)
    uv = np.array([[0, 0], [1, 0], [0, 1]], dtype=float)
    parts = [
        MeshPart(triangle, np.array([[0, 1, 2]]), np.array([1.0, 0.0, 0.0])),
        MeshPart(triangle + 5, np.array([[2, 1, 0]]), np.full((3, 3), 0.5), uv=uv, texture=0),
        MeshPart(triangle + 9, np.array([[0, 1, 2]]), np.full(3, 0.5), uv=None, texture=0),  # a texture without uv
    ]
    mesh = assemble(parts, [np.zeros((2, 2, 3), np.uint8)])
    assert mesh.faces.tolist() == [[0, 1, 2], [5, 4, 3], [6, 7, 8]]
    assert mesh.face_texture.tolist() == [-1, 0, -1]
    np.testing.assert_array_equal(mesh.uv[3:6], uv)
    np.testing.assert_array_equal(mesh.colors[0], [1, 0, 0])


def test_colours_are_linear_only_where_it_makes_a_difference():
    triangle, face = np.eye(3), np.array([[0, 1, 2]])
    plain = MeshPart(triangle, face, np.full(3, 0.21404), linear=True)
    grey = MeshPart(triangle, face, np.full(3, 0.5))
    shaded = MeshPart(triangle, face, np.eye(3), linear=True)
    mesh = assemble([plain, grey], ())
    assert not mesh.linear_colors
    np.testing.assert_allclose(mesh.colors, 0.5, atol=1e-4)
    mesh = assemble([plain, grey, shaded], ())
    assert mesh.linear_colors
    np.testing.assert_allclose(mesh.colors[:6], 0.21404, atol=1e-4)
    np.testing.assert_array_equal(mesh.colors[6:], np.eye(3))


def test_textures_that_repeat_keep_their_places():
    part = MeshPart(np.eye(3), np.array([[0, 1, 2]]), np.ones(3), uv=np.zeros((3, 2)), texture=1)
    mesh = assemble([part, part], [np.zeros((2, 2, 3), np.uint8)] * 3)
    assert mesh.face_texture.tolist() == [1, 1] and len(mesh.textures) == 3 and mesh.texture_wrap == ()
