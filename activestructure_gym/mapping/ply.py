"""Gaussian maps as 3DGS PLY files, the format every splat viewer and converter reads.

Written: binary little endian, one ``vertex`` element of 17 float properties (SH degree 0), normals zero. Axes are the
map's own: world, z up, metres. The format has no field for it, and viewers that expect y down show such a map lying on
its back; `turning.turned_map` sets it upright.
Layout as the programs of [kerbl2023] and [gsplat] write it.
"""

from __future__ import annotations

import os
import warnings

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.files import replaced
from activestructure_gym.mapping.axes import UpInFile
from activestructure_gym.mapping.gaussian_map import (
    COLOR,
    LOG_SCALE,
    MEAN,
    OPACITY_LOGIT,
    QUATERNION,
    ROWS,
    GaussianMap,
)
from activestructure_gym.ply_header import (
    BINARY_LITTLE_ENDIAN,
    NUMPY_ORDERS,
    NUMPY_TYPES,
    PlyElement,
    PlyHeader,
    PlyProperty,
    header_bytes,
    read_header,
)

# The order other tools write; readers go by name.
PLY_PROPERTIES = (
    *("x", "y", "z"),
    *("nx", "ny", "nz"),
    *("f_dc_0", "f_dc_1", "f_dc_2"),
    "opacity",
    *("scale_0", "scale_1", "scale_2"),
    *("rot_0", "rot_1", "rot_2", "rot_3"),
)

_SH_C0 = 0.28209479177387814  # 1 / (2 sqrt(pi)): the constant spherical harmonic
_FLAT = np.log(0.1)  # thickness given to a file's two-axis (2D) Gaussians, as in seeding


def write_ply(gaussians: GaussianMap, path: str | os.PathLike[str], *, up: UpInFile = "z") -> None:
    """Write the live Gaussians (no moments). Writing what was read back from the file gives the same bytes.

    ``up`` is what a comment says of the map's axes; it turns nothing.
    """
    live = gaussians.parameters[:, : gaussians.count]
    rows = np.zeros((gaussians.count, len(PLY_PROPERTIES)), dtype="<f4")
    rows[:, 0:3] = live[MEAN].T
    # In double precision: then the way to the file and back gives the same colour in the file again.
    rows[:, 6:9] = (live[COLOR].T.astype(np.float64) - 0.5) / _SH_C0
    rows[:, 9] = live[OPACITY_LOGIT]
    rows[:, 10:13] = live[LOG_SCALE].T
    rows[:, 13:17] = live[QUATERNION].T
    vertex = PlyElement("vertex", gaussians.count, tuple(PlyProperty(name, "float") for name in PLY_PROPERTIES))
    header = PlyHeader(BINARY_LITTLE_ENDIAN, (vertex,))
    with replaced(path) as file:
        file.write(header_bytes(header, [f"world frame, {up} up, metres"]))
        file.write(rows.tobytes())


def read_ply(path: str | os.PathLike[str]) -> GaussianMap:
    """Read a 3DGS PLY (binary, either byte order), by property name and in any order.

    Unknown properties are ignored, among them normals and the view-dependent colour ``f_rest_*`` (the map holds SH
    degree 0). A single ``scale_0`` makes balls, ``scale_0`` and ``scale_1`` make thin disks; without ``rot_*`` the
    axes are the world's. Rows with a value that is not finite are dropped, with a warning that tells how many.
    Anything that is no such file raises `InputError`.
    """
    table = _read_vertices(path)
    names = set(table.dtype.names or ())

    def columns(*wanted: str) -> np.ndarray:  # [n, len(wanted)] float64
        missing = [name for name in wanted if name not in names]
        if missing:
            raise InputError(
                f"'{path}' is not a Gaussian splatting PLY: expected the vertex property '{missing[0]}', "
                f"found {', '.join(sorted(names)) or 'none'}"
            )
        return np.stack([table[name].astype(np.float64) for name in wanted], axis=1)

    block = np.empty((len(table), ROWS))
    block[:, MEAN] = columns("x", "y", "z")
    block[:, COLOR] = 0.5 + _SH_C0 * columns("f_dc_0", "f_dc_1", "f_dc_2")
    block[:, OPACITY_LOGIT] = columns("opacity")[:, 0]
    block[:, LOG_SCALE] = _log_scales(columns, names)
    if "rot_0" in names:
        block[:, QUATERNION] = columns("rot_0", "rot_1", "rot_2", "rot_3")
    else:
        block[:, QUATERNION] = (1.0, 0.0, 0.0, 0.0)
    with np.errstate(over="ignore"):  # a double beyond float32's range becomes infinite and is dropped below
        block32 = block.astype(np.float32)
    usable = np.isfinite(block32).all(axis=1)
    if not usable.all():
        dropped = f"dropped {np.count_nonzero(~usable)} of {len(block)} Gaussians"
        warnings.warn(f"{path}: {dropped} with values that are not finite", stacklevel=2)
    gaussians = GaussianMap(int(usable.sum()))
    gaussians.append(block32[usable].T)
    return gaussians


def _log_scales(columns, names: set[str]) -> np.ndarray:  # [n, 3]
    if "scale_1" not in names:
        return np.repeat(columns("scale_0"), 3, axis=1)
    if "scale_2" not in names:
        plane = columns("scale_0", "scale_1")
        return np.concatenate([plane, plane.min(axis=1, keepdims=True) + _FLAT], axis=1)
    return columns("scale_0", "scale_1", "scale_2")


def _read_vertices(path: str | os.PathLike[str]) -> np.ndarray:  # structured, one record per vertex
    try:
        with open(path, "rb") as file:
            count, dtype = _vertices(read_header(file), path)
            # Compared before reading: a damaged count must not ask for more memory than the file is long.
            announced, present = count * dtype.itemsize, os.fstat(file.fileno()).st_size - file.tell()
            payload = file.read(announced) if announced <= present else b""
    except FileNotFoundError:
        raise InputError(f"expected a Gaussian splatting PLY, but there is no file '{path}'") from None
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}") from error
    if announced > present:
        raise InputError(
            f"'{path}' is cut off: its header announces {count} vertices ({announced} bytes), "
            f"{present} bytes follow; copy the file again"
        )
    return np.frombuffer(payload, dtype=dtype, count=count)


def _vertices(header: PlyHeader | None, path: str | os.PathLike[str]) -> tuple[int, np.dtype]:
    """Vertex count and record type, of a header that may be any."""
    if header is None:
        raise InputError(f"'{path}' is not a PLY file: it does not begin with 'ply'")
    if header.format and header.format not in NUMPY_ORDERS:
        raise InputError(f"'{path}' is a PLY in '{header.format}' format; save it as binary PLY")
    if header.elements and header.elements[0].name != "vertex":
        raise InputError(f"'{path}': expected the element 'vertex' first, found '{header.elements[0].name}'")
    if header.unreadable:
        raise InputError(f"'{path}' is not a usable PLY file: cannot read the header line '{header.unreadable}'")
    if not header.complete:
        raise InputError(f"'{path}' is not a usable PLY file: its header has no 'end_header'")
    if not header.format or not header.elements:
        raise InputError(f"'{path}' is not a usable PLY file: its header lacks the format or the vertex element")
    vertex = header.elements[0]
    for one in vertex.properties:
        if one.count_kind or one.kind not in NUMPY_TYPES:
            raise InputError(f"'{path}' is not a Gaussian splatting PLY: vertex property '{one}'")
    if not vertex.properties or len({one.name for one in vertex.properties}) < len(vertex.properties):
        raise InputError(f"'{path}' is not a usable PLY file: vertex properties are missing or appear twice")
    order = NUMPY_ORDERS[header.format]
    return vertex.count, np.dtype([(one.name, order + NUMPY_TYPES[one.kind]) for one in vertex.properties])
