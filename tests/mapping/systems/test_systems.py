"""What every mapper with an optimiser of its own keeps to: `Mapper`'s protocol, and same frames, same bytes."""

import dataclasses

import numpy as np
import pytest
import torch

from activestructure_gym import ReconstructionEnv
from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import MAPPERS, BaseMapperConfig, MapperConfig
from tests.mapping.conftest import ROOM

SYSTEMS = [name for name in MAPPERS if type(MAPPERS.get(name)) is not MapperConfig]
SPLATTING = [name for name in SYSTEMS if name != "co_slam"]  # whose Gaussians live on from event to event
# A first keyframe counts for twenty, which is more than a wall needs.
QUICK = {"co_slam": {"first_rounds": 5, "surface_m": 0.1}}


def _mapper(name, seed=0, **changes):
    config = dataclasses.replace(MAPPERS.get(name), **changes)
    return config.make(np.random.default_rng(seed), np.array([np.zeros(3), ROOM]))


def _mapped(name, frames, **changes):
    mapper = _mapper(name, **changes)
    reports = [mapper.observe(frame) for frame in frames]
    return mapper, reports


@pytest.mark.parametrize("name", SYSTEMS)
def test_same_frames_same_bytes_with_any_number_of_threads(name, room_frames):
    found, usual = [], torch.get_num_threads()
    for threads in (2, 1):
        torch.set_num_threads(threads)
        mapper, reports = _mapped(name, room_frames[:3], iterations=3, **QUICK.get(name, {}))
        found.append((mapper.map.parameters[:, : mapper.map.count].tobytes(), repr(reports)))
        assert torch.get_num_threads() == threads
    torch.set_num_threads(usual)
    assert found[0] == found[1]


@pytest.mark.parametrize("name", SPLATTING)
def test_a_report_says_what_happened(name, room_frames):
    mapper, reports = _mapped(name, room_frames[:3], iterations=3)
    count = 0
    for index, report in enumerate(reports):
        count += report.added - report.pruned - report.replaced
        assert report.count == count
        assert report.left_out == 0 and 0 <= report.new_share <= 1
        assert set(report.views) <= set(range(index + 1)) and index in report.views
        assert np.isfinite([report.color_loss, report.depth_loss, report.psnr]).all()
    assert len(mapper.keyframes) == 3 and mapper.map.count == count
    assert len(mapper.keyframe_psnr()) == 3


def _quick(name):
    rounds = {"first_rounds": 1} if hasattr(MAPPERS.get(name), "first_rounds") else {}
    return {"iterations": 1, **QUICK.get(name, {}), **rounds}


@pytest.mark.parametrize("name", list(MAPPERS))
def test_a_depth_that_is_no_number_is_a_pixel_without_a_return(name, room_frames):
    """As ROS marks them. Once, one such pixel had the whole view seeded again."""
    missing, odd = room_frames[0].depth.copy(), room_frames[0].depth.copy()
    missing[4:6, 7:9] = 0.0
    odd[4:6, 7:9] = [[np.nan, np.inf], [-np.inf, np.nan]]
    frames = [[dataclasses.replace(room_frames[0], depth=depth)] * 2 for depth in (missing, odd)]
    (expected, said), (mapper, reports) = (_mapped(name, own, **_quick(name)) for own in frames)
    assert repr(reports) == repr(said)
    assert np.array_equal(
        mapper.map.parameters[:, : mapper.map.count], expected.map.parameters[:, : expected.map.count]
    )


@pytest.mark.parametrize("size", [(1, 1), (40, 1), (1, 40)])
@pytest.mark.parametrize("name", list(MAPPERS))
def test_the_smallest_pictures_are_mapped(name, size):
    camera = PinholeCamera.from_size(*size)
    shape = (camera.height, camera.width)
    pose = look_along(ROOM / 2, np.array([1.0, 0, 0]))
    frame = Frame(np.full((*shape, 3), 90, np.uint8), np.full(shape, 1.5, np.float32), pose, camera)
    mapper, (report,) = _mapped(name, [frame], **_quick(name))
    assert np.isfinite(report.psnr)
    assert mapper.map.count or name in SYSTEMS  # of which some draw a share of the pixels, or need a lattice


@pytest.mark.parametrize("name", SPLATTING)
def test_refining_makes_the_keyframes_look_better(name, room_frames):
    mapper, _ = _mapped(name, room_frames[:3], iterations=3)
    before = mapper.keyframe_psnr(renders=None).mean()
    report = mapper.refine(12)
    assert sorted(report.views) == sorted([0, 1, 2] * 4)
    assert mapper.keyframe_psnr(renders=None).mean() > before
    with pytest.raises(ValueError, match="keyframe indices must lie in 0..2"):
        mapper.refine(1, keyframe_indices=[3])


@pytest.mark.parametrize("name", SPLATTING)
def test_the_bound_holds(name, room_frames):
    mapper, reports = _mapped(name, room_frames[:3], iterations=1, max_gaussians=500)
    assert mapper.map.count <= 500 and reports[0].left_out > 0


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_frame_without_a_return_changes_nothing(name, room_frames):
    mapper = _mapper(name, iterations=1, **QUICK.get(name, {}))
    blind = dataclasses.replace(room_frames[0], depth=np.zeros_like(room_frames[0].depth))
    assert mapper.observe(blind).added == 0 and mapper.map.count == 0
    mapper.observe(room_frames[0])
    assert mapper.map.count > 0


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_fields_of_a_system_are_its_own(name):
    own = {field.name for field in dataclasses.fields(MAPPERS.get(name))} - {
        field.name for field in dataclasses.fields(BaseMapperConfig)
    }
    own -= {field for field in own if isinstance(getattr(MAPPERS.get(name), field), bool)}
    assert own
    for field in own:
        with pytest.raises(InputError, match=field):
            dataclasses.replace(MAPPERS.get(name), **{field: -1})


@pytest.mark.parametrize("name", SYSTEMS)
def test_an_episode_runs_on_it(name):
    """With features that read the Gaussians, on the smallest pictures."""
    env = ReconstructionEnv(
        scene="box",
        preset="fast",
        frame_budget=25,
        features=("pixel", "hole_area"),
        config={"mapper.name": name, "mapper.iterations": 1, "sensor.width": 48, "sensor.height": 27},
    )
    _, info = env.reset(seed=0)
    ended = False
    while not ended:
        _, _, terminated, truncated, info = env.step(int(np.flatnonzero(info["action_mask"])[0]))
        ended = terminated or truncated
    assert info["frames"] == 25 and info["gaussians"] > 0
    assert type(env.reconstruction.mapper) is type(_mapper(name))
    env.close()
