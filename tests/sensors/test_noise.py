import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along, rotation_angle
from activestructure_gym.sensors.noise import (
    DEPTH_NOISE,
    drop_edges,
    incidence_angles,
    kinect_sigma,
    noisy_depth,
    noisy_pose,
)

CAMERA = PinholeCamera.from_size(320, 240)


def wall(depth):
    return np.full((CAMERA.height, CAMERA.width), depth, np.float32)


def slanted(camera, angle, distance):
    """Depth of a plane ``distance`` m ahead on the axis, turned by ``angle`` around the image's vertical."""
    rays = camera.rays().astype(float)
    normal = np.array([np.sin(angle), 0.0, -np.cos(angle)])
    depth = normal[2] * distance / (rays @ normal)
    return np.where(depth > 0, depth, 0.0).astype(np.float32), rays, normal


def test_incidence_on_a_plane_is_the_angle_between_ray_and_normal():
    camera = PinholeCamera.from_size(64, 48, 60.0)
    depth, rays, normal = slanted(camera, np.radians(40.0), 2.0)
    expected = np.arccos(np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1))
    np.testing.assert_allclose(incidence_angles(depth, camera), expected, atol=1e-3)  # float32 depth


def test_incidence_beside_an_edge_is_that_of_the_own_surface():
    depth = wall(2.0)
    depth[:, 160:] = 4.0  # two walls facing the camera: the edge between them is no slant
    depth[100:110, 30:40] = 0.0
    facing = np.arctan(np.linalg.norm(CAMERA.rays()[..., :2], axis=-1))
    np.testing.assert_allclose(incidence_angles(depth, CAMERA), np.where(depth > 0, facing, 0.0), atol=1e-6)


@pytest.mark.parametrize(
    ("depth", "measured"),  # metres, and millimetres found on planes in real frames of 7-Scenes (research notes)
    [(1.1, 1.9), (1.46, 2.4), (2.08, 7.2), (2.47, 8.8), (2.82, 11.1)],
)
def test_kinect_sigma_is_that_of_real_frames(depth, measured):
    assert 1e3 * kinect_sigma(np.array(depth), np.array(0.0)) == pytest.approx(measured, rel=0.4)


def test_kinect_sigma_by_hand():
    # z = 2.4, theta = pi / 4: 0.0012 + 0.0019 * 2^2 + 0.0001 / 1.549 * 1 = 0.0012 + 0.0076 + 0.0000646
    assert kinect_sigma(np.array(2.4), np.array(np.pi / 4)) == pytest.approx(0.0088646, abs=1e-7)


@pytest.mark.parametrize("depth", [1.0, 2.5, 5.0])
@pytest.mark.parametrize("multiplier", [0.5, 1.0])
def test_kinect_spread_follows_the_formula(depth, multiplier):
    noisy = noisy_depth(wall(depth), CAMERA, np.random.default_rng(0), model="kinect", multiplier=multiplier)
    quantum = multiplier * depth**2 / (35.130 * 8)
    incidence = incidence_angles(wall(depth), CAMERA)
    sigma = np.sqrt(np.mean((multiplier * kinect_sigma(np.array(depth), incidence)) ** 2) + quantum**2 / 12)
    assert noisy.std() == pytest.approx(sigma, rel=0.06)  # 76,800 samples; quantum / sqrt(12) is itself approximate
    assert noisy.mean() == pytest.approx(depth, abs=0.03 * sigma + sigma**2 / depth + quantum / 20)


@pytest.mark.parametrize("depth", [1.0, 2.5, 5.0])
def test_redwood_spread_follows_the_formula(depth):
    noisy = noisy_depth(wall(depth), CAMERA, np.random.default_rng(0), model="redwood")
    # z' = 35.13 / d: dz = z^2 / 35.13 * dd, with dd of 0.027778 px and a rounding to 1/8 px.
    disparity = np.round((35.130 / depth + 0.027778 * np.random.default_rng(1).standard_normal(200_000)) * 8) / 8
    expected = 35.130 / disparity
    assert noisy.mean() == pytest.approx(expected.mean(), abs=0.02 * depth**2 / 35.130 / 8)
    assert noisy.std() == pytest.approx(expected.std(), rel=0.03, abs=1e-6)


def test_redwood_depths_are_steps_of_disparity():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 9.9, (CAMERA.height, CAMERA.width)).astype(np.float32)
    steps = 8 * 35.130 / noisy_depth(depth, CAMERA, rng, model="redwood").astype(float)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)


def test_redwood_sees_nothing_from_10_m_on_and_kinect_beyond_it():
    assert not noisy_depth(wall(10.0), CAMERA, np.random.default_rng(0), model="redwood").any()
    assert noisy_depth(wall(9.9), CAMERA, np.random.default_rng(0), model="redwood").all()
    assert noisy_depth(wall(11.0), CAMERA, np.random.default_rng(0), model="kinect").mean() > 9.0


@pytest.mark.parametrize(("focal", "share"), [(525.0, 0.266), (160.0, 0.0204)])
def test_lateral_noise_keeps_its_angle(focal, share):
    # The pixel beside an edge reads across it where the jitter exceeds half a pixel. Kinect: 0.8 px at f = 525, so
    # P(N(0, 0.8) > 0.5) = 0.266; at f = 160 the same angle is 0.244 px, P(N(0, 0.244) > 0.5) = 0.0204.
    camera = PinholeCamera(40, 40, focal, focal, 20.0, 20.0)  # narrow: no slant that would add to the jitter
    depth = np.full((40, 40), 1.0, np.float32)
    depth[:, 20:] = 3.0
    rng = np.random.default_rng(0)
    read = [noisy_depth(depth, camera, rng, model="kinect") for _ in range(200)]
    across = (np.stack(read)[:, :, 19] > 2.0).mean()  # 8000 pixels
    assert across == pytest.approx(share, abs=4 * np.sqrt(share / 8000))


def test_redwood_reads_one_value_per_block_of_the_source_camera():
    camera = PinholeCamera(64, 64, 525.0, 525.0, 32.0, 32.0)
    depth = np.tile(np.where(np.arange(64) % 2, 1.0, 5.0).astype(np.float32), (64, 1))  # odd columns near
    noisy = noisy_depth(depth, camera, np.random.default_rng(0), model="redwood")
    assert (noisy > 4.0).all()  # jitter chooses the block; of each the even column is read, 5 m
    ramp = np.tile(np.linspace(1.0, 9.0, 64, dtype=np.float32), (64, 1))
    noisy = noisy_depth(ramp, camera, np.random.default_rng(0), model="redwood")
    apart = np.abs(np.diff(noisy, axis=1))[:, ::2] > 0.15  # a block of the ramp is 0.25 m, noise and step 0.1 m
    assert 0.02 < apart[:, :16].mean() < 0.2  # every pixel jitters by itself: 0.25 px exceed half a pixel in 4.6 %
    coarse = PinholeCamera(64, 64, 160.0, 160.0, 32.0, 32.0)
    noisy = noisy_depth(depth, coarse, np.random.default_rng(0), model="redwood")
    np.testing.assert_allclose(noisy, depth, rtol=0.03)


@pytest.mark.parametrize("model", DEPTH_NOISE)
def test_multiplier_0_equals_none(model):
    depth = np.random.default_rng(3).uniform(0.0, 12.0, (90, 160)).astype(np.float32)
    depth[depth < 1.0] = 0.0
    camera = PinholeCamera.from_size(160, 90)
    noisy = noisy_depth(depth, camera, np.random.default_rng(0), model=model, multiplier=0.0)
    np.testing.assert_array_equal(noisy, depth)


@pytest.mark.parametrize("model", ["kinect", "redwood"])
def test_same_seed_same_noise_and_no_return_stays_none(model):
    depth = wall(3.0)
    depth[50:100, 80:200] = 0.0
    before = depth.copy()
    one, two, other = (noisy_depth(depth, CAMERA, np.random.default_rng(seed), model=model) for seed in (4, 4, 5))
    np.testing.assert_array_equal(one, two)
    assert (one != other).mean() > 0.1
    assert one.dtype == np.float32
    assert not one[55:95, 85:195].any()  # lateral noise moves the rim only
    np.testing.assert_array_equal(depth, before)


def test_unknown_model_is_a_value_error():
    with pytest.raises(ValueError, match="none, kinect, redwood"):
        noisy_depth(wall(1.0), CAMERA, np.random.default_rng(0), model="d435")


def test_half_of_the_pixels_beside_an_edge_are_lost_and_no_others():
    depth = wall(2.0)
    depth[60:180, 100:220] = 1.0
    lost = drop_edges(depth, depth, CAMERA, np.random.default_rng(0)) == 0
    rim = np.zeros_like(lost)
    rim[59:181, 99:221] = True
    rim[61:179, 101:219] = False
    rim[[59, 59, 180, 180], [99, 220, 99, 220]] = False  # the far corners have no neighbour across the edge
    assert lost[rim].mean() == pytest.approx(0.5, abs=0.07)  # 956 pixels, 4 sigma
    assert not lost[~rim].any()


def test_slanted_surfaces_lose_half_of_their_pixels():
    camera = PinholeCamera.from_size(100, 100, 20.0)
    for angle, share in ((60.0, 0.0), (86.5, 0.5)):
        depth = slanted(camera, np.radians(angle), 3.0)[0]
        depth[depth > 8.0] = 0.0
        lost = drop_edges(depth, depth, camera, np.random.default_rng(0))[5:-5, 40:60] == 0
        assert lost.mean() == pytest.approx(share, abs=0.05)


def test_noise_is_no_edge_and_no_slant():
    depth = wall(8.0)
    depth[60:180, 100:220] = 4.0
    noisy = noisy_depth(depth, CAMERA, np.random.default_rng(0), model="kinect")
    lost = drop_edges(noisy, depth, CAMERA, np.random.default_rng(1)) == 0
    np.testing.assert_array_equal(lost, drop_edges(depth, depth, CAMERA, np.random.default_rng(1)) == 0)
    assert not lost[70:170, 110:210].any()


def test_pose_errors_have_the_stated_spread():
    pose, rng = look_along(np.array([1.0, 2.0, 1.5]), np.array([1.0, 0.5, -0.2])), np.random.default_rng(0)
    noisy = np.stack([noisy_pose(pose, rng, sigma_m=0.02, sigma_deg=0.5) for _ in range(4000)])
    assert np.std(noisy[:, :3, 3] - pose[:3, 3], axis=0) == pytest.approx([0.02] * 3, rel=0.06)
    angle = rotation_angle(noisy, pose)  # length of a Gaussian vector of three: sigma * sqrt(8 / pi) on average
    assert np.degrees(angle).mean() == pytest.approx(0.5 * np.sqrt(8.0 / np.pi), rel=0.04)
    products = noisy[:, :3, :3] @ np.swapaxes(noisy[:, :3, :3], 1, 2)
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), products.shape), atol=1e-12)
    assert noisy_pose(pose, rng, sigma_m=0.0, sigma_deg=0.0) is pose
