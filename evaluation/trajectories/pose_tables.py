"""Read camera poses from csv files whose header names the columns: EuRoC's ground truth and csv files of ROS.

- ``euroc``: ``#timestamp, p_RS_R_x [m], ..., q_RS_w [], q_RS_x [], ...`` with time stamps in nanoseconds and the
  quaternion w first ([euroc]). Without a header, these eight columns are expected in this order.
- ``ros_csv``: the names of message fields, as ``rostopic echo -p`` writes them: ``%time,field.header.stamp,
  field.pose.position.x, ..., field.pose.orientation.w``; other prefixes and short names (tx, qx) are accepted. The time
  can be in two columns, ``header.stamp.sec`` and ``header.stamp.nanosec``, as in ROS 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from activestructure_gym.errors import InputError, listed
from activestructure_gym.scenes.loaders.pose_text import MAX_POSES, text_of

# Names of columns, without their prefixes; {} is x, y, z or w. The first name that is found is used.
_POSITION = ("p_rs_r_{}", "position.{}", "translation.{}", "position_{}", "pos_{}", "t{}", "p{}", "{}")
_ROTATION = ("q_rs_{}", "orientation.{}", "rotation.{}", "orientation_{}", "rot_{}", "q{}", "q_{}")
_TIMES: dict[str, tuple[str, ...]] = {
    "time": ("header.stamp", "timestamp", "stamp", "time"),
    "sec": ("stamp.sec", "stamp.secs", "sec"),
    "nanosec": ("stamp.nanosec", "stamp.nsecs", "nanosec"),
}
_COLUMNS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
_EUROC = (0, 1, 2, 3, 5, 6, 7, 4)  # columns of `_COLUMNS` in a file of EuRoC without a header
NANOSECONDS, _MICROSECONDS = 1e17, 1e14  # time stamps without a unit have this one above; 3 years each
_PER_SECOND = {"ns": 1e9, "us": 1e6, "ms": 1e3, "s": 1.0}


def columns_of(cells: Sequence[str]) -> dict[str, int]:
    """Return the indices of the columns time, sec, nanosec, x, y, z, qx, qy, qz, qw that the cells of a header name."""
    names = [cell.split("[")[0].strip(" \t\"'#%").lower().replace("/", ".") for cell in cells]
    wanted = _TIMES | {axis: tuple(name.format(axis) for name in _POSITION) for axis in "xyz"}
    wanted |= {f"q{axis}": tuple(name.format(axis) for name in _ROTATION) for axis in "xyzw"}
    found: dict[str, int] = {}
    for column, accepted in wanted.items():
        for name in accepted:
            at = [n for n, one in enumerate(names) if one == name or (len(name) > 1 and one.endswith(f".{name}"))]
            if at:
                found[column] = at[0]
                break
    return found


def is_header(cells: Sequence[str]) -> bool:
    """Return whether the cells of a line name the columns of positions or rotations."""
    return len(cells) >= 4 and len(columns_of(cells)) >= 4


def seconds_of(times: np.ndarray, unit: str = "") -> np.ndarray:  # [T] -> [T]
    """Return time stamps in seconds; without a unit, stamps above 1e17 are in ns and stamps above 1e14 in us."""
    largest = np.abs(times).max()
    guessed = "ns" if largest > NANOSECONDS else "us" if largest > _MICROSECONDS else "s"
    return times / _PER_SECOND[unit or guessed]


def table_rows(path: Path, kind: str) -> tuple[np.ndarray, bool]:  # [T, 8]: seconds, x, y, z, qx, qy, qz, qw
    """Return the poses of a csv file as rows of TUM, and whether it has time stamps; without them the times are 0.

    ``kind`` is "euroc" or "ros_csv". Raise `InputError` if a column is missing or a cell is no number.
    """
    columns: dict[str, int] = dict(zip(_COLUMNS, _EUROC, strict=True)) if kind == "euroc" else {}
    unit = "ns" if kind == "euroc" else ""
    rows: list[list[str]] = []
    for line in text_of(path).splitlines():
        cells = line.split(",")
        if not rows and is_header(cells):
            columns = columns_of(cells)
            _check(columns, cells, path)
            named = cells[columns.get("time", 0)].partition("[")[2].partition("]")[0].strip()
            unit = named if named in _PER_SECOND else unit
        elif line.strip() and not line.lstrip().startswith(("#", "%")):
            if not columns:
                raise InputError(f"'{path}' has no header that names its columns, such as time, tx, ty, tz, qx, ...")
            if len(cells) <= max(columns.values()):
                raise InputError(f"row {len(rows) + 1} of '{path}' has {len(cells)} cells, fewer than its header")
            wanted = (*_COLUMNS, "sec", "nanosec")
            rows.append([cells[columns[name]].strip(' "') if name in columns else "0" for name in wanted])
        if len(rows) > MAX_POSES:
            raise InputError(f"'{path}' holds more than {MAX_POSES} poses")
    if not rows:
        raise InputError(f"'{path}' holds no pose: no row of numbers follows its header")
    try:
        table = np.array(rows, dtype=np.float64)
    except ValueError as error:
        raise InputError(f"'{path}' is not a table of numbers: {' '.join(str(error).split())[:200]}") from error
    split = {"sec", "nanosec"} <= columns.keys()
    table[:, 0] = table[:, 8] + table[:, 9] / 1e9 if split else seconds_of(table[:, 0], unit)
    return table[:, :8], split or "time" in columns


def _check(columns: dict[str, int], cells: Sequence[str], path: Path) -> None:
    missing = [name for name in _COLUMNS[1:] if name not in columns]
    if missing:
        raise InputError(
            f"'{path}' is a table without columns for {', '.join(missing)}; a pose needs a position and a quaternion, "
            f"and its columns are {listed(cell.strip() for cell in cells)}"
        )
