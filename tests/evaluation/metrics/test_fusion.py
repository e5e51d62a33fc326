from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.metrics import fusion
from activestructure_gym.evaluation.metrics.fusion import FusedSurface, triangle_areas
from activestructure_gym.geometry import PinholeCamera, fibonacci_directions, look_along

CAMERA = PinholeCamera.from_size(120, 90, 60.0)


def draws(depth: np.ndarray, poses: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """What draws these images at these poses, which differ from each other unless their images are equal."""
    known = {pose.tobytes(): image for pose, image in zip(np.asarray(poses, np.float64), depth)}
    return lambda wanted: np.stack([known[pose.tobytes()] for pose in wanted])


def fused_surface(
    depth: np.ndarray, camera: PinholeCamera, poses: np.ndarray, *, voxel: float, truncation: float
) -> np.ndarray:  # [T, 3, 3]
    """All triangles at once."""
    surface = FusedSurface(lambda wanted: depth, camera, poses, voxel=voxel, truncation=truncation)
    return np.concatenate([np.zeros((0, 3, 3), np.float32), *surface.pieces()])


def sphere_depth(pose: np.ndarray, radius: float = 1.0) -> np.ndarray:
    """Depth of a sphere around the origin, in closed form."""
    eye, rays = pose[:3, 3], CAMERA.rays() @ pose[:3, :3].T
    a, b, c = (rays**2).sum(-1), (rays * eye).sum(-1), (eye**2).sum() - radius**2
    root = b * b - a * c
    return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, 0).astype(np.float32)


@pytest.fixture(scope="module")
def around() -> np.ndarray:
    return np.stack([look_along(-3 * direction, direction) for direction in fibonacci_directions(24)])


def area(triangles: np.ndarray) -> float:
    return 0.5 * float(np.linalg.norm(np.cross(*(triangles[:, i] - triangles[:, 0] for i in (1, 2))), axis=1).sum())


def test_areas_are_those_of_trimesh(rng):
    triangles = rng.normal(size=(50, 3, 3))
    np.testing.assert_allclose(triangle_areas(triangles), trimesh.triangles.area(triangles), rtol=1e-12)
    assert triangle_areas(np.zeros((0, 3, 3))).shape == (0,)


def test_a_sphere_comes_back(around):
    depth = np.stack([sphere_depth(pose) for pose in around])
    triangles = fused_surface(depth, CAMERA, around, voxel=0.05, truncation=0.1)
    radii = np.linalg.norm(triangles.reshape(-1, 3), axis=1)
    assert radii.mean() == pytest.approx(1.0, abs=0.003)
    assert radii.std() < 0.006 and abs(radii - 1).max() < 0.03
    # A pixel is 3 cm wide there and the nearest one is taken: the surface is a few percent rough, and has no holes.
    assert area(triangles) == pytest.approx(4 * np.pi, rel=0.05)
    inner = triangles.mean(axis=1)
    assert len({tuple(octant) for octant in np.sign(inner).astype(int)}) >= 8


def test_a_wall_lies_where_it_was_measured_to_a_fraction_of_a_voxel():
    depth = np.full((1, 90, 120), 2.0, np.float32)
    pose = look_along(np.array([0.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    triangles = fused_surface(depth, CAMERA, pose[None], voxel=0.05, truncation=0.1)
    np.testing.assert_allclose(triangles[..., 0], 2.0, atol=1e-5)
    seen = (2 * 2.0 * 60 / CAMERA.fx) * (2 * 2.0 * 45 / CAMERA.fy)
    assert area(triangles) == pytest.approx(seen, rel=0.1)


def test_what_was_seen_through_is_carved_away(around):
    wall = np.full((4, 90, 120), 2.0, np.float32)
    phantom = wall.copy()
    phantom[0, 30:60, 40:80] = 1.0  # in one of four images something stood before the wall
    poses = np.repeat(look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))[None], 4, axis=0)
    alone = fused_surface(phantom[:1], CAMERA, poses[:1], voxel=0.05, truncation=0.1)
    together = fused_surface(phantom, CAMERA, poses, voxel=0.05, truncation=0.1)
    assert (np.abs(alone[..., 0] - 1.0) < 0.2).any()
    assert not (np.abs(together[..., 0] - 1.0) < 0.2).any()


def test_nothing_seen_and_nonsense():
    assert fused_surface(np.zeros((2, 9, 12), np.float32), CAMERA, np.tile(np.eye(4), (2, 1, 1)), voxel=0.05,
                         truncation=0.1).shape == (0, 3, 3)  # fmt: skip
    with pytest.raises(InputError, match="check that depth is in metres"):
        fused_surface(np.full((1, 90, 120), 3000.0, np.float32), CAMERA, np.eye(4)[None], voxel=0.05, truncation=0.1)


def test_the_number_of_threads_changes_nothing(around, monkeypatch):
    depth = np.stack([sphere_depth(pose) for pose in around[:4]])
    surfaces = []
    for threads in (1, 3):
        monkeypatch.setattr(fusion, "thread_cap", lambda threads=threads: threads)
        surfaces.append(fused_surface(depth, CAMERA, around[:4], voxel=0.1, truncation=0.2))
    np.testing.assert_array_equal(*surfaces)


def test_blocks_that_are_skipped_or_seen_through_at_once_change_nothing(around, monkeypatch, rng):
    """Against the same without any range of depths: nothing is known to be behind or in free space."""
    depth = np.stack([sphere_depth(pose) for pose in around[:8]])
    depth[depth == 0] = 6.0  # a room around, in eight corners of which no two images agree
    depth[3, 20:40, 50:80] = 0.0
    depth *= rng.uniform(0.99, 1.01, depth.shape).astype(np.float32)
    quick = fused_surface(depth, CAMERA, around[:8], voxel=0.05, truncation=0.1)
    found = fusion.range_of_tiles(depth)
    assert found.shape == (8, 12, 15, 2)
    assert found[2, 3, 4].tolist() == [depth[2, 24:32, 32:40].min(), depth[2, 24:32, 32:40].max()]
    assert found[3, 3, 7, 0] == 0.0

    def nothing_known(depth: np.ndarray) -> np.ndarray:
        tiles = np.zeros((len(depth), *found.shape[1:]), np.float32)
        tiles[..., 1] = np.inf
        return tiles

    monkeypatch.setattr(fusion, "range_of_tiles", nothing_known)
    np.testing.assert_array_equal(fused_surface(depth, CAMERA, around[:8], voxel=0.05, truncation=0.1), quick)


def noisy_room(around: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Images of a sphere in a room of which no two images agree, one of them with a hole."""
    depth = np.stack([sphere_depth(pose) for pose in around])
    depth[depth == 0] = 6.0
    depth[3, 20:40, 50:80] = 0.0
    return (depth * rng.uniform(0.99, 1.01, depth.shape)).astype(np.float32)


def test_parts_give_the_triangles_of_the_whole(around, rng, monkeypatch):
    """Equal bytes in equal order: no crack, no triangle twice, wherever one part ends and the next begins."""
    depth = noisy_room(around, rng)
    whole = fused_surface(depth, CAMERA, around, voxel=0.05, truncation=0.15)
    for part, images, kept in ((200, 64, 1 << 28), (333, 5, 0)):
        monkeypatch.setattr(fusion, "_PART", part)
        monkeypatch.setattr(fusion, "_IMAGES", images)
        monkeypatch.setattr(fusion, "_KEPT_IMAGES", kept)
        monkeypatch.setattr(fusion, "_KEPT_TRIANGLES", kept)
        surface = FusedSurface(draws(depth, around), CAMERA, around, voxel=0.05, truncation=0.15)
        assert surface.blocks > 3 * part
        for _ in range(2):  # the second time from what was kept, or made anew
            assert np.concatenate(list(surface.pieces())).tobytes() == whole.tobytes()


def test_images_that_look_at_places_far_apart_need_no_box_around_both():
    depth = np.full((2, 90, 120), 2.0, np.float32)
    poses = np.stack([look_along(np.array([x, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])) for x in (0.0, 10_000.0)])
    both = fused_surface(depth, CAMERA, poses, voxel=0.05, truncation=0.1)
    one = fused_surface(depth[:1], CAMERA, poses[:1], voxel=0.05, truncation=0.1)
    assert len(both) == pytest.approx(2 * len(one), rel=0.05)


def test_more_blocks_than_can_be_held_are_refused(monkeypatch):
    monkeypatch.setattr(fusion, "MAX_BLOCKS", 20)
    with pytest.raises(InputError, match="more than 20 blocks of 8 x 8 x 8 voxels of 0.05 m"):
        fused_surface(np.full((1, 90, 120), 2.0, np.float32), CAMERA, np.eye(4)[None], voxel=0.05, truncation=0.1)
