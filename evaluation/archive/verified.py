"""Which runs were played again on this machine and came out the same: marks that lie outside the runs' directories.

Whoever hands in a run can write into its directory what he likes; the marks are of who reads it. A mark is bound to the
run by the SHA-256 of its `.done`, which holds the sums of all its files: a file that changes is of another run.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import schema, store, temporary

VARIABLE = "ASG_VERIFIED_DIR"
# Only what is identical is confirmed. What is not comparable here is neither confirmed nor refuted: other bytes came
# out on another processor or with other versions than the run names.
Verdict = Literal["identical", "not comparable here", "differs", "damaged"]
REFUTED: tuple[Verdict, ...] = ("differs", "damaged")

_MARK: schema.Check = schema.table(
    {"verdict": schema.text, "why": schema.each(schema.text), "processor": schema.text, "code": schema.text}
)


@dataclass(frozen=True)
class Verification:
    """What became of a run that was played again."""

    verdict: Verdict
    why: tuple[str, ...] = ()  # what differs, or was made elsewhere, in words
    processor: str = ""  # that it was played again on
    code: str = ""  # SHA-256 of the code that played it, see `machine.hardware.code_sum`


def marks_directory() -> Path:
    """Where marks are kept: ``ASG_VERIFIED_DIR``, else in the user's directory of state."""
    if given := os.environ.get(VARIABLE):
        return Path(given).expanduser()
    home = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    return Path(home).expanduser() / "activestructure-gym" / "verified"


def keep(run: Path, found: Verification) -> None:
    """Remember what became of a run; replaces what was known of it."""
    place = _place(run)
    with temporary.writing(place):
        place.parent.mkdir(parents=True, exist_ok=True)
        store.write_json(place, asdict(found))


def known(run: Path) -> Verification | None:
    """What is known of a run as it lies there; None if it was never played again here, or has changed since.

    A run of which a file has no sum could change unseen, and nothing is known of it.
    """
    try:
        if store.unsummed(store.open_run(run)):
            return None
        content: dict[str, Any] = store.read_json(_place(run), _MARK)
    except InputError:
        return None
    if content["verdict"] not in get_args(Verdict):
        return None
    return Verification(content["verdict"], tuple(content["why"]), content["processor"], content["code"])


def _place(run: Path) -> Path:
    try:
        done = (run / store.DONE).read_bytes()
    except OSError as error:
        raise InputError(f"'{run}' is not a finished run: {error.strerror}") from error
    return marks_directory() / f"{hashlib.sha256(done).hexdigest()}.json"
