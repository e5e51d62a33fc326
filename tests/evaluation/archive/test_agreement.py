"""Counts, lengths of lists and kinds of numbers in a run's files: a mismatch is one `InputError` of the run."""

from __future__ import annotations

import copy
import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activestructure_gym.config import ReconstructionConfig
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import completion, json_files, run_files, store
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.schema import Mismatch
from activestructure_gym.evaluation.report.results import gather
from activestructure_gym.mapping import GaussianMap
from tests.evaluation.written_runs import write_comparison, write_run

ARCHIVED = Job("room", "random", 0, scene_hash="ab" * 32)
_CHECKS = {
    store.TRAJECTORY: run_files.check_trajectory, store.GRAPH: run_files.check_graph,
    store.PICTURES: run_files.check_pictures,
}  # fmt: skip
_DTYPES = (
    "?",
    "i1",
    "u1",
    "i2",
    "u2",
    "i4",
    "u4",
    "i8",
    "u8",
    "f2",
    "f4",
    "f8",
    ">f8",
    ">i8",
    "c16",
    "U3",
    "S3",
    "M8[s]",
)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("written") / "jobs" / "run", ARCHIVED)


def sealed(directory: Path) -> Path:
    """The run with checksums of whatever its files hold now."""
    store.finish(directory, ARCHIVED)
    return directory


def read(directory: Path) -> None:
    store.read_all(store.read_run(directory))


def arrays_of(directory: Path, name: str) -> dict[str, np.ndarray]:
    with np.load(directory / name) as file:
        return dict(file)


def copied(written: Path, place: Path) -> Path:
    """A copy whose unchanged files are links: it is read, and a changed file replaces its link."""
    place.mkdir(parents=True)
    for file in written.iterdir():
        (place / file.name).symlink_to(file)
    (place / completion.DONE).unlink()
    return place


def changed(written: Path, place: Path, name: str, content: dict[str, np.ndarray] | bytes) -> Path:
    directory = copied(written, place)
    (directory / name).unlink()
    if isinstance(content, bytes):
        (directory / name).write_bytes(content)
    else:
        np.savez(directory / name, **content)  # type: ignore[arg-type]
    return sealed(directory)


def test_what_was_written_is_read(written: Path) -> None:
    read(written)


def others_of(array: np.ndarray) -> Iterator[np.ndarray]:
    """The same numbers in every other width and kind, and in other shapes."""
    yield array[None]
    if array.ndim and array.size:
        yield from (array[..., None], array[:-1], np.concatenate([array, array[-1:]]), array[:0])
    for dtype in _DTYPES:
        if np.dtype(dtype) != array.dtype and (dtype != "M8[s]" or array.dtype.kind in "iu"):
            with np.errstate(all="ignore"):
                yield array.astype(dtype)


@pytest.mark.parametrize("name", _CHECKS)
def test_every_array_has_one_dtype_and_one_shape(written: Path, name: str) -> None:
    run = store.read_run(written)
    arrays = arrays_of(written, name)
    for key, array in arrays.items():
        for other in others_of(array):
            changed_run = copy.copy(run)
            with pytest.raises((Mismatch, InputError)) as refusal:
                _CHECKS[name](arrays | {key: other})
                changed_run.__dict__[Path(name).stem] = arrays | {key: other}
                store.read_shown(changed_run)
                pytest.fail(f"{key} as {other.dtype.str} {other.shape} was read")
            assert len(str(refusal.value).splitlines()) == 1


def test_every_array_of_a_map_is_float32_and_of_one_shape(tmp_path: Path) -> None:
    gaussians = GaussianMap(8)
    gaussians.append(np.zeros((14, 3), np.float32))
    gaussians.save_npz(tmp_path / "map.npz")
    arrays = arrays_of(tmp_path, "map.npz")
    for key, array in arrays.items():
        for other in others_of(array):
            np.savez(tmp_path / "map.npz", **arrays | {key: other})  # type: ignore[arg-type]
            with pytest.raises(InputError, match="map.npz' (should hold|has the map format)"):
                GaussianMap.load_npz(tmp_path / "map.npz")


def lists_of(content: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Places of every list in a tree of JSON."""
    if isinstance(content, list):
        yield place
    for key, value in content.items() if isinstance(content, dict) else enumerate(content):
        if isinstance(value, dict | list):
            yield from lists_of(value, (*place, key))


def with_list(content: Any, place: tuple[Any, ...], act: Callable[[list[Any]], None]) -> Any:
    content = copy.deepcopy(content)
    holder = content
    for key in place:
        holder = holder[key]
    act(holder)
    return content


_FREE = {("scene", "notes"), ("job", "also")}  # nothing else depends on how long they are
_CHANGES: dict[str, Callable[[list[Any]], None]] = {
    "shorter": lambda entries: entries.pop() if entries else None,
    "longer": lambda entries: entries.append(copy.deepcopy(entries[-1]) if entries else 0),
    "empty": lambda entries: entries.clear(),
}  # fmt: skip


@pytest.mark.parametrize("name", ["config.json", "metrics.json", "timing.json"])
@pytest.mark.parametrize("change", _CHANGES)
def test_every_list_has_the_length_that_the_other_files_say(
    written: Path, tmp_path: Path, name: str, change: str
) -> None:
    content = json.loads((written / name).read_text())
    for number, place in enumerate(lists_of(content)):
        other = with_list(content, place, _CHANGES[change])
        if place in _FREE or other == content:
            continue
        directory = changed(written, tmp_path / f"{number}", name, json.dumps(other).encode())
        with pytest.raises(InputError):
            read(directory)


@pytest.mark.parametrize("change", [lambda lines: lines[:-1], lambda lines: [*lines, lines[-1]], lambda lines: []])
def test_there_are_as_many_steps_as_the_other_files_say(written: Path, tmp_path: Path, change: Any) -> None:
    lines = (written / store.STEPS).read_bytes().splitlines(keepends=True)
    with pytest.raises(InputError, match="decisions: "):
        read(changed(written, tmp_path / "run", store.STEPS, b"".join(change(lines))))


@pytest.mark.parametrize("changes", [{"setup": "native"}, {"policy": "trajectory:sweep"}])
def test_what_a_report_reads_of_a_configuration_must_be_in_it(written: Path, changes: dict[str, str]) -> None:
    content = json.loads((written / store.CONFIG).read_text())
    run_files.check_config(content, "")
    with pytest.raises(Mismatch, match="configuration lacks "):
        run_files.check_config({**content, "job": content["job"] | changes}, "")
    whole = json.loads(json.dumps(json_files.plain(dataclasses.asdict(ReconstructionConfig()))))
    run_files.check_config({**content, "job": content["job"] | changes, "configuration": whole}, "")


@pytest.mark.parametrize("name", [store.PICTURES, store.METRICS, store.STEPS])
def test_one_damaged_run_is_left_out_of_a_report_and_named(tmp_path: Path, name: str) -> None:
    jobs = [Job("room", policy, 0, scene_hash="ab" * 32) for policy in ("random", "pixel_only")]
    directory = write_comparison(tmp_path / "all", jobs)
    damaged = directory / completion.JOBS / jobs[0].name
    if name == store.PICTURES:
        arrays = arrays_of(damaged, name)
        np.savez(damaged / name, **arrays | {"rendered": arrays["rendered"].astype("u2")})  # type: ignore[arg-type]
    elif name == store.METRICS:
        content = json.loads((damaged / name).read_text())
        json_files.write_json(damaged / name, content | {"curve": content["curve"][:-1]})
    else:
        (damaged / name).write_bytes(b"")
    store.finish(damaged, jobs[0])
    for places in ([directory], [directory / completion.JOBS / jobs[1].name, damaged]):
        results = gather(places)
        assert [run.policy for run in results.runs] == ["pixel_only"]
        (why,) = results.missing.values()
        assert f"{jobs[0].name}/" in why and "is damaged" in why
    with pytest.raises(InputError, match="no run can be reported: .* is damaged"):
        gather([damaged])
