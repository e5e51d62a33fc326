import dataclasses
import re

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.metrics import SurfaceSamples
from activestructure_gym.evaluation.metrics.geometry import completion_distances
from activestructure_gym.evaluation.protocols import CameraPath, StandardProtocol, Truth, protocol_from
from activestructure_gym.evaluation.protocols.held_out_views import HeldOutViews
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.mapping import GaussianMap
from activestructure_gym.scenes import load_scene

PROTOCOL = StandardProtocol(views=2, view_width=32, view_height=18)


def gaussians(means: np.ndarray, *, opacity: float, sigma: float = 0.04, grey: float = 0.5) -> np.ndarray:  # [14, n]
    block = np.zeros((14, len(means)), np.float32)
    block[0:3] = means.T
    block[3] = 1.0
    block[7:10] = np.log([[sigma], [sigma], [0.001]])  # disks that face the cameras
    block[10] = np.log(opacity / (1 - opacity))
    block[11:14] = grey
    return block


@pytest.fixture(scope="module")
def wall() -> Truth:
    """A grey wall one metre in front of two cameras, which see nothing else."""
    grid = np.stack(np.meshgrid(np.linspace(-1.5, 1.5, 61), np.linspace(-1, 1, 41)), axis=-1).reshape(-1, 2)
    points = np.column_stack([grid, np.ones(len(grid))])
    camera = PinholeCamera.from_size(32, 18)
    views = HeldOutViews(
        camera=camera,
        world_from_camera=np.stack([np.eye(4), np.eye(4)]),
        rgb=np.full((2, 18, 32, 3), 128, np.uint8),
        depth=np.ones((2, 18, 32), np.float32),
    )
    return Truth(SurfaceSamples(points, np.tile([0.0, 0.0, -1.0], (len(points), 1)), 6.0), views)


def test_a_map_of_the_whole_wall(wall):
    solid = GaussianMap()
    solid.append(gaussians(wall.surface.points, opacity=0.95))
    scores = PROTOCOL.evaluate(solid, wall)
    assert scores["completion_ratio"] == scores["precision"] == scores["f_score"] == 100.0
    assert scores["accuracy_cm"] == pytest.approx(0.0, abs=1e-4)
    assert scores["psnr"] > 35 and scores["ssim"] > 0.95
    assert scores["depth_l1_cm"] < 1.0
    assert scores["view_coverage"] == 1.0
    assert len(scores["views"]) == 2


def test_transparent_gaussians_are_no_reconstructed_points(wall):
    thin = GaussianMap()
    thin.append(gaussians(wall.surface.points, opacity=0.49))
    scores = PROTOCOL.evaluate(thin, wall)
    assert scores["completion_ratio"] == 0.0 and scores["accuracy_cm"] is None
    assert scores["view_coverage"] > 0.9  # many thin ones still cover the image
    more_lenient = dataclasses.replace(PROTOCOL, opacity_threshold=0.4)
    assert more_lenient.evaluate(thin, wall)["completion_ratio"] == 100.0


def test_floaters_lower_accuracy_precision_and_psnr(wall, rng):
    block = gaussians(wall.surface.points, opacity=0.95)
    floating = gaussians(rng.uniform([-0.6, -0.3, 0.4], [0.6, 0.3, 0.7], (100, 3)), opacity=0.9, grey=1.0)
    clean, dirty = GaussianMap(), GaussianMap()
    clean.append(block)
    dirty.append(np.hstack([block, floating]))
    before, after = PROTOCOL.evaluate(clean, wall), PROTOCOL.evaluate(dirty, wall)
    # 100 of 2601 points, 45 cm before the wall on average.
    assert after["accuracy_cm"] - before["accuracy_cm"] == pytest.approx(45 * 100 / 2601, rel=0.1)
    assert after["precision"] == pytest.approx(100 * 2501 / 2601, abs=0.2)
    assert after["completion_ratio"] == 100.0
    assert after["psnr"] < before["psnr"] - 3


def test_an_empty_map_has_defined_numbers(wall):
    scores = PROTOCOL.evaluate(GaussianMap(), wall)
    assert scores["completion_ratio"] == scores["precision"] == scores["view_coverage"] == 0.0
    assert scores["depth_l1_cm"] == pytest.approx(100.0)  # a hole counts with the whole metre
    assert scores["psnr"] == pytest.approx(-20 * np.log10(128 / 255), abs=1e-4)  # black against grey


def test_a_checkpoint_agrees_with_the_full_measurement(wall):
    half = GaussianMap()
    half.append(gaussians(wall.surface.points[wall.surface.points[:, 0] < 0], opacity=0.95))
    full = PROTOCOL.evaluate(half, wall)
    quick = PROTOCOL.checkpoint(half, wall, images=True, samples=10**6)
    assert quick["completion_ratio"] == full["completion_ratio"]
    assert quick["psnr"] == full["psnr"] and quick["depth_l1_cm"] == full["depth_l1_cm"]
    assert "psnr" not in PROTOCOL.checkpoint(half, wall, images=False, samples=500)
    rough = PROTOCOL.checkpoint(half, wall, images=False, samples=500)
    assert rough["completion_ratio"] == pytest.approx(full["completion_ratio"], abs=5)


def test_the_same_map_gives_the_same_bits(wall, rng):
    noisy = GaussianMap()
    noisy.append(gaussians(wall.surface.points + rng.normal(scale=0.02, size=wall.surface.points.shape), opacity=0.8))
    assert PROTOCOL.evaluate(noisy, wall) == PROTOCOL.evaluate(noisy, wall)


def test_every_parameter_is_written_down():
    parameters = PROTOCOL.parameters()
    assert parameters["name"] == "standard" and parameters["version"] == 5
    assert {field.name for field in dataclasses.fields(PROTOCOL)} <= parameters.keys()


@pytest.mark.parametrize(
    "change",
    [
        {"opacity_threshold": 1.0},
        {"threshold_m": 0.0},
        {"views": 0},
        {"view_height": 10},
        {"view_source": "dreams"},
    ],
)
def test_parameters_that_mean_nothing_are_refused(change):
    with pytest.raises(InputError):
        StandardProtocol(**change)


def test_without_poses_or_a_mesh_nobody_knows_what_was_observed(wall):
    scores = PROTOCOL.evaluate(GaussianMap(), wall)
    assert scores["observed"] is None and "poses" in scores["notes"]["observed"]
    path = CameraPath(wall.views.camera, np.eye(4), np.eye(4)[None])
    assert "mesh" in PROTOCOL.evaluate(GaussianMap(), wall, path)["notes"]["observed"]
    assert "observed" not in PROTOCOL.checkpoint(GaussianMap(), wall, path, images=False, samples=10)


def test_a_checkpoint_says_how_many_means_lie_on_the_surface(wall):
    solid = GaussianMap()
    solid.append(gaussians(wall.surface.points, opacity=0.95))
    assert "precision" not in PROTOCOL.checkpoint(GaussianMap(), wall, images=False, samples=100)
    everything = PROTOCOL.checkpoint(solid, wall, images=False, samples=10**6)
    assert everything["precision"] == 100.0 and everything["accuracy_cm"] == pytest.approx(0.0, abs=1e-4)
    off = wall.surface.points + np.where(np.arange(len(wall.surface.points)) % 4 == 0, 0.2, 0.01)[:, None] * (
        wall.surface.normals
    )
    astray = GaussianMap()
    astray.append(gaussians(off, opacity=0.95))
    found = PROTOCOL.checkpoint(astray, wall, images=False, samples=10**6)
    full = PROTOCOL.evaluate(astray, wall)
    assert found["precision"] == pytest.approx(full["precision"]) == pytest.approx(100 * 1875 / 2501)
    assert found["accuracy_cm"] == pytest.approx(full["accuracy_cm"]) and 5.0 < found["accuracy_cm"] < 6.0


def test_no_part_of_a_large_surface_lies_far_from_its_samples_by_chance():
    side = 3.0  # metres: of 2,000 samples, as of 200,000 on 900 m^2, 1.7 lie within 5 cm of a place on average
    corners = np.array([[0.0, 0.0, 0.0], [side, 0.0, 0.0], [side, side, 0.0], [0.0, side, 0.0]])
    floor = corners[[[0, 1, 2], [0, 2, 3]]]
    truth = np.column_stack([np.random.default_rng(1).uniform(0.1, side - 0.1, (20_000, 2)), np.zeros(20_000)])
    surface = SurfaceSamples(truth, np.tile([0.0, 0.0, 1.0], (len(truth), 1)), side * side)
    ratios = []
    for protocol in (
        StandardProtocol(surface_samples=2000),
        StandardProtocol(surface_samples=2000, tsdf_samples_per_m2=0),
    ):
        points = np.concatenate(list(protocol.on_surface(lambda: [floor]).pieces()))
        again = np.concatenate(list(protocol.on_surface(lambda: [floor[:1], floor[1:]]).pieces()))
        assert (points[:, 2] == 0).all() and np.array_equal(points, again)
        ratios.append((completion_distances(surface, points) < protocol.threshold_m).mean())
    assert ratios[0] == 1.0 and ratios[1] == pytest.approx(1 - np.exp(-2000 / side**2 * np.pi * 0.05**2), abs=0.02)
    assert StandardProtocol().on_surface(lambda: [floor]).count == 200_000  # enough for 9 m^2


def test_a_surface_that_cannot_be_fused_is_none_with_a_reason_and_all_else_is_measured(wall, monkeypatch):
    monkeypatch.setattr("activestructure_gym.evaluation.metrics.fusion.MAX_BLOCKS", 10)
    solid = GaussianMap()
    solid.append(gaussians(wall.surface.points, opacity=0.95))
    path = CameraPath(wall.views.camera, np.eye(4), np.eye(4)[None])
    scores = PROTOCOL.evaluate(solid, wall, path)
    assert scores["tsdf_completion_ratio"] is None and scores["tsdf_area_m2"] is None
    assert scores["notes"]["tsdf"] == "the surface needs more than 10 blocks of 8 x 8 x 8 voxels of 0.02 m"
    assert scores["completion_ratio"] == 100.0


def test_a_surface_of_too_many_blocks_is_refused_before_the_first_frame(monkeypatch):
    monkeypatch.setattr("activestructure_gym.evaluation.metrics.fusion.MAX_BLOCKS", 1000)
    known = ground_truth_of(load_scene("box"))
    few = StandardProtocol(views=1, view_width=32, view_height=18, surface_samples=2000)
    with pytest.raises(InputError, match=r"m2 of surface in scene 'box-0' need about [0-9,]+ blocks") as refusal:
        few.truth(known)
    least = float(re.search(r"a tsdf_voxel_m of at least ([0-9.]+)", str(refusal.value))[1])
    assert 0.02 < least < 1.0
    dataclasses.replace(few, tsdf_voxel_m=least, tsdf_truncation_m=max(least, 0.06)).truth(known)
    dataclasses.replace(few, points_source="means").truth(known)


def test_a_protocol_is_read_as_it_was_written_and_no_other_version_is():
    assert protocol_from(PROTOCOL.parameters()) == PROTOCOL
    ones = ", ".join(f"'{name}' version 1" for name in ("naruto", "offline"))
    known = f"this version knows 'activegamer' version 2, 'activesplat' version 2, {ones}, 'standard' version 5"
    with pytest.raises(InputError, match=f"made with protocol 'standard' version 4, {known}"):
        protocol_from(PROTOCOL.parameters() | {"version": 4})
