import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.protocols import held_out_views as views
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.scenes import load_scene

CAMERA = PinholeCamera.from_size(48, 27)


@pytest.fixture(scope="module")
def box():
    return load_scene("box")


@pytest.fixture(autouse=True)
def fresh_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ASG_CACHE_DIR", str(tmp_path))


def test_views_stand_free_and_look_neither_up_nor_down(box):
    seen = views.free_space_views(ground_truth_of(box), count=24, camera=CAMERA, supersample=1)
    assert len(seen) == 24
    assert (ground_truth_of(box).free_space.clearance_at(seen.world_from_camera[:, :3, 3]) >= 0.3 - 1e-6).all()
    # |sin| of the axis' elevation is at most sin 45 deg, uniform below it.
    elevation = np.abs(seen.world_from_camera[:, 2, 2])
    assert elevation.max() <= np.sin(np.radians(45)) + 1e-9
    assert elevation.max() > 0.4
    assert (seen.depth > 0).all()  # the box has no window
    assert seen.rgb.std() > 10  # something is to be seen


def test_more_views_than_are_ever_drawn_are_refused(box):
    with pytest.raises(InputError, match="at most 1024"):
        views.free_space_views(ground_truth_of(box), count=1025, camera=CAMERA)


def test_fewer_views_are_the_first_of_more(box):
    few = views.free_space_views(ground_truth_of(box), count=3, camera=CAMERA, supersample=1)
    many = views.free_space_views(ground_truth_of(box), count=5, camera=CAMERA, supersample=1)
    np.testing.assert_array_equal(few.world_from_camera, many.world_from_camera[:3])
    np.testing.assert_array_equal(few.rgb, many.rgb[:3])


def test_views_are_rendered_once_per_scene_and_size(box, monkeypatch):
    first = views.free_space_views(ground_truth_of(box), count=3, camera=CAMERA, supersample=2)

    def refuse(*arguments, **options):
        raise AssertionError("rendered again")

    monkeypatch.setattr(views, "drawn_images", refuse)
    again = views.free_space_views(ground_truth_of(box), count=3, camera=CAMERA, supersample=2)
    np.testing.assert_array_equal(first.rgb, again.rgb)
    np.testing.assert_array_equal(first.depth, again.depth)
    for other in ({"count": 4}, {"supersample": 3}, {"camera": PinholeCamera.from_size(48, 28)}):
        with pytest.raises(AssertionError, match="rendered again"):
            views.free_space_views(ground_truth_of(box), **({"count": 3, "camera": CAMERA, "supersample": 2} | other))


def test_another_scene_is_looked_at_from_elsewhere(box):
    other = load_scene("box?seed=5")
    mine = views.free_space_views(ground_truth_of(box), count=2, camera=CAMERA, supersample=1).world_from_camera
    theirs = views.free_space_views(ground_truth_of(other), count=2, camera=CAMERA, supersample=1).world_from_camera
    assert not np.allclose(mine, theirs)


def test_supersampling_averages_and_keeps_the_depth_of_the_centre(box):
    coarse = views.free_space_views(ground_truth_of(box), count=1, camera=CAMERA, supersample=1)
    fine = views.free_space_views(ground_truth_of(box), count=1, camera=CAMERA, supersample=4)
    np.testing.assert_allclose(fine.depth, coarse.depth, atol=1e-5)
    assert 0 < np.abs(fine.rgb.astype(int) - coarse.rgb).mean() < 12


def test_a_scene_without_recorded_views_says_so(box):
    with pytest.raises(InputError, match="without recorded views"):
        views.recorded_views(box, count=3)


def test_recorded_views_of_the_replica_fixture(shared):
    folder = shared / "scenes" / "replica_fixture"
    scene = load_scene(str(folder / "room_fix"), sequence=str(folder / "seq" / "room_fix"))
    recorded = views.recorded_views(scene, count=5)
    assert len(recorded) == 5 and recorded.rgb.shape[1:3] == (recorded.camera.height, recorded.camera.width)
    # The recording and the mesh agree: rendering the mesh from a recorded pose gives the recorded depth.
    from activestructure_gym.sensors.renderer import make_renderer

    _, depth = make_renderer("raycast", scene).render(recorded.camera, recorded.world_from_camera[2], supersample=1)
    assert np.median(np.abs(depth - recorded.depth[2])) < 0.01
