import numpy as np
import pytest

from activestructure_gym.evaluation.benchmarks.workload import make_workload
from activestructure_gym.geometry import PinholeCamera, invert_rigid, se3_exp
from activestructure_gym.splatting import counters, kernels, layout
from activestructure_gym.splatting.workspace import Workspace, inverse_of_pose, make_grid, make_view


def test_inverse_of_pose_is_that_of_any_rigid_motion():
    for seed in range(5):
        pose = se3_exp(np.random.default_rng(seed).normal(size=6))
        np.testing.assert_allclose(inverse_of_pose(pose), invert_rigid(pose)[:3], atol=1e-15)


def test_a_view_does_not_share_memory_with_the_next_one_of_its_camera():
    camera = PinholeCamera.from_size(40, 30)
    first = make_view(camera, np.eye(4), max_alpha=0.5)
    before = first.copy()
    make_view(camera, se3_exp(np.ones(6)))
    np.testing.assert_array_equal(first, before)


def _prepared(threads):
    work, workspace = make_workload("W1"), Workspace()
    workspace.prepare(work.parameters, work.count, work.camera, inverse_of_pose(work.poses[0]), threads=threads)
    return work, workspace


@pytest.mark.parametrize("lost", ["while projecting", "while listing"])
def test_preparing_ends_without_a_thread_that_lost_its_core_and_goes_on_with_it(lost):
    work, workspace = _prepared(threads=1)
    entries, starts = workspace.entries[: layout.SORTED_REACH, : workspace.total].copy(), workspace.tile_start.copy()
    grid, tickets = make_grid(work.count, work.parameters.shape[1], work.camera), np.zeros(counters.TICKETS, np.int64)
    chunks = grid[layout.CHUNKS]
    lists, counts = workspace.lists, (workspace._buffers["histogram"], workspace._buffers["chunk entries"])
    workspace.entries[:] = 0
    if lost == "while projecting":
        tickets[0] = 1  # the first chunk is in the hands of somebody who does not go on
        kernels.prepare(tickets, work.parameters, lists, *counts)
        assert tickets[counters.GIVEN_UP] == 1
        assert tickets[counters.PROJECTED] == chunks - 1 and tickets[counters.FILLED] == 0
        tickets[0] = tickets[counters.GIVEN_UP] = 0
        tickets[counters.PROJECTED] = 0
    else:
        no_room = lists._replace(entries=np.empty((layout.ENTRY_ROWS, 0), np.uint64))
        kernels.prepare(tickets, work.parameters, no_room, *counts)
        assert tickets[counters.ENTRIES] == workspace.total and tickets[counters.FILLED] == 0
    kernels.prepare(tickets, work.parameters, lists, *counts)
    assert tickets[counters.FILLED] == chunks
    np.testing.assert_array_equal(workspace.tile_start, starts)
    keys = workspace.entries[layout.KEY, : workspace.total]
    np.testing.assert_array_equal(keys, entries[layout.KEY])


def test_an_empty_map_is_prepared_and_rendered():
    camera, workspace = PinholeCamera.from_size(40, 30), Workspace()
    workspace.render(np.zeros((14, 16), np.float32), 0, camera, np.eye(4), threads=2)
    assert workspace.total == 0
    assert not any(picture.any() for picture in workspace.pictures())
