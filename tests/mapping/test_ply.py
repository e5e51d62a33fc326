"""3DGS PLY files: written as other tools expect them, read by name from whatever other tools write."""

import struct

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.mapping import GaussianMap, read_ply, write_ply
from activestructure_gym.mapping.ply import PLY_PROPERTIES

C0 = 0.28209479177387814


def _filled(count, seed=0):
    rng = np.random.default_rng(seed)
    gaussians = GaussianMap()
    block = rng.normal(size=(14, count)).astype(np.float32)
    block[11:] = rng.uniform(-0.2, 1.2, (3, count))
    gaussians.append(block)
    return gaussians


def _write(path, properties, rows, *, order="little", extra=""):
    header = f"ply\nformat binary_{order}_endian 1.0\n{extra}element vertex {len(rows)}\n"
    header += "".join(f"property {kind} {name}\n" for name, kind in properties) + "end_header\n"
    codes = {"float": "f", "double": "d", "uchar": "B"}
    layout = "<>"[order == "big"] + "".join(codes[kind] for _, kind in properties)
    path.write_bytes(header.encode() + b"".join(struct.pack(layout, *row) for row in rows))
    return path


def test_header_and_first_record_by_hand(tmp_path):
    gaussians = GaussianMap()
    gaussians.append(np.array([[1, 2, 3, 1, 0, 0, 0, -1, -2, -3, 0.25, 0.5, 0.5 + C0, 0.5 - C0]], np.float32).T)
    write_ply(gaussians, tmp_path / "map.ply")
    header, _, body = (tmp_path / "map.ply").read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"] and "element vertex 1" in lines
    names = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
    assert [line for line in lines if line.startswith("property")] == [f"property float {name}" for name in names]
    # colour .5 has no constant term; .5 +- C0 has +-1
    expected = [1, 2, 3, 0, 0, 0, 0, 1, -1, 0.25, -1, -2, -3, 1, 0, 0, 0]
    assert struct.unpack("<17f", body) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("count", [0, 1, 5000])
def test_round_trip_is_byte_exact(tmp_path, count):
    gaussians = _filled(count)
    write_ply(gaussians, tmp_path / "first.ply")
    loaded = read_ply(tmp_path / "first.ply")
    write_ply(loaded, tmp_path / "second.ply")
    assert (tmp_path / "first.ply").read_bytes() == (tmp_path / "second.ply").read_bytes()
    assert loaded.count == count
    assert np.array_equal(loaded.parameters[:11, :count], gaussians.parameters[:11, :count])
    # A colour near 0 has finer float steps than its coefficient near -2: half a step of that is 3.4e-8 in colour.
    assert np.abs(loaded.colors - gaussians.colors).max(initial=0) < 4e-8


@pytest.mark.parametrize("order", ["little", "big"])
def test_properties_are_found_by_name(tmp_path, order):
    """Shuffled order, other types, normals missing, view-dependent colour and unknown columns present."""
    values = dict(zip(PLY_PROPERTIES, [1, 2, 3, 0, 0, 0, 0.1, 0.2, 0.3, 0.5, -1, -2, -3, 0.5, 0.5, 0.5, 0.5]))
    names = [name for name in reversed(PLY_PROPERTIES) if not name.startswith("n")]
    properties = [("red", "uchar"), *((name, "double" if name == "x" else "float") for name in names)]
    properties += [("f_rest_0", "float")]
    row = [17, *(values[name] for name in names), 9.0]
    extra = "comment made elsewhere\nobj_info here\n"
    loaded = read_ply(_write(tmp_path / "other.ply", properties, [row], order=order, extra=extra))
    assert loaded.parameters[:, 0] == pytest.approx(
        [1, 2, 3, 0.5, 0.5, 0.5, 0.5, -1, -2, -3, 0.5, *(0.5 + C0 * np.array([0.1, 0.2, 0.3]))]
    )


def _simple(path, scales, rows):
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", *scales]
    return _write(path, [(name, "float") for name in names], rows)


def test_isotropic_and_flat_files(tmp_path):
    ball = read_ply(_simple(tmp_path / "ball.ply", ["scale_0"], [[0] * 7 + [-2]]))
    assert ball.parameters[3:10, 0].tolist() == [1, 0, 0, 0, -2, -2, -2]
    disk = read_ply(_simple(tmp_path / "disk.ply", ["scale_0", "scale_1"], [[0] * 7 + [-2, -1]]))
    assert disk.parameters[7:10, 0] == pytest.approx([-2, -1, -2 + np.log(0.1)])


def test_rows_that_are_not_finite_are_dropped_one_by_one(tmp_path):
    rows = [[k] * 7 + [-2] for k in range(5)]
    rows[1][0], rows[3][6], rows[4][7] = np.nan, np.inf, 100.0  # e^100 m is infinite in float32
    path = _simple(tmp_path / "damaged.ply", ["scale_0"], rows)
    with pytest.warns(UserWarning, match="dropped 3 of 5"):
        loaded = read_ply(path)
    assert loaded.means[:, 0].tolist() == [0, 2]


def test_a_scale_that_is_left_out_is_told(tmp_path):
    path = _simple(tmp_path / "gap.ply", ["scale_0", "scale_2"], [[0] * 7 + [-2, -1]])
    with pytest.raises(InputError, match="expected the vertex property 'scale_1'"):
        read_ply(path)


def test_other_elements_behind_the_vertices_are_ignored(tmp_path):
    path = _simple(tmp_path / "mesh.ply", ["scale_0"], [[1] * 7 + [-2]])
    faces = b"element face 1\nproperty list uchar int vertex_indices\n"
    path.write_bytes(path.read_bytes().replace(b"end_header", faces + b"end_header") + b"\x03" + bytes(12))
    assert read_ply(path).count == 1


GOOD = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\n"


@pytest.mark.parametrize(
    "content, message",
    [
        (None, "no file"),
        (b"", "does not begin with 'ply'"),
        (b"solid thing", "does not begin with 'ply'"),
        (GOOD, "no 'end_header'"),
        (GOOD + b"end_header\n\0\0", "cut off"),
        (GOOD + b"end_header\n\0\0\0\0", "vertex property 'y'"),
        (GOOD.replace(b"vertex 1", b"vertex 99999999999999") + b"end_header\n", "cut off"),
        (GOOD.replace(b"binary_little_endian", b"ascii") + b"end_header\n1\n", "'ascii' format"),
        (GOOD.replace(b"vertex", b"face"), "element 'vertex' first"),
        (GOOD + b"property float x\nend_header\n", "appear twice"),
        (GOOD + b"property list uchar int x\nend_header\n", "property 'list"),
        (GOOD + b"nonsense\n", "header line 'nonsense'"),
        (b"ply\nelement vertex 1\nproperty float x\nend_header\n", "lacks the format"),
    ],
)
def test_files_that_are_no_splats_are_refused(tmp_path, content, message):
    if content is not None:
        (tmp_path / "map.ply").write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_ply(tmp_path / "map.ply")


@pytest.mark.slow
def test_splat_transform_reads_the_file_and_writes_it_back(tmp_path):
    """The converter behind SuperSplat, where node and the package (installed or in npm's reach) are."""
    import shutil
    import subprocess

    if shutil.which("npx") is None:
        pytest.skip("npx is not here")
    gaussians = _filled(500)
    gaussians.parameters[3:7] /= np.linalg.norm(gaussians.parameters[3:7], axis=0)
    write_ply(gaussians, tmp_path / "map.ply")
    command = ["npx", "--yes", "@playcanvas/splat-transform", "map.ply", "again.ply"]
    try:
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    except subprocess.TimeoutExpired:
        pytest.skip("npm does not answer")
    if done.returncode and not (tmp_path / "again.ply").exists() and "npm" in done.stderr and "ERR" in done.stderr:
        pytest.skip(f"the package cannot be had: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    again = read_ply(tmp_path / "again.ply")
    order, back = (np.lexsort(g.means.T) for g in (gaussians, again))  # it may sort them
    np.testing.assert_allclose(again.means[back], gaussians.means[order], atol=1e-6)
    np.testing.assert_allclose(again.colors[back], gaussians.colors[order], atol=1e-6)
    np.testing.assert_allclose(again.scales[back], gaussians.scales[order], rtol=1e-5)
