import gc
import multiprocessing
import os
import pickle
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.scenes.loaders.cut_out import cut_out
from activestructure_gym.scenes.loaders.mesh_parts import MeshPart, assemble
from activestructure_gym.scenes.loaders.opacity import Opacity
from activestructure_gym.scenes.scene import CLAMP, MIRROR, REPEAT, Scene
from activestructure_gym.sensors import make_renderer
from activestructure_gym.sensors.pyrender_backend import PyrenderRenderer

CAMERA = PinholeCamera.from_size(161, 91)  # rows that are no multiple of 4 bytes


@pytest.mark.parametrize("supersample", [1, 2, 3])
def test_agrees_with_ray_casting(needs_gl, cluttered_room, room_poses, supersample):
    rays, gl = make_renderer("raycast", cluttered_room), make_renderer("pyrender", cluttered_room)
    errors, colors = [], []
    for pose in room_poses:
        rgb, depth = gl.render(CAMERA, pose, supersample=supersample)
        assert (rgb.dtype, depth.dtype) == (np.uint8, np.float32)
        expected = rays.render(CAMERA, pose, supersample=supersample)
        errors.append(np.abs(depth - expected[1]))
        colors.append(np.abs(rgb.astype(int) - expected[0]))
    gl.close()
    errors = np.stack(errors)
    assert np.median(errors) < 1e-4
    assert (errors > 0.01).mean() < 1e-3
    # Same filter, so the same colours: half a grey level of rounding and some pixels along silhouettes.
    assert np.mean(colors) < 0.5


def test_linear_colours_and_wrapped_textures_agree_with_ray_casting(needs_gl, cluttered_room, room_poses):
    mesh = cluttered_room.mesh
    colors = np.random.default_rng(3).random(mesh.colors.shape, np.float32)
    wraps = ((CLAMP, MIRROR), (MIRROR, CLAMP), (REPEAT, CLAMP))
    mesh = replace(mesh, colors=colors, uv=3 * mesh.uv - 1, texture_wrap=wraps, linear_colors=True)
    scene = Scene("odd", mesh, "tests")
    for pose in room_poses[:3]:
        seen = [make_renderer(name, scene).render(CAMERA, pose)[0].astype(int) for name in ("raycast", "pyrender")]
        assert np.abs(seen[0] - seen[1]).mean() < 0.5


def test_both_renderers_see_through_what_is_transparent(needs_gl, box_room):
    """A wall across the room with a round opening in its picture, which is cut out when the scene is loaded."""
    x, y = np.meshgrid(np.linspace(-1, 1, 64), np.linspace(-1, 1, 64))
    picture = np.where(np.hypot(x, y) < 0.6, 0, 255).astype(np.uint8)
    corners = np.array([[2, 0, 0], [2, 3, 0], [2, 3, 2.5], [2, 0, 2.5]], dtype=np.float64)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype=np.float64)
    wall = MeshPart(corners, np.array([[0, 1, 2], [0, 2, 3]]), np.ones(3), opacity=Opacity(picture=picture, uv=uv))
    mesh = box_room.mesh
    room = MeshPart(mesh.vertices, mesh.faces, mesh.colors)
    scene = Scene("opening", assemble(cut_out([room, wall])[0], ()), "tests")
    pose = look_along((0.5, 1.5, 1.25), (1.0, 0.0, 0.0))
    rays, gl = (make_renderer(name, scene).render(CAMERA, pose)[1] for name in ("raycast", "pyrender"))
    assert rays[CAMERA.height // 2, CAMERA.width // 2] == pytest.approx(3.5, abs=1e-3)  # through the opening
    assert rays[CAMERA.height // 2, 0] == pytest.approx(1.5, abs=1e-3)  # the wall beside it
    assert (np.abs(rays - gl) > 0.01).mean() < 2e-3


def test_nothing_ahead_is_black_with_depth_0(needs_gl, box_room):
    outside = np.eye(4)
    outside[:3, 3] = (0, 0, 50)
    rgb, depth = PyrenderRenderer(box_room).render(CAMERA, outside)
    assert not rgb.any() and not depth.any()


def test_closing_one_leaves_the_others(needs_gl, box_room, cluttered_room, room_poses):
    first, second, other = (PyrenderRenderer(s) for s in (box_room, box_room, cluttered_room))
    expected = [r.render(CAMERA, room_poses[0])[1] for r in (first, second, other)]
    assert first._context is second._context  # one upload per scene
    first.close()
    first.close()
    np.testing.assert_array_equal(second.render(CAMERA, room_poses[0])[1], expected[1])
    second.close()
    gc.collect()  # now the context of the box room is gone
    np.testing.assert_array_equal(other.render(CAMERA, room_poses[0])[1], expected[2])
    np.testing.assert_array_equal(first.render(CAMERA, room_poses[0])[1], expected[0])


def test_many_contexts_one_after_the_other(needs_gl, box_room, room_poses):
    depths = []
    for _ in range(5):
        scene = Scene("copy", box_room.mesh, "tests")
        depths.append(PyrenderRenderer(scene).render(CAMERA, room_poses[0])[1])
    assert all(np.array_equal(depth, depths[0]) for depth in depths)


def test_any_thread_may_draw(needs_gl, cluttered_room, room_poses):
    renderer = PyrenderRenderer(cluttered_room)
    expected = [renderer.render(CAMERA, pose)[1] for pose in room_poses]
    with ThreadPoolExecutor(3) as pool:
        got = list(pool.map(lambda pose: renderer.render(CAMERA, pose)[1], room_poses))
    for one, other in zip(expected, got):
        np.testing.assert_array_equal(one, other)


def test_pickle_draws_in_a_new_process(needs_gl, cluttered_room, room_poses, tmp_path):
    renderer = PyrenderRenderer(cluttered_room)
    expected = renderer.render(CAMERA, room_poses[0])[1]
    (tmp_path / "renderer.pkl").write_bytes(pickle.dumps((renderer, CAMERA, room_poses[0])))
    code = """
        import pickle, sys, numpy as np
        renderer, camera, pose = pickle.load(open(sys.argv[1] + "/renderer.pkl", "rb"))
        np.save(sys.argv[1] + "/depth.npy", renderer.render(camera, pose)[1])
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(code), str(tmp_path)], check=True, timeout=60)
    np.testing.assert_array_equal(np.load(tmp_path / "depth.npy"), expected)


def draw_in_child(renderer, pose, queue):
    try:
        renderer.render(CAMERA, pose)
        queue.put("drew")
    except InputError as error:
        queue.put(str(error))


def test_a_fork_after_opengl_is_refused_instead_of_hanging(needs_gl, box_room, room_poses):
    renderer = PyrenderRenderer(box_room)
    renderer.render(CAMERA, room_poses[0])
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=draw_in_child, args=(renderer, room_poses[0], queue))
    child.start()
    try:
        assert "'spawn' or 'forkserver'" in queue.get(timeout=20)
    finally:
        child.kill()
        child.join()


def test_numpy_alias_of_pyrender_is_back(needs_gl, box_room):
    PyrenderRenderer(box_room)
    import pyrender

    mesh = pyrender.Mesh([pyrender.Primitive(positions=np.eye(3))])
    np.testing.assert_array_equal(mesh.bounds, [[0, 0, 0], [1, 1, 1]])


MISSING = """
    import sys

    class NoGL:
        def find_spec(self, name, path=None, target=None):
            if name == {module!r}:
                raise {error}

    sys.meta_path.insert(0, NoGL())
    from activestructure_gym.errors import InputError
    from activestructure_gym.sensors import make_renderer
    for _ in range(2):  # the second try meets half-imported modules
        try:
            make_renderer("pyrender", None)
        except InputError as error:
            print(error)
"""


@pytest.mark.parametrize(
    ("module", "error", "hint"),
    [
        ("OpenGL.GL", "ImportError('Unable to load EGL library')", "libegl1 libgl1"),
        ("OpenGL.EGL", "AttributeError('no attribute glGetError')", "libegl1 libgl1"),
        ("pyrender", "ModuleNotFoundError('No module', name='pyrender')", "pip install pyrender"),
    ],
)
def test_what_is_missing_is_named(module, error, hint):
    code = textwrap.dedent(MISSING).format(module=module, error=error)
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    lines = answer.stdout.strip().splitlines()
    assert len(lines) == 2 and all(hint in line for line in lines), answer


def test_another_platform_is_refused():
    code = "from activestructure_gym.sensors import renderer_status; print(renderer_status()['pyrender'])"
    answer = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYOPENGL_PLATFORM": "glx"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert "PYOPENGL_PLATFORM is 'glx'; set it to 'egl'" in answer.stdout
