from dataclasses import replace

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, transform_points
from activestructure_gym.scenes.scene import CLAMP, MIRROR, REPEAT, Scene
from activestructure_gym.sensors.raycast import RaycastRenderer
from activestructure_gym.sensors.shading import make_appearance


def oracle(mesh, face, u, v):
    """Colours [N, 3] in 0..1 of hit points, in float64 numpy; black where face is -1."""
    weights = np.stack([1.0 - u - v, u, v], axis=1).astype(float)
    corners = mesh.faces[face]
    color = (weights[..., None] * mesh.colors[corners]).sum(axis=1)
    uv = (weights[..., None] * mesh.uv[corners]).sum(axis=1)
    for index, texture in enumerate(mesh.textures):
        height, width = texture.shape[:2]
        # A texture that repeats: pad it by a wrapped border and interpolate between texel centres.
        padded = np.pad(texture / 255.0, ((1, 1), (1, 1), (0, 0)), mode="wrap")
        x, y = (uv[:, 0] % 1.0) * width + 0.5, (uv[:, 1] % 1.0) * height + 0.5
        x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
        sx, sy = (x - x0)[:, None], (y - y0)[:, None]
        x0, y0 = np.minimum(x0, width), np.minimum(y0, height)
        sample = (1 - sy) * ((1 - sx) * padded[y0, x0] + sx * padded[y0, x0 + 1]) + sy * (
            (1 - sx) * padded[y0 + 1, x0] + sx * padded[y0 + 1, x0 + 1]
        )
        color = np.where((mesh.face_texture[face] == index)[:, None], color * sample, color)
    return np.where((face >= 0)[:, None], np.clip(color, 0.0, 1.0), 0.0)


@pytest.mark.parametrize("supersample", [1, 2, 3])
def test_agrees_with_plain_numpy(cluttered_room, room_poses, supersample):
    camera = PinholeCamera.from_size(48, 27)
    for pose in room_poses[:4]:
        rgb = RaycastRenderer(cluttered_room).render(camera, pose, supersample=supersample)[0]
        rays = transform_points(pose, camera.rays(supersample).reshape(-1, 3)) - pose[:3, 3]
        hits = cluttered_room.raycaster.cast(pose[:3, 3], rays)
        color = oracle(cluttered_room.mesh, hits.face, hits.u, hits.v)
        blocks = color.reshape(camera.height, supersample, camera.width, supersample, 3).mean(axis=(1, 3))
        # Rays rounded differently may fall to two sides of an edge: allow 1 sample in 1000 to do so.
        off = np.abs(rgb - 255.0 * blocks).max(axis=-1) > 0.51 + 0.1
        assert off.mean() <= 1e-3 * supersample**2
        assert rgb.std() > 20  # the room is not grey


def ahead(make_quad, merge, uv, texture, color=(1, 1, 1), **changes):
    """The colour of one pixel looking at the centre of a quad whose corners have the given uv."""
    corners = [[-2, -1, 1], [2, -1, 1], [2, 1, 1], [-2, 1, 1]]
    scene = Scene("quad", replace(merge([make_quad(corners, color, uv, 0)], [texture]), **changes), "tests")
    return RaycastRenderer(scene).render(PinholeCamera(1, 1, 1.0, 1.0, 0.5, 0.5), np.eye(4), supersample=1)[0][0, 0]


def test_textures_repeat_and_blend_across_the_seam(make_quad, merge):
    texture = np.array([[[0, 0, 0], [200, 100, 40]]], np.uint8)  # 1 x 2 texels, centred at u = 0.25 and 0.75
    for shift in (-3.0, 0.0, 5.0):
        # All corners at the same place, so the centre has it too. At u = 1 the seam: half of each texel.
        for u, expected in ((0.25, (0, 0, 0)), (0.75, (200, 100, 40)), (0.5, (100, 50, 20)), (1.0, (100, 50, 20))):
            color = ahead(make_quad, merge, np.tile([u + shift, 0.3], (4, 1)), texture)
            np.testing.assert_allclose(color, expected, atol=1)


# Four texels centred at 1/8, 3/8, 5/8, 7/8; what stands outside of the image, at u, by the definition of each mode.
OUTSIDE = [
    (REPEAT, 1.125, 0), (REPEAT, -0.125, 240), (REPEAT, 1.0, 120), (REPEAT, 2.375, 80),
    (CLAMP, 1.125, 240), (CLAMP, -0.125, 0), (CLAMP, 1.0, 240), (CLAMP, 40.0, 240), (CLAMP, -40.0, 0),
    (CLAMP, 0.5, 120), (MIRROR, 1.125, 240), (MIRROR, -0.125, 0), (MIRROR, 1.0, 240), (MIRROR, 1.375, 160),
    (MIRROR, 2.375, 80), (MIRROR, -1.875, 0), (MIRROR, 1.5, 120), (MIRROR, 0.5, 120), (MIRROR, 2.0, 0),
]  # fmt: skip


@pytest.mark.parametrize("wrap, u, expected", OUTSIDE)
@pytest.mark.parametrize("down", [False, True])
def test_how_a_texture_goes_on(make_quad, merge, wrap, u, expected, down):
    texture = np.repeat(np.array([[0, 80, 160, 240]], np.uint8)[..., None], 3, axis=2)
    uv, wraps = [u, 0.5], (wrap, CLAMP)
    if down:
        texture, uv, wraps = texture.transpose(1, 0, 2), uv[::-1], wraps[::-1]
    color = ahead(make_quad, merge, np.tile(uv, (4, 1)), texture, texture_wrap=(wraps,))
    np.testing.assert_allclose(color, expected, atol=1)


def test_linear_vertex_colours_become_display_values_after_interpolation(make_quad, merge):
    """Half way between black and white, in light: 0.5 linear is 188 in sRGB; interpolated as sRGB it would be 128."""
    colors = np.array([[0, 0, 0], [1, 1, 1], [1, 1, 1], [0, 0, 0]], float)
    white = np.full((1, 1, 3), 255, np.uint8)
    seen = [ahead(make_quad, merge, np.zeros((4, 2)), white, colors, linear_colors=linear) for linear in (True, False)]
    np.testing.assert_allclose(seen, [[188] * 3, [128] * 3], atol=1)
    dark = np.full((4, 3), 0.002)  # below the break of the curve: 12.92 * 0.002 * 255 = 6.6
    assert ahead(make_quad, merge, np.zeros((4, 2)), white, dark, linear_colors=True).tolist() == [7, 7, 7]


def test_texture_times_vertex_colour_is_clipped(make_quad, merge):
    texture = np.full((2, 2, 3), (100, 100, 200), np.uint8)
    color = ahead(make_quad, merge, np.zeros((4, 2)), texture, color=(0.5, 1.5, 2.0))
    np.testing.assert_array_equal(color, (50, 150, 255))


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 3e38, -3e38])
@pytest.mark.parametrize("wrap", [REPEAT, CLAMP, MIRROR])
def test_unusable_uv_stays_inside_the_texture(make_quad, merge, wrong, wrap):
    texture = np.full((3, 5, 3), 77, np.uint8)
    color = ahead(make_quad, merge, np.full((4, 2), wrong), texture, texture_wrap=((wrap, wrap),))
    assert color.tolist() == [77, 77, 77]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"faces": np.array([[0, 1, 99]], np.int32), "face_texture": np.zeros(1, np.int32)}, "faces must point"),
        ({"face_texture": np.full(12, 3, np.int32)}, "face_texture must lie in -1 .. 2"),
        ({"face_texture": np.zeros(3, np.int32)}, "one entry for each of 12 faces"),
        ({"uv": np.zeros((3, 2), np.float32)}, "one row per vertex"),
        ({"textures": (np.zeros((2, 2, 4), np.uint8),) * 3}, "a texture must be"),
        ({"texture_wrap": ((REPEAT, CLAMP),)}, "texture_wrap needs one entry for each of 3"),
    ],
)
def test_a_mesh_the_kernel_could_not_index_is_refused(box_room, change, message):
    with pytest.raises(ValueError, match=message):
        make_appearance(replace(box_room.mesh, **change))
