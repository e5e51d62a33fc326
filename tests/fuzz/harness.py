"""Runs the cases of a kind in a watched process: 60 seconds and 2 GB each, no traceback, refusals of one line."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import pkgutil
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from types import ModuleType

import numpy as np

SECONDS = 60.0  # per case
MEGABYTES = 2048.0  # of growth per case
_MAX_MESSAGE_CHARACTERS = 2000  # characters; a refusal is a sentence, and not the file
_ADDRESSES = 16 << 30  # bytes of address space per process: the machine survives what the watching misses
_REPOSITORY = str(Path(__file__).resolve().parents[2])
# Words of Python in a message for people: counted, as some are part of an honest reason.
_ROUGH = re.compile(
    r"\b(?:[A-Z]\w+Error|NoneType|object has no attribute|not subscriptable|index out of range|positional argument)\b"
)
# What would move a terminal's cursor, colour it or turn its text around; a line may end.
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


@dataclass(frozen=True)
class Outcome:
    """What one case came to."""

    number: int
    verdict: str  # "used", "refused" or "failed"
    message: str = ""
    seconds: float = 0.0
    megabytes: float = 0.0  # of growth while it ran


@dataclass
class Tally:
    """The outcomes of one kind."""

    kind: str
    seed: int
    outcomes: list[Outcome] = field(default_factory=list)

    @property
    def failures(self) -> list[Outcome]:
        return [outcome for outcome in self.outcomes if outcome.verdict == "failed"]

    def count(self, verdict: str) -> int:
        return sum(outcome.verdict == verdict for outcome in self.outcomes)

    @property
    def rough(self) -> int:
        """Refusals that carry words of Python."""
        return sum(o.verdict == "refused" and bool(_ROUGH.search(o.message)) for o in self.outcomes)

    def row(self) -> tuple[str, ...]:
        slowest = max((o.seconds for o in self.outcomes), default=0.0)
        largest = max((o.megabytes for o in self.outcomes), default=0.0)
        counts = (len(self.outcomes), *(self.count(v) for v in ("used", "refused", "failed")), self.rough)
        return (self.kind, *(str(count) for count in counts), f"{slowest:.1f} s", f"{largest:.0f} MB")


COLUMNS = ("kind", "cases", "used", "refused", "failed", "rough", "slowest", "memory")


def kinds() -> list[str]:
    """The modules of this package that define a `case`."""
    names = (module.name for module in pkgutil.iter_modules([str(Path(__file__).parent)]))
    own = ("harness", "test_fuzz")
    return sorted(name for name in names if name not in own and not name.startswith("_"))


def kind_module(kind: str) -> ModuleType:
    return importlib.import_module(f"tests.fuzz.{kind}")


def run(
    kind: str,
    numbers: Iterable[int],
    *,
    seed: int = 0,
    keep: Path | None = None,
    seconds: float = SECONDS,
    megabytes: float = MEGABYTES,
) -> Tally:
    """The cases ``numbers`` of a kind. ``keep`` is a folder to leave the files of the cases in."""
    kind_module(kind)  # a mistake in it shows here, and not once per case
    tally = Tally(kind, seed)
    with tempfile.TemporaryDirectory(prefix="asg-fuzz-") as scratch:
        child = _Child(kind, seed, keep or Path(scratch), keep is not None, seconds, megabytes)
        try:
            for number in numbers:
                tally.outcomes.append(child.outcome(number))
        finally:
            child.end()
    return tally


class _Child:
    """The process that runs cases, one after the other; a new one after each that had to be killed."""

    def __init__(self, kind: str, seed: int, root: Path, keep: bool, seconds: float, megabytes: float) -> None:
        self._arguments = (kind, seed, str(root), keep, megabytes)
        self._seconds, self._megabytes = seconds, megabytes
        self._process: multiprocessing.process.BaseProcess | None = None

    def outcome(self, number: int) -> Outcome:
        if self._process is None:
            self._start()
        assert self._process is not None and self._process.pid is not None
        self._connection.send(number)
        try:
            if not self._connection.poll(600):  # building the input is not what is measured
                return self._killed(number, "its input was not built within 600 s")
            base = self._connection.recv()  # MB before the case runs
            if isinstance(base, Outcome):
                return base
            start = time.monotonic()
            while not self._connection.poll(0.05):
                elapsed, growth = time.monotonic() - start, _session_megabytes(self._process.pid) - base
                if growth > self._megabytes:
                    return self._killed(number, f"takes over {self._megabytes:.0f} MB", elapsed, growth)
                if elapsed > self._seconds:
                    return self._killed(number, f"hangs: still running after {self._seconds:.0f} s", elapsed, growth)
            return self._connection.recv()
        except (EOFError, ConnectionResetError):
            self._process.join(10)
            return self._killed(number, f"the process died with exit code {self._process.exitcode}")

    def end(self) -> None:
        if self._process is None:
            return
        assert self._process.pid is not None
        try:
            os.killpg(self._process.pid, signal.SIGKILL)  # it leads a session of its own
        except ProcessLookupError:
            self._process.kill()  # it had not come to that yet, or is gone
        self._process.join()
        self._connection.close()
        self._process = None

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, *self._arguments), daemon=False)
        self._process.start()
        theirs.close()

    def _killed(self, number: int, reason: str, seconds: float = 0.0, megabytes: float = 0.0) -> Outcome:
        self.end()
        return Outcome(number, "failed", reason, seconds, megabytes)


def _serve(connection: Connection, kind: str, seed: int, root: str, keep: bool, megabytes: float) -> None:
    """Builds and runs the cases whose numbers arrive, until the other side closes."""
    os.setsid()
    # Nothing lands in the user's cache; kernels stay where they are.
    os.environ["ASG_CACHE_DIR"] = str(Path(root) / "cache")
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, resource.getrlimit(resource.RLIMIT_AS)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    case = kind_module(kind).case
    # The text a case prints goes to a file, whatever prints it: a traceback on stderr is a failure too.
    with tempfile.TemporaryFile() as printed:
        os.dup2(printed.fileno(), 1)
        os.dup2(printed.fileno(), 2)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        while True:
            try:
                number = connection.recv()
            except EOFError:
                return
            os.chdir(root)
            folder = Path(root) / f"{kind}{number}"
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            printed.seek(0)
            printed.truncate()
            try:
                read = case(generator(kind, seed, number), folder)
            except BaseException:
                connection.send(Outcome(number, "failed", f"the fuzzer itself failed: {_short_traceback()}"))
                continue
            base = _reset_peak()
            connection.send(base)
            start = time.perf_counter()
            verdict, message = _tried(read)
            elapsed = time.perf_counter() - start
            growth = max(0.0, _megabytes(os.getpid(), "VmHWM") - base)
            sys.stdout.flush()
            sys.stderr.flush()
            printed.seek(0)
            text = printed.read(1 << 20).decode(errors="replace")
            if verdict != "failed" and "Traceback (most recent call last)" in text:
                verdict, message = "failed", f"printed a traceback: {text.strip().splitlines()[-1][:500]}"
            if verdict != "failed" and _CONTROL.search(text):
                verdict, message = "failed", f"printed control characters: {text[:500]!r}"
            if verdict != "failed" and growth > megabytes:
                verdict, message = "failed", f"takes over {megabytes:.0f} MB"
            os.chdir(root)
            if not keep:
                shutil.rmtree(folder, ignore_errors=True)
            connection.send(Outcome(number, verdict, message, elapsed, growth))


def _tried(read: Callable[[], object]) -> tuple[str, str]:
    """The verdict on one input, and what was said of it."""
    from activestructure_gym.errors import InputError

    try:
        read()
        return "used", ""
    except InputError as error:
        message = str(error)
        if not message.strip() or len(message.splitlines()) != 1:
            return "failed", f"refused in {len(message.splitlines())} lines: {message[:500]!r}"
        if _CONTROL.search(message):
            return "failed", f"refused with control characters: {message[:500]!r}"
        if len(message) > _MAX_MESSAGE_CHARACTERS:
            return "failed", f"refused in {len(message)} characters: {message[:500]!r}"
        return "refused", message
    except SystemExit as error:
        if error.code in (None, 0):
            return "used", ""
        return ("refused", "") if error.code in (1, 2) else ("failed", f"exits with {error.code!r}")
    except BaseException:
        return "failed", _short_traceback()


def generator(kind: str, seed: int, number: int) -> np.random.Generator:
    """Each case has its own, so that one can be repeated without those before it."""
    return np.random.default_rng([zlib.crc32(kind.encode()), seed, number])


def _short_traceback() -> str:
    kind, error, trace = sys.exc_info()
    frames = traceback.extract_tb(trace)
    ours = [frame for frame in frames if frame.filename.startswith(_REPOSITORY)]
    places = " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in reversed((ours or frames)[-4:]))
    return f"{kind.__name__ if kind else ''}: {str(error)[:300]!r} at {places}"


def _megabytes(pid: int, line: str) -> float:
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:  # it ended
        return 0.0
    found = re.search(rf"^{line}:\s+(\d+) kB", status, re.MULTILINE)
    return int(found[1]) / 1024 if found else 0.0


def _reset_peak() -> float:
    """Megabytes in use; from here on VmHWM is the peak of what follows."""
    Path("/proc/self/clear_refs").write_text("5")
    return _megabytes(os.getpid(), "VmRSS")


def _session_megabytes(leader: int) -> float:
    """Of a case's process and all that it started."""
    total = 0.0
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            session = int((folder / "stat").read_text().rpartition(")")[2].split()[3])
        except (OSError, IndexError, ValueError):
            continue
        if session == leader:
            total += _megabytes(int(folder.name), "VmRSS")
    return total
