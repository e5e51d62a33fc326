"""A file of machine code is used if it is, to the last bit, what was written; else the kernel is compiled again."""

from __future__ import annotations

import os
import pickle

import pytest

from activestructure_gym.compiling import files, kernel, told_to
from activestructure_gym.compiling.files import read, write


def use() -> tuple[float, int]:
    """The result of a kernel that is not in memory, and how often it had to be compiled."""

    @kernel
    def halved(x):
        return x / 2

    with told_to(lambda name: None):
        return halved(3.0), sum(halved.stats.cache_misses.values())


def flipped(content: bytes, at: int) -> bytes:
    return content[:at] + bytes([content[at] ^ 4]) + content[at + 1 :]


DAMAGES = {
    "empty": lambda content: b"",
    "a byte": lambda content: b"\x80",
    "no end": lambda content: content[: len(content) // 2],
    "no last byte": lambda content: content[:-1],
    "a bit of the head": lambda content: flipped(content, 3),
    "a bit of the stamp": lambda content: flipped(content, len(files._HEAD) + 1),
    "a bit of the sum": lambda content: flipped(content, len(files._HEAD) + files._STAMP + 1),
    "a bit of machine code": lambda content: flipped(content, len(content) // 2),
    "the last bit": lambda content: flipped(content, len(content) - 1),
    "garbage": lambda content: bytes(range(256)) * 20,
    "more": lambda content: content + b"\0",
    "numba's": lambda content: pickle.dumps("0.68.1") + pickle.dumps(({}, {})),
}


def test_a_damaged_file_is_not_read(tmp_path):
    file, stamp = tmp_path / "a.kernel", bytes(range(32))
    for name, damage in DAMAGES.items():
        write(file, stamp, bytes(range(256)))
        assert read(file, stamp) == read(file) == bytes(range(256)), name
        file.write_bytes(damage(file.read_bytes()))
        assert read(file, stamp) is None and read(file) is None, name


def test_what_is_damaged_or_of_no_use_is_compiled_again(kept):
    assert use() == (1.5, 1) and use() == (1.5, 0)
    (file,) = kept.rglob("*.kernel")
    whole = file.read_bytes()
    file.write_bytes(whole[:-1])
    assert use() == (1.5, 1) and use() == (1.5, 0)
    stamp = whole[len(files._HEAD) :][: files._STAMP]
    for content in (pickle.dumps("nothing"), pickle.dumps(((), ())), b"not a pickle"):
        write(file, stamp, content)
        assert use() == (1.5, 1), content
    assert list(kept.rglob("*.kernel")) == [file]


def test_kernels_stay_where_they_are_kept_when_numba_reads_its_environment_again(kept, monkeypatch):
    assert use() == (1.5, 1) and use() == (1.5, 0)
    monkeypatch.setenv("NUMBA_LOG_PYTHON", "0")
    (file,) = kept.rglob("*.kernel")
    file.unlink()
    assert use() == (1.5, 1)  # numba has read it now
    assert files.cache_place().is_relative_to(kept) and use() == (1.5, 0)
    assert list(kept.rglob("*.kernel")) == [file]


def test_a_file_that_cannot_be_read_is_written_anew_or_costs_a_warning(kept):
    use()
    (file,) = kept.rglob("*.kernel")
    file.unlink()
    file.mkdir()
    with pytest.warns(UserWarning, match="cannot be kept"):
        assert use() == (1.5, 1)


def test_a_file_counts_for_its_stamp_only(tmp_path):
    first, second = bytes(range(32)), bytes(32)
    write(tmp_path / "a.kernel", first, b"content")
    assert read(tmp_path / "a.kernel", first) == b"content"
    assert read(tmp_path / "a.kernel", second) is None and read(tmp_path / "b.kernel", first) is None
    assert read(tmp_path / "a.kernel") == b"content"
    assert [path.name for path in tmp_path.iterdir()] == ["a.kernel"]  # nothing beside it


def test_recompiling_forgets_what_was_kept(kept):
    @kernel
    def tripled(x):
        return 3 * x

    with told_to(lambda name: None):
        tripled(1)
        assert list(kept.rglob("*.kernel"))
        tripled._cache.flush()
    assert not list(kept.rglob("*.kernel"))


@pytest.mark.skipif(os.name != "posix", reason="no numbers of users here")
def test_a_kernel_that_another_user_can_have_written_is_not_run(package, run, tmp_path):
    code = """
    import os, pickle, sys
    from pathlib import Path
    from activestructure_gym.compiling import files
    from tests.compiling.test_files import use

    class Trap:
        def __reduce__(self):
            return os.mkdir, (sys.argv[2],)

    kept, trapped = Path(sys.argv[1]), Path(sys.argv[2])
    os.umask(0)
    kept.mkdir()
    kept.chmod(0o1777)
    use()
    (file,) = kept.rglob("*.kernel")
    assert file.stat().st_mode & 0o777 == 0o644
    stamp = file.read_bytes()[len(files._HEAD) :][: files._STAMP]

    def refused():
        files.write(file, stamp, pickle.dumps(Trap()))
        yield
        assert use() == (1.5, 1) and not trapped.exists()

    for _ in refused():
        file.chmod(0o666)
    for _ in refused():
        file.rename(kept / "elsewhere")
        file.symlink_to(kept / "elsewhere")
    if os.geteuid() == 0:
        for _ in refused():
            os.chown(file, 65534, 65534)
    assert use() == (1.5, 0) and not files.not_kept  # the new one is kept, and used

    for _ in refused():
        kept.chmod(0o777)
    assert use() == (1.5, 1) and files.cache_place() is None
    assert files.not_kept[-1] == f"other users can write into the folder '{kept}'"
    kept.chmod(0o755)
    files.write(file, stamp, pickle.dumps(Trap()))
    use()
    assert trapped.exists()  # it is a trap
    """
    _, err = run(package, code, str(tmp_path / "cache"), str(tmp_path / "run"), cache=tmp_path / "cache")
    assert err.count("may have been written by another user: it and similar files are not used") == 1
    assert err.count("UserWarning") == 1 and "NUMBA_CACHE_DIR to a directory that you alone can write" in err
