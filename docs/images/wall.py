"""Make wall.jpg: a wall mapped from one keyframe at 5 m and rendered from 1.3 m, by two rules for seeding Gaussians.

python docs/images/wall.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from activestructure_gym.config import configure
from activestructure_gym.geometry import PinholeCamera, invert_rigid, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.mapping import Mapper
from activestructure_gym.scenes import load_scene
from activestructure_gym.sensors.raycast import RaycastRenderer

SCENE, AWAY, NEAR, SIZE = "apartment?rooms=3&seed=14", 5.0, 1.3, (320, 180)
RULES = {"by pixels (SplaTAM's rule)": {"mapper.seed_spacing": None}, "by the surface (default)": {}}


def main() -> None:
    """Find a free position 5 m from a wall, map its view by both rules, and render the wall from 1.3 m to wall.jpg."""
    scene = load_scene(SCENE)
    renderer, sensor = RaycastRenderer(scene), configure("default").sensor
    camera = PinholeCamera.from_size(sensor.width, sensor.height, sensor.horizontal_fov_deg)
    pose = place(scene, renderer, camera)
    depth = renderer.render(camera, pose)[1]
    ahead = depth[camera.height // 2, camera.width // 2] - NEAR
    near, close = pose.copy(), PinholeCamera.from_size(*SIZE, sensor.horizontal_fov_deg)
    near[:3, 3] += ahead * pose[:3, 2]
    rgb, depth = renderer.render(camera, pose)
    pictures = [("the keyframe, 5 m away", Image.fromarray(rgb).resize(SIZE, Image.Resampling.NEAREST))]
    pictures.append((f"the wall from {NEAR} m", Image.fromarray(renderer.render(close, near)[0])))
    for name, changes in RULES.items():
        mapper = Mapper(configure("default", changes).mapper, np.random.default_rng(0))
        mapper.observe(Frame(rgb, depth, pose, camera))
        shown = np.uint8(255 * np.clip(mapper.render(close, near).color, 0, 1))
        pictures.append((f"{name}: map", Image.fromarray(shown)))
        pictures.append((f"{name}: {len(projected(mapper, close, near))} means", dots(mapper, close, near)))
    width, height = SIZE
    page = Image.new("RGB", (3 * width + 20, 2 * height + 50), "white")
    pen = ImageDraw.Draw(page)
    order = [pictures[0], pictures[2], pictures[4], pictures[1], pictures[3], pictures[5]]
    for number, (title, picture) in enumerate(order):
        x, y = (number % 3) * (width + 10), (number // 3) * (height + 25)
        pen.text((x + 2, y + 4), title, fill="black")
        page.paste(picture, (x, y + 20))
    page.save(Path(__file__).with_name("wall.jpg"), quality=88, optimize=True)


def place(scene, renderer, camera) -> np.ndarray:  # type: ignore[no-untyped-def]  # [4, 4]
    """Return the random pose (world_from_camera), out of 400, that faces a flat wall at a distance closest to 5 m."""
    free, best, found = ground_truth_of(scene).free_space, np.inf, None
    rng = np.random.default_rng(0)
    points = free.sample_positions(400, rng)
    for point, angle in zip(points, rng.uniform(0, 2 * np.pi, len(points))):
        pose = look_along(point, np.array([np.cos(angle), np.sin(angle), 0.0]))
        depth = renderer.render(camera, pose, supersample=1)[1]
        middle = depth[camera.height // 3 : -camera.height // 3, camera.width // 3 : -camera.width // 3]
        cost = abs(float(np.median(middle)) - AWAY) + 5 * float(np.ptp(middle)) if (middle > 0).all() else np.inf
        if cost < best:
            best, found = cost, pose
    assert found is not None
    return found


def projected(mapper: Mapper, camera: PinholeCamera, pose: np.ndarray) -> np.ndarray:  # [n, 2] pixels
    """Return the pixel positions of the means of Gaussians that project into the image of a camera at ``pose``."""
    points = mapper.map.means @ invert_rigid(pose)[:3, :3].T + invert_rigid(pose)[:3, 3]
    points = points[points[:, 2] > 0.1]
    pixels = points[:, :2] / points[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    return pixels[((pixels >= 0) & (pixels < SIZE)).all(axis=1)]


def dots(mapper: Mapper, camera: PinholeCamera, pose: np.ndarray) -> Image.Image:
    """Return an image of a camera at ``pose`` in which the means of a map's Gaussians are dots."""
    picture = Image.new("RGB", SIZE, "white")
    pen = ImageDraw.Draw(picture)
    for x, y in projected(mapper, camera, pose):
        pen.ellipse((x - 1.5, y - 1.5, x + 1.5, y + 1.5), fill=(30, 80, 160))
    return picture


if __name__ == "__main__":
    main()
