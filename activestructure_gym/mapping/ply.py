"""Read and write Gaussian maps as 3DGS PLY files, a format of most splat viewers and converters.

Files are binary little endian, with one ``vertex`` element of 17 float properties (spherical harmonics of degree 0) and
zero normals. The axes are those of the map: world, z up, metres. The format has no field for axes. Viewers that expect
y down show such a map on its back; `axes.turned_map` rotates it. The layout is that of the programs of [kerbl2023] and
[gsplat].
"""

from __future__ import annotations

import os
import warnings

import numpy as np

from activestructure_gym.errors import InputError, InputWarning
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
    usable,
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

# Order of the properties in files of other programs. Readers find them by name.
PLY_PROPERTIES = (
    *("x", "y", "z"),
    *("nx", "ny", "nz"),
    *("f_dc_0", "f_dc_1", "f_dc_2"),
    "opacity",
    *("scale_0", "scale_1", "scale_2"),
    *("rot_0", "rot_1", "rot_2", "rot_3"),
)

_SH_C0 = 0.28209479177387814  # value of the spherical harmonic of degree 0, 1 / (2 sqrt(pi))
_FLAT = np.log(0.1)  # log of the thickness relative to the smaller scale, for Gaussians with two scales, as in seeding


def write_ply(gaussians: GaussianMap, path: str | os.PathLike[str], *, up: UpInFile = "z") -> None:
    """Write the Gaussians to a PLY file, without Adam moments. Reading and writing the file again gives the same bytes.

    Parameters
    ----------
    gaussians : GaussianMap
        The map.
    path : str or path-like
        The file. An existing file is replaced only when the new one is complete.
    up : {"z", "y", "-y"}
        The up axis that the comment of the file states. The map is not rotated.
    """
    used = gaussians.parameters[:, : gaussians.count]
    rows = np.zeros((gaussians.count, len(PLY_PROPERTIES)), dtype="<f4")
    rows[:, 0:3] = used[MEAN].T
    # Double precision, so that reading and writing the file again gives the same colours.
    rows[:, 6:9] = (used[COLOR].T.astype(np.float64) - 0.5) / _SH_C0
    rows[:, 9] = used[OPACITY_LOGIT]
    rows[:, 10:13] = used[LOG_SCALE].T
    rows[:, 13:17] = used[QUATERNION].T
    vertex = PlyElement("vertex", gaussians.count, tuple(PlyProperty(name, "float") for name in PLY_PROPERTIES))
    header = PlyHeader(BINARY_LITTLE_ENDIAN, (vertex,))
    with replaced(path) as file:
        file.write(header_bytes(header, [f"world frame, {up} up, metres"]))
        file.write(rows.tobytes())


def read_ply(path: str | os.PathLike[str]) -> GaussianMap:
    """Read a binary 3DGS PLY file of either byte order.

    Properties are found by name, and unknown ones are ignored. These include normals and the view-dependent colour
    ``f_rest_*``, since the map has spherical harmonics of degree 0. Gaussians are balls if the file has only
    ``scale_0``, and thin disks if it has only ``scale_0`` and ``scale_1``. Without ``rot_*``, all rotations are the
    identity. Gaussians with a value that is not finite are dropped, with a warning.

    Parameters
    ----------
    path : str or path-like
        The file.

    Returns
    -------
    GaussianMap
        The Gaussians, in metres and in the axes of the file; Adam moments are 0.

    Raises
    ------
    InputError
        The file is missing, damaged, or not a Gaussian splatting PLY.
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
    with np.errstate(over="ignore"):  # a double beyond the range of float32 becomes infinite and is dropped below
        block32 = block.astype(np.float32)
    kept = usable(block32.T)
    if not kept.all():
        dropped = f"dropped {np.count_nonzero(~kept)} of {len(block)} Gaussians: values not finite, or scales too large"
        warnings.warn(f"'{path}': {dropped}", InputWarning, stacklevel=2)
    gaussians = GaussianMap(int(kept.sum()))
    gaussians.append(block32[kept].T)
    return gaussians


def _log_scales(columns, names: set[str]) -> np.ndarray:  # [n, 3]
    if not {"scale_1", "scale_2"} & names:
        return np.repeat(columns("scale_0"), 3, axis=1)
    if "scale_2" not in names:
        plane = columns("scale_0", "scale_1")
        return np.concatenate([plane, plane.min(axis=1, keepdims=True) + _FLAT], axis=1)
    return columns("scale_0", "scale_1", "scale_2")


def _read_vertices(path: str | os.PathLike[str]) -> np.ndarray:  # structured array with one record per vertex
    try:
        with open(path, "rb") as file:
            count, dtype = _vertices(read_header(file), path)
            # The sizes are compared before reading, because a damaged count could require more memory than the file's
            # size.
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
    """Return the number of vertices and the record type of a header; raise `InputError` if it describes no map."""
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
