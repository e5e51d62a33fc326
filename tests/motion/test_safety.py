"""The law the rest serves: no executed segment crosses the true mesh, whatever has been seen of it."""

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.motion import MotionConfig, first_blocked, interpolate, path_lengths, plan_path
from activestructure_gym.volume import VoxelVolume

CAMERA = PinholeCamera.from_size(160, 90)
MOTION = MotionConfig()


def explore(caster, bounds, start, rng, *, frames, choose, noise=0.0):
    """An episode: go to the views that ``choose`` names, look every 5th frame, stop where the way turns out blocked.

    Returns the positions [T, 3] and the clearance that was stated for each when it was moved to.
    """
    volume, here = VoxelVolume(bounds), start
    volume.mark_free_sphere(start[:3, 3], 0.45)
    positions, stated = [start[:3, 3]], [0.45]

    def look():
        rays = CAMERA.rays().reshape(-1, 3) @ here[:3, :3].T
        depth = caster.cast(here[:3, 3], rays).distance.reshape(CAMERA.height, CAMERA.width)
        depth = np.where(depth < 10.0, depth, 0.0)
        depth = np.where(depth > 0, depth + noise * depth**2 * rng.normal(size=depth.shape), 0.0).astype(np.float32)
        volume.integrate(Frame(np.zeros((*depth.shape, 3), np.uint8), depth, here, CAMERA), sensor_range=10.0)

    look()
    while len(positions) < frames:
        distances = path_lengths(volume, here[:3, 3], min_clearance=MOTION.min_clearance)
        goal = choose(volume, distances, rng)
        path = plan_path(
            volume, here[:3, 3], goal[:3, 3], min_clearance=MOTION.min_clearance, rng=rng, distances=distances
        )
        if path is None:
            goal, path = look_along(here[:3, 3], rng.normal(size=3)), here[None, :3, 3]
        poses = interpolate(path, here, goal, MOTION)
        assert first_blocked(volume, poses, MOTION.min_clearance, start=here) is None
        done, end = 0, len(poses)
        while done < end and len(positions) < frames:
            here = poses[done]
            done += 1
            positions.append(here[:3, 3])
            stated.append(float(volume.clearance_at(here[None, :3, 3])[0]))
            if done == end or len(positions) % 5 == 0:
                look()
                blocked = first_blocked(volume, poses[done:end], MOTION.min_clearance, start=here)
                end = end if blocked is None else done + blocked
    return np.array(positions), np.array(stated)


def random_views(volume, distances, rng):
    places = distances.reachable
    place = places[rng.integers(len(places))] if len(places) else distances.start
    return look_along(place, rng.normal(size=3))


def crossings(caster, positions):
    starts, ends = positions[:-1], positions[1:]
    moving = np.linalg.norm(ends - starts, axis=1) > 1e-9
    starts, ends = starts[moving], ends[moving]
    return int((caster.occluded(starts, ends, margin=0.0) | caster.occluded(ends, starts, margin=0.0)).sum())


def test_thin_pole_between_two_places_is_never_crossed(cast_boxes):
    bounds, metres = np.array([[0.0, 0.0, 0.0], [6.0, 2.4, 2.4]]), 0.0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        # On the straight line between the places, 3 cm wide: at 5 m every second column of rays can miss it.
        x, y = rng.uniform(2.5, 3.5), 1.2 + rng.uniform(-0.05, 0.05)
        caster = cast_boxes(bounds, ([x - 0.015, y - 0.015, 0], [x + 0.015, y + 0.015, 2.4]))
        places = np.array([[5.2, 1.2, 1.2], [0.8, 1.2, 1.2]])

        def to_and_fro(volume, distances, rng, places=places):
            # Towards the far place as far as is known, looking anywhere.
            far = places[np.argmax(np.linalg.norm(places - distances.start, axis=1))]
            known = np.vstack([distances.reachable, distances.start])
            return look_along(known[np.argmin(np.linalg.norm(known - far, axis=1))], rng.normal(size=3))

        start = look_along(places[1], np.array([1.0, 0.0, 0.0]))
        positions, stated = explore(caster, bounds, start, rng, frames=150, choose=to_and_fro)
        assert crossings(caster, positions) == 0
        metres += np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()
        # The pole was passed or stood before, and kept away from by the clearance less one voxel.
        beside = np.hypot(positions[:, 0] - x, positions[:, 1] - y) - 0.015 * np.sqrt(2)
        assert beside.min() > MOTION.min_clearance - 0.1
    assert metres > 50.0


@pytest.mark.parametrize("noise", [0.0, 0.0019])  # sigma / z^2 of a Kinect
def test_random_episodes_in_a_cluttered_room_keep_clear_of_everything(noise, cast_boxes):
    rng = np.random.default_rng(1)
    bounds, metres = np.array([[0.0, 0.0, 0.0], [5.0, 4.0, 2.5]]), 0.0
    tables = [(c + [0, 0, 0.70], c + [0.9, 0.6, 0.72]) for c in rng.uniform([0, 0, 0], [4, 3.3, 0], (4, 3))]
    legs = [(c, c + [0.03, 0.03, 1.9]) for c in rng.uniform([1.5, 0, 0], [5, 4, 0], (6, 3))]
    caster = cast_boxes(bounds, *tables, *legs, ([3.0, 1.0, 0.0], [3.05, 4.0, 2.5]))
    for seed in range(4):
        rng = np.random.default_rng(seed)
        start = look_along(np.array([0.8, 2.0, 1.5]), np.array([1.0, 0.0, 0.0]))
        positions, stated = explore(caster, bounds, start, rng, frames=120, choose=random_views, noise=noise)
        assert crossings(caster, positions) == 0
        metres += np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()
        assert stated.min() >= MOTION.min_clearance - 0.05
        for lower, upper in (*tables, *legs):
            gap = np.linalg.norm(np.maximum(np.maximum(lower - positions, positions - upper), 0), axis=1)
            assert (gap >= MOTION.min_clearance - 0.1).all()
    assert metres > 15.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hotel_room.glb", "bookstore.glb"])
def test_random_episodes_in_scanned_scenes_cross_nothing(name, shared):
    from activestructure_gym.scenes.library import load_scene

    scene, metres = load_scene(shared / "scenes" / name, up="z"), 0.0
    for seed, start in enumerate(ground_truth_of(scene).free_space.start_poses[:6]):
        positions, _ = explore(
            scene.raycaster, scene.bounds, start, np.random.default_rng(seed), frames=100, choose=random_views
        )
        assert crossings(scene.raycaster, positions) == 0
        metres += np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()
    assert metres > 20.0
