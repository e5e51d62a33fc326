"""Standard streams of every kind: whoever reads them, and in whatever encoding, writing to them goes on."""

from __future__ import annotations

import errno
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from activestructure_gym import streams
from activestructure_gym.errors import MAX_CHARACTERS, InputError, InputWarning, one_line, printable
from activestructure_gym.streams import Plain, Stream, escape, fitting, kept_streams

HOSTILE = "a\x1b[2K\x1b[1Ab\x07\r\x9b31m\x00\x7f\u202ecba\u2066\u200f\udc80\u2028"
TOLD = "✓ ✗ → ± · ≈ − é Ω"


@pytest.mark.parametrize(
    "encoding, shown",
    [
        ("utf-8", TOLD),
        ("utf-16", TOLD),
        ("ascii", "ok failed -> +- - ~ - ? ?"),
        ("latin-1", "ok failed -> ± · ~ - é ?"),
        ("cp1252", "ok failed -> ± · ~ - é ?"),
        ("cp437", "ok failed -> ± · ≈ - é Ω"),
        ("no-such-encoding", "ok failed -> +- - ~ - ? ?"),
    ],
)
def test_what_an_encoding_lacks_is_shown_by_signs(encoding: str, shown: str) -> None:
    assert fitting(TOLD, encoding) == shown


def test_a_handler_of_the_user_replaces_what_has_no_sign() -> None:
    assert fitting("✓ Ω", "ascii", "xmlcharrefreplace") == "ok &#937;"
    assert fitting("✓ Ω", "ascii", "ignore") == "ok "
    assert fitting("╭─╮ ⠋", "ascii", "surrogateescape") == "+-+ *"


def test_control_characters_are_written_out() -> None:
    shown = printable(HOSTILE + "\n\tü")
    assert shown == (r"a\x1b[2K\x1b[1Ab\x07\r\x9b31m\x00\x7f\u202ecba\u2066\u200f\udc80\u2028" + "\n ü")
    assert printable("a\u00a0b\u3000") == "a\u00a0b\u3000"  # spaces of other widths


def test_one_line_is_short_and_one_line() -> None:
    assert one_line("a\n b\x1b") == "a b\\x1b"
    long = one_line("x" * 300_000 + "\x1b" * 300_000 + "end")
    assert len(long) <= MAX_CHARACTERS and long.startswith("xxx") and long.endswith("end")


def test_errors_and_warnings_hold_one_short_printable_line() -> None:
    for kind in (InputError, InputWarning):
        said = str(kind(f"the extension '{HOSTILE * 10_000}' is\nunknown"))
        assert len(said) <= MAX_CHARACTERS and said.isprintable() and said.endswith("is unknown")


def test_markup_of_others_is_none() -> None:
    assert escape("[red]x[/]\ny\x1b[31m") == "\\[red]x\\[/] y\\x1b[31m"


class Failing(io.StringIO):
    """A stream that cannot be written to."""

    encoding = "utf-8"  # type: ignore[assignment]

    def __init__(self, error: Exception) -> None:
        super().__init__()
        self.error = error

    def write(self, text: str) -> int:
        raise self.error


@pytest.mark.parametrize(
    "error", [BrokenPipeError(errno.EPIPE, "gone"), OSError(errno.EIO, "hung up"), ValueError("closed file")]
)
def test_a_reader_that_has_gone_ends_nothing(error: Exception) -> None:
    stream = Stream(Failing(error))
    assert stream.write("text") == 4 and stream.failure is None and not stream.isatty()
    stream.flush()


def test_a_full_disk_is_remembered() -> None:
    stream = Stream(Failing(OSError(errno.ENOSPC, "No space left on device")))
    stream.write("text")
    assert stream.failure is not None and stream.failure.errno == errno.ENOSPC


def test_a_closed_stream_ends_nothing() -> None:
    below = io.StringIO()
    stream = Plain(below)
    below.close()
    stream.write("text")
    stream.flush()
    assert not stream.isatty()


class Bare:
    """What some programs put in the place of standard output: it can write, and nothing else."""

    def __init__(self) -> None:
        self.text = ""

    def write(self, text: str) -> None:
        text.encode("ascii")
        self.text += text


def test_a_stream_that_can_only_write_is_enough() -> None:
    bare = Bare()
    stream = Plain(bare)
    stream.write("✓ done")
    stream.flush()
    assert bare.text == "ok done" and not stream.isatty() and stream.encoding == "utf-8"
    with pytest.raises(OSError):
        stream.fileno()


def test_nothing_at_all_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    with kept_streams():
        print("said")
        streams.say("said")
        streams.complain("said")
    assert sys.stdout is None and sys.stderr is None
    streams.say("said")
    streams.complain("said")


def test_only_what_the_program_makes_itself_passes() -> None:
    below = io.StringIO()
    stream = Plain(below)
    stream.write("\x1b[31m")
    streams.raw(stream).write("\x1b[32m")
    assert below.getvalue() == "\\x1b[31m\x1b[32m" and streams.lowest(stream) is below


ASG = "import sys; from activestructure_gym.evaluation.cli import main; sys.exit(main({words}))"


def asg(*words: str, shell: str = "", **environment: str) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own, with what the shell does to its streams."""
    command = [sys.executable, "-c", ASG.format(words=list(words))]
    kept = {"PYTHONPATH": os.pathsep.join(sys.path), "PATH": os.environ["PATH"]}
    return subprocess.run(
        ["bash", "-c", f'set -o pipefail; "$@" {shell}', "asg", *command],
        env=kept | environment, capture_output=True, encoding="utf-8", errors="replace", timeout=120,
    )  # fmt: skip


@pytest.mark.skipif(os.name != "posix", reason="a shell closes the streams")
@pytest.mark.parametrize(
    "shell, code",
    [
        (">&-", 0), ("2>&-", 0), (">&- 2>&-", 0), ("<&-", 0), ("| true", 0), ("| head -1", 0),
        ("2>&1 >/dev/null | true", 0),
        pytest.param("> /dev/full", 1, marks=pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full disk")),
    ],
)  # fmt: skip
def test_no_state_of_the_streams_ends_a_command(shell: str, code: int) -> None:
    done = asg("--help", shell=shell)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr
    if code:
        assert done.stderr == "asg: standard output cannot be written: No space left on device\n"


@pytest.mark.skipif(os.name != "posix", reason="a shell closes the streams")
def test_a_refusal_has_its_exit_code_where_nobody_hears_it() -> None:
    for shell in ("2>&-", "2>&1 >/dev/null | true", ">&- 2>&-"):
        assert asg("no-such-command", shell=shell).returncode == 2
    assert asg("no-such-command", shell="2>&-").stdout == ""


@pytest.mark.skipif(os.name != "posix", reason="descriptors")
def test_files_do_not_take_the_numbers_of_closed_streams() -> None:
    script = (
        "from activestructure_gym.streams import kept_streams; import os\n"
        "with kept_streams():\n    file = open(os.devnull); assert file.fileno() > 2"
    )
    for closed in ("<&- >&- 2>&-", ">&-", "2>&-"):
        environment = {"PYTHONPATH": os.pathsep.join(sys.path)}
        command = ["bash", "-c", f'"$@" {closed}', "x", sys.executable, "-c", script]
        assert subprocess.run(command, env=environment).returncode == 0


@pytest.mark.slow
def test_no_encoding_and_no_reader_ends_a_command_with_tables() -> None:
    assert asg("cache", shell=">&-").returncode == 0
    missing = asg("doctor", "--dataset", "replica", ".", PYTHONIOENCODING="cp1252:strict")
    assert missing.returncode == 1 and "failed" in missing.stdout and "Traceback" not in missing.stderr
    assert json.loads(asg("cache", "--json", PYTHONIOENCODING="ascii:xmlcharrefreplace").stdout)
