"""Recognise the format of a trajectory file by its content."""

from __future__ import annotations

import re
from pathlib import Path

from activestructure_gym.errors import InputError, listed, pluralised, short_repr
from activestructure_gym.evaluation.trajectories.colmap import names_image
from activestructure_gym.evaluation.trajectories.pose_tables import NANOSECONDS, is_header
from activestructure_gym.scenes.loaders.pose_text import number_of, refuse_utf16

_HEAD_BYTES = 1 << 16  # bytes of the beginning of a file that are inspected
_BY_WIDTH = {8: "tum", 12: "kitti", 16: "nice_slam"}  # format by the number of numbers per line
_EUROC_WIDTH = 17  # columns of EuRoC's ground truth: time, pose, velocity, biases of gyroscope and accelerometer
_EXPECTED = (
    "expected 8 numbers per line (tum), 12 (kitti) or 16 (nice_slam, replica), matrices of 4 lines (redwood), a csv "
    "file with named columns (euroc, ros_csv), a COLMAP model (images.txt, images.bin), or JSON (nerfstudio, habitat, "
    "scannetpp)"
)


def recognised(path: Path) -> str:
    """Return the format of the trajectory in the file ``path``; raise `InputError` if no format fits its content."""
    try:
        with open(path, "rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}") from error
    if not head.strip():
        raise InputError(f"'{path}' is empty: {_EXPECTED}")
    if head.startswith(b"PK\x03\x04") or path.suffix.lower() == ".npz":
        return "npz"
    refuse_utf16(head, path)
    if b"\0" in head[:8]:  # the number of images, 8 bytes
        return "colmap"
    text = head.decode("utf-8-sig", errors="replace")
    kind, found = _json_kind(text) if text.lstrip()[:1] in ("{", "[") else _text_kind(text)
    if not kind:
        raise InputError(f"'{path}' has no known trajectory format: {_EXPECTED}, got {found}")
    return kind


def _json_kind(head: str) -> tuple[str, str]:
    """Return the format of a JSON file, or "" and a description of its content."""
    if head.lstrip().startswith("["):
        return "habitat", ""
    names = list(dict.fromkeys(re.findall(r'"([^"]{1,60})"\s*:', head)))
    for name, kind in (("transform_matrix", "nerfstudio"), ("aligned_pose", "scannetpp"), ("frames", "nerfstudio")):
        if name in names:
            return kind, ""
    return "", f"JSON with the names {listed(names)}" if names else "JSON without names"


def _text_kind(head: str) -> tuple[str, str]:
    """Return the format of a text file, or "" and a description of its content."""
    lines = head.splitlines()
    first = next((n for n, line in enumerate(lines) if line.strip() and not line.lstrip().startswith(("#", "%"))), None)
    for line in lines if first is None else lines[: first + 1]:
        if "IMAGE_ID" in line and "QW" in line:
            return "colmap", ""
        if is_header(line.split(",")):
            return ("euroc" if "p_rs_r" in line.lower() else "ros_csv"), ""
    if first is None:
        return "", "comments only"
    rows = [words for line in lines[first:] if (words := line.replace(",", " ").split())]
    width = len(rows[0])
    if names_image(rows[0]):
        return "colmap", ""
    if width == 3 and [len(row) for row in rows[1:5]] == [4] * 4:
        return "redwood", ""
    if width == _EUROC_WIDTH or (width == 8 and lines[first].count(",") >= 7 and number_of(rows[0][0]) > NANOSECONDS):
        return "euroc", ""
    return _BY_WIDTH.get(width, ""), f"{pluralised(width, 'word')} in the line {short_repr(lines[first][:80])}"
