"""The contract of every candidate source, and what each one promises by itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.config import configure
from activestructure_gym.errors import InputError
from activestructure_gym.features.voxel_errors import voxel_colour_errors
from activestructure_gym.geometry import rotation_angle
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.reconstruction import Reconstruction
from activestructure_gym.scenes import load_scene
from activestructure_gym.sources import SOURCES, Proposals, Source, SourceContext, facing, make_source
from activestructure_gym.sources.facing import (
    FrontierFacing,
    UnsureFacing,
    _rank_within,
    camera_positions,
    frontier_cells,
)
from activestructure_gym.sources.places import looking
from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN, VoxelVolume
from tests.policies.test_contracts import make_scene, swap_truth

SMALL = {"sensor": {"width": 64, "height": 36}, "keyframe_every": 5, "frame_budget": 60}


TURNS = "turns?count=7"


def begin(*stages: tuple[str, ...], seed: int = 0, scene: str = "box", **changes: Any) -> Reconstruction:
    config = configure("fast", {**SMALL, "views": {"stages": stages, "max_candidates": 96}, **changes})
    run = Reconstruction(config)
    run.start(ground_truth_of(load_scene(scene)), seed)
    return run


def rows_of(run: Reconstruction, name: str) -> np.ndarray:
    place = list(dict.fromkeys(source for stage in run.config.views.stages for source in stage)).index(name)
    return np.nonzero((run.candidates.source == place) & (run.candidates.ask < 0))[0]


@pytest.fixture(params=sorted(SOURCES))
def spec(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return f"{name}?rows=40" if make_source(name).rows > 90 and name != "pool" else name


def test_every_source_offers_reachable_level_views_and_the_same_for_the_same_seed(spec: str) -> None:
    first, again, other = begin((spec, TURNS)), begin((spec, TURNS)), begin((spec, TURNS), seed=3)
    for run in (first, again, other):
        run.move_to(int(rows_of(run, TURNS)[3]))
    rows, table = rows_of(first, spec), first.candidates
    assert 1 <= len(rows) <= make_source(spec).rows
    poses = table.world_from_camera[rows]
    np.testing.assert_array_equal(poses, again.candidates.world_from_camera[rows_of(again, spec)])
    assert np.isfinite(table.path_length[rows]).all()
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (len(rows), 1, 1)), atol=1e-9
    )
    assert np.abs(poses[:, 2, 0]).max() < 1e-9  # no roll
    here = np.linalg.norm(poses[:, :3, 3] - first.pose[:3, 3], axis=1) < 1e-6
    clear = first.volume.clearance_at(poses[:, :3, 3]) >= first.config.motion.candidate_clearance
    assert (here | clear).all()


def test_no_source_knows_the_true_mesh(spec: str) -> None:
    config = configure("fast", {**SMALL, "views": {"stages": ((spec, TURNS),), "max_candidates": 96}})
    run = Reconstruction(config)
    run.start(ground_truth_of(make_scene()), 0)
    for _ in range(3):
        run.move_to(int(rows_of(run, TURNS)[2]))
    run._offer()
    before = run.candidates
    swap_truth(SimpleNamespace(reconstruction=run))  # type: ignore[arg-type]
    run._offer()
    assert len(rows_of(run, spec))
    np.testing.assert_array_equal(run.candidates.world_from_camera, before.world_from_camera)
    np.testing.assert_array_equal(run.candidates.path_length, before.path_length)


def test_the_swap_finds_a_source_that_peeks() -> None:
    run = Reconstruction(configure("fast", {**SMALL, "views": {"stages": ((TURNS,),), "max_candidates": 96}}))
    run.start(ground_truth_of(make_scene()), 0)

    @dataclass(frozen=True)
    class Peeking(Source):
        rows: int = 3

        def propose(self, context: SourceContext) -> Proposals:
            run.scene.raycaster.depth(context.camera, context.agent.pose[None])
            return Proposals(context.agent.pose[None])

    swap_truth(SimpleNamespace(reconstruction=run))  # type: ignore[arg-type]
    run._sources = {TURNS: Peeking()}
    with pytest.raises(AssertionError, match="asked the ground truth for"):
        run._offer()


def test_a_source_changes_nothing_for_the_pool_beside_it(spec: str) -> None:
    plain, beside = begin(("pool",)), begin(("pool",), (spec if spec != "pool" else "turns",))
    assert beside.candidates.ask[-1] == 1 and (beside.candidates.ask[:-1] < 0).all()
    count = min(len(plain.candidates), beside.candidates.views)
    np.testing.assert_array_equal(plain.candidates.ids[:count], beside.candidates.ids[:count])


def test_the_lattice_is_exact_and_leaves_out_where_it_has_been() -> None:
    run = begin(("lattice?spacing_m=0.5&directions=5&rows=90",))
    start = run.trajectory[0][:3, 3]
    steps = (run.candidates.world_from_camera[:, :3, 3] - start) / [0.5, 0.5, 1.0]
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    at_start = np.linalg.norm(run.candidates.world_from_camera[:, :3, 3] - start, axis=1) < 1e-9
    assert at_start.sum() == 5  # no jitter, no draw: all directions of the place it stands at
    chosen = run.candidates.world_from_camera[np.nonzero(at_start)[0][2]]
    run.move_to(int(np.nonzero(at_start)[0][2]))
    now = run.candidates.world_from_camera
    same = (np.linalg.norm(now[:, :3, 3] - start, axis=1) < 1e-9) & (rotation_angle(now, chosen) < 1e-6)
    assert not same.any()


def test_heights_of_the_lattice_count_from_the_camera_or_from_the_floor() -> None:
    for options in ("heights_m=0", "heights_m=1.3&from_floor=true"):
        spec = f"lattice?spacing_m=0.5&directions=2&rows=60&{options}"
        run = begin((spec, TURNS))
        for _ in range(3):  # where it has looked there are free places, on every processor
            run.move_to(int(rows_of(run, TURNS)[3]))
        heights = run.candidates.world_from_camera[rows_of(run, spec), 2, 3] - run.scene.bounds[0, 2]
        wanted = 1.3 if "floor" in options else run.trajectory[0][2, 3] - run.scene.bounds[0, 2]
        assert len(heights) > 3 and abs(wanted - 1.3) < 0.2
        np.testing.assert_allclose(heights, wanted, atol=1e-9)


def test_a_place_of_the_lattice_that_was_once_free_stays() -> None:
    spec = "lattice?spacing_m=0.5&directions=1&rows=400&from_occupied_m=0.6"
    config = {**SMALL, "views": {"stages": ((spec, TURNS),), "max_candidates": 408}}
    run = Reconstruction(configure("fast", {**config, "motion.candidate_clearance": 0.1, "motion.min_clearance": 0.1}))
    run.start(ground_truth_of(make_scene()), 0)
    before = np.zeros((0, 3))
    for _ in range(4):
        places = run.candidates.world_from_camera[rows_of(run, spec), :3, 3]
        assert (np.abs(before[:, None] - places).max(axis=2).min(axis=1, initial=np.inf) < 1e-9).all()
        before = places
        run.move_to(int(rows_of(run, TURNS)[3]))
    occupied = run.volume.center_of(np.argwhere(run.volume.occupied))
    gap = np.linalg.norm(before[:, None] - occupied, axis=2).min(axis=1)
    assert gap.min() < 0.55  # surface that was seen later is nearer than 0.6 m


def test_around_stays_in_its_ball_and_turns_on_its_place() -> None:
    run = begin(("around?radius_m=0.4&rows=30", "turns?count=6"))
    offset = run.candidates.world_from_camera[:, :3, 3] - run.pose[:3, 3]
    assert 0.2 < np.linalg.norm(offset[rows_of(run, "around?radius_m=0.4&rows=30")], axis=1).max() <= 0.4
    turns = run.candidates.world_from_camera[rows_of(run, "turns?count=6")]
    assert np.abs(offset[rows_of(run, "turns?count=6")]).max() == 0.0
    np.testing.assert_allclose(np.degrees(rotation_angle(turns[1:], turns[:-1])), 60.0, atol=1e-6)
    ahead = run.pose[:3, 2].copy()
    ahead[2] = 0.0
    np.testing.assert_allclose(turns[0, :3, 2], ahead / np.linalg.norm(ahead), atol=1e-9)


def test_views_of_the_frontier_face_unobserved_space_and_see_it() -> None:
    run = begin(("frontier_facing?rows=40", "turns"))
    rows = rows_of(run, "frontier_facing?rows=40")
    poses, volume = run.candidates.world_from_camera[rows], run.volume
    cells = np.argwhere(frontier_cells(volume))
    centres = volume.origin + (cells + 0.5) * 2 * volume.voxel_size
    for pose in poses:
        away = centres - pose[:3, 3]
        far = np.linalg.norm(away, axis=1)
        ahead = (far >= 0.3) & (far <= 2.0 + 1e-9) & (away @ pose[:3, 2] >= far * (1 - 1e-9))
        assert ahead.any() and volume.line_of_sight_free(pose[:3, 3], centres[ahead]).any()


@pytest.mark.parametrize(("wall", "frontier"), [(None, True), (30, False), (31, False)])
def test_a_wall_is_no_frontier_wherever_its_surface_lies_in_a_cell(wall: int | None, frontier: bool) -> None:
    volume = VoxelVolume(np.array([[-2.0] * 3, [2.0] * 3]))
    volume.state[:31] = FREE
    volume.state[30] = UNKNOWN
    if wall is not None:
        volume.state[30] = FREE
        volume.state[wall] = OCCUPIED  # in the near or the far voxel layer of cell 15
    assert frontier_cells(volume).any() == frontier


def test_a_frontier_is_the_last_empty_cell_before_unobserved_space(monkeypatch: pytest.MonkeyPatch) -> None:
    """A place 1.9 m from it is near enough, though the unobserved cell behind it is 2.1 m away."""
    volume = VoxelVolume(np.array([[-2.0] * 3, [2.0] * 3]))
    volume.state[:30] = FREE  # cells 0 to 14
    here = SimpleNamespace(pose=np.eye(4))
    context: Any = SimpleNamespace(volume=volume, agent=here, rng=np.random.default_rng(0))
    centres, normals = FrontierFacing().foremost(context)
    np.testing.assert_allclose(centres[:, 0], volume.origin[0] + 14.5 * 0.2)
    np.testing.assert_allclose(normals[0], [-1.0, 0.0, 0.0], atol=1e-12)
    for away, rows in ((1.9, 1), (2.1, 0)):
        place = centres[0] - [away, 0.0, 0.0]
        monkeypatch.setattr(facing, "camera_positions", lambda context, place=place: place[None])
        region = FrontierFacing(rows=1)
        monkeypatch.setattr(FrontierFacing, "foremost", lambda self, context: (centres[:1], normals[:1]))
        assert len(region.propose(context)) == rows


def test_places_to_stand_keep_to_the_heights_of_cameras() -> None:
    run = begin(("turns",))
    seen: dict[str, Any] = {}

    @dataclass(frozen=True)
    class Look(Source):
        rows: int = 1

        def propose(self, context):
            seen["places"] = camera_positions(context)
            return Proposals(context.agent.pose[None])

    run._sources = {"turns": Look()}
    run._offer()
    assert len(seen["places"]) > 10 and (run.volume.state_at(seen["places"]) == FREE).all()
    assert np.ptp(seen["places"][:, 2]) < 1e-9  # heights_m = (0,) in `fast`


def test_all_known_space_has_no_frontier() -> None:
    run = begin(("frontier_facing", "turns"))
    run.volume.state[:] = FREE
    run.volume._changed()
    run._refresh()
    assert len(rows_of(run, "frontier_facing")) == 0 and len(rows_of(run, "turns")) == 8


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("lattise", "did you mean 'lattice'"),
        ("turns?count=0", "count must be a whole number from 1 to 360"),
        ("around?radius=2", "unknown option 'radius' of source 'around'"),
        ("stay?rounds=-1", "rounds must be"),
        ("roi?nearest_m=nan", "nearest_m must be"),
    ],
)
def test_what_cannot_be_a_source_is_said(spec: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_source(spec)


def test_proposals_are_checked() -> None:
    with pytest.raises(InputError, match=r"poses \[n, 4, 4\]"):
        Proposals(np.zeros((3, 4)))
    with pytest.raises(InputError, match="finite poses; 1 of 2 have NaN"):
        Proposals(np.stack([np.eye(4), np.full((4, 4), np.nan)]))
    assert len(Proposals(np.array([]))) == 0  # of an empty list of poses
    with pytest.raises(InputError, match="points to look at"):
        Proposals(np.tile(np.eye(4), (2, 1, 1)), look_at=np.zeros((1, 3)))
    with pytest.raises(InputError, match=r"path_length must be \[2\], one per pose, got \(1,\)"):
        Proposals(np.tile(np.eye(4), (2, 1, 1)), path_length=np.zeros(1))
    with pytest.raises(InputError, match=r"revisit must be \[2\], one per pose, got \(\)"):
        Proposals(np.tile(np.eye(4), (2, 1, 1)), revisit=True)
    whole = Proposals(np.tile(np.eye(4), (2, 1, 1)), revisit=[0, 1]).revisit  # ~ of whole numbers is no mask
    assert whole.dtype == bool and whole.tolist() == [False, True]


@dataclass(frozen=True)
class Wrong(Source):
    """Proposes what no table can take."""

    kind: str = "list"
    rows: int = 3

    def propose(self, context: SourceContext) -> Proposals:
        poses = np.tile(context.agent.pose, (3, 1, 1))
        if self.kind == "list":
            return list(poses)  # type: ignore[return-value]
        turns = {"rolled": Rotation.from_euler("z", 10, degrees=True).as_matrix(), "larger": 2 * np.eye(3)}
        poses[1, :3, :3] = poses[1, :3, :3] @ turns.get(self.kind, np.diag([-1.0, -1.0, 1.0]))
        return Proposals(poses)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("list", r"propose\(\) of the source .*Wrong\?kind=list' must return Proposals, got list"),
        ("rolled", r"1 of the 3 poses of the source .* not rotations or have roll.*look_along"),
        ("upside_down", "1 of the 3 poses"),
        ("larger", "1 of the 3 poses"),
    ],
)
def test_what_a_source_may_not_propose_is_said_with_its_name(kind: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        begin((f"tests.sources.test_sources:Wrong?kind={kind}",))


def test_rank_within_counts_equals_before_each() -> None:
    np.testing.assert_array_equal(_rank_within(np.array([4, 1, 4, 4, 1, 0])), [0, 0, 1, 2, 1, 0])


def look_round(*stages: tuple[str, ...]) -> Reconstruction:
    """A run that has turned all around on its place, by the source `TURNS` of the first stage."""
    run = begin(*stages, scene="room", frame_budget=200)
    for _ in range(7):
        run.move_to(int(rows_of(run, TURNS)[1]))
    return run


def test_views_that_keep_apart_reach_farther(monkeypatch: pytest.MonkeyPatch) -> None:
    near, apart = "frontier_facing?rows=30", "frontier_facing?rows=30&apart_m=1"
    run = look_round((TURNS, near, apart))
    faced: list[np.ndarray] = []

    def noted(places: np.ndarray, along: np.ndarray) -> np.ndarray:
        faced.append(places[0] + along[0])
        return looking(places, along)

    monkeypatch.setattr(facing, "looking", noted)

    def regions(name: str) -> np.ndarray:  # [R, 3] that have views
        faced.clear()
        run._sources = {one: make_source(one) for one in (TURNS, name)}
        run.config = replace(run.config, views=replace(run.config.views, stages=((TURNS, name),)))
        run._offer()
        return np.array(faced)

    nearest, spread = regions(near), regions(apart)
    cubes = np.floor((spread - run.volume.origin) / 1.0)
    assert len(np.unique(cubes, axis=0)) == len(spread) > 3
    reach = [float(np.linalg.norm(found - run.pose[:3, 3], axis=1).max()) for found in (nearest, spread)]
    assert reach[1] > reach[0]


def test_the_worst_rendered_surface_is_faced_first() -> None:
    spec = "unsure_facing?rows=10"
    run = look_round((TURNS, spec))
    errors = voxel_colour_errors(run.mapper, run.volume)
    seen: dict[str, np.ndarray] = {}

    @dataclass(frozen=True)
    class Look(UnsureFacing):
        def foremost(self, context):
            seen["centres"], seen["normals"] = super().foremost(context)
            return seen["centres"], seen["normals"]

    run._sources = {TURNS: make_source(TURNS), spec: Look(rows=10)}
    run._offer()
    faced = errors[tuple(run.volume.voxel_of(seen["centres"]).T)]
    assert len(faced) > 10 and (np.diff(faced) <= 0).all() and faced.min() > errors[errors > 0].mean()
    poses = run.candidates.world_from_camera[rows_of(run, spec)]
    ways = seen["centres"] - poses[0, :3, 3]
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    target = int((ways @ poses[0, :3, 2]).argmax())
    assert ways[target] @ poses[0, :3, 2] > 1.0 - 1e-9 and ways[target] @ seen["normals"][target] <= -0.5 + 1e-9


def test_a_robot_on_wheels_stays_at_its_height_and_looks_all_around() -> None:
    spec = "floor?yaws=4&spacing_m=0.5&rows=80"
    run = begin((spec, TURNS), scene="room")
    start = run.trajectory[0][:3, 3]

    def views() -> np.ndarray:
        return run.candidates.world_from_camera[rows_of(run, spec)]

    steps = (views()[:, :2, 3] - start[:2]) / 0.5
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    np.testing.assert_allclose(views()[:, 2, 3], start[2])
    np.testing.assert_allclose(np.abs(views()[:, :2, 2]).max(axis=1), 1.0)  # along x or y, and level
    chosen = views()[-1]
    run.move_to(int(rows_of(run, spec)[-1]))
    np.testing.assert_allclose(run.pose, chosen, atol=1e-6)
    near = np.linalg.norm(views()[:, :3, 3] - chosen[:3, 3], axis=1) < 1e-6
    assert near.sum() == 3  # without the view where it has been


@pytest.mark.parametrize(("option", "left"), [("", [3, 3]), ("&visited=true", [3, 4])])
def test_a_visited_view_is_offered_again_on_request_once_the_robot_has_left_it(option: str, left: list[int]) -> None:
    spec = f"floor?yaws=4&spacing_m=0.5&rows=80{option}"
    run = begin((spec, TURNS), scene="room")
    run.move_to(int(rows_of(run, spec)[-1]))
    place, counts = run.pose[:3, 3].copy(), []
    for _ in left:
        views = run.candidates.world_from_camera[rows_of(run, spec)]
        away = np.linalg.norm(views[:, :3, 3] - place, axis=1)
        counts.append(int((away < 1e-6).sum()))
        run.move_to(int(rows_of(run, spec)[away.argmax()]))
    assert counts == left
