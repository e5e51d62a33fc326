"""Measure the recall and precision of plane detection by true planes, and the time of detection and plane graph.

True planes come from the mesh, which gives the triangle of every pixel. A plane begins with the triangle that has the
most pixels. Triangles join it if their normals differ by at most 3 degrees and their pixels are within 5 mm + 1.5
sigma(z), where sigma(z) is the depth noise. So planes that the sensor cannot separate count as one. Pixels beyond the
detector's range or at grazing angles are left out. Only planes and detected segments of at least 1 % of the image are
counted (docs/notebook/lab_notes.md). A plane is found, and a segment is correct, if their intersection over union is
at least one half.

*Clear* planes are large faces, for example of walls and boxes. A clear plane contains a circle with a diameter of 1/20
of the image's width, and no other true plane is so near that the plane graph would join both (8 degrees, 5 cm). Frames,
skirtings, slats and panels in front of a wall are not clear.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from activestructure_gym.evaluation.benchmarks.sensors import benchmark_views
from activestructure_gym.evaluation.cli.bench import print_rows
from activestructure_gym.evaluation.cli.options import split_scenes
from activestructure_gym.evaluation.cli.output import make_console
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.depth_noise import GROWTH, MIN_DEPTH_M, MIN_SIGMA_M, axial_sigma
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.planes.detection import PlaneDetectionConfig, depth_noise_scale, segment_planes
from activestructure_gym.planes.graph import PlaneSceneGraph
from activestructure_gym.planes.matching import MatchingConfig
from activestructure_gym.planes.sparseness import MapPoints
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.sensors.noise import DepthNoise, noisy_depth
from benchmarks.command import run

SCENES = ("room?seed=3", "apartment?rooms=4&seed=2")
SIZES = ((160, 90), (320, 180))  # (width, height) in pixels
NOISES: tuple[DepthNoise, ...] = ("none", "kinect")
CANDIDATES = 256  # number of candidate views
PLANES = 60  # number of planes in the graph for which times are reported
_LARGE = 0.01  # share of the image; smaller planes and segments are not counted
_SMALL = 0.003  # share of the image; smaller planes next to a plane do not make it unclear
_FACE_ANGLE_DEG = 3.0  # degrees; largest angle between the normals of joined triangles
_WIDE = 0.025  # share of the image's width; least radius of the largest circle inside a clear plane

Labels = np.ndarray  # [H, W] int: index of the plane or segment of each pixel, -1 for none
Detector = Callable[[Frame], tuple[Labels, np.ndarray]]  # returns labels, and normals [S, 3] of S segments in the world


@dataclass(frozen=True)
class TruePlanes:
    """Hold the K true planes of one view."""

    depth: np.ndarray  # [H, W] float32 metres, without noise
    labels: Labels
    planes: np.ndarray  # [K, 4] unit normal towards the camera, and offset in metres, world frame
    large: np.ndarray  # [K] bool: has at least the share `_LARGE` of the image
    clear: np.ndarray  # [K] bool: is large and clear
    structural: np.ndarray  # [K] bool: is structural by the scene's face labels; False without labels


@dataclass
class Tally:
    """Count true planes and detected segments over all views."""

    large: int = 0  # large planes
    found: int = 0  # large planes that were found
    clear: int = 0
    clear_found: int = 0
    structural: int = 0
    structural_found: int = 0
    segments: int = 0  # large segments
    right: int = 0  # large segments that are correct
    angles: tuple[float, ...] = ()  # degrees between the normals of found planes and their segments

    def figures(self) -> dict[str, float]:
        """Return recall, recall of clear planes, precision and median angle (degrees); NaN if nothing was counted."""
        parts = {
            "recall": (self.found, self.large),
            "clear_recall": (self.clear_found, self.clear),
            "precision": (self.right, self.segments),
        }
        shares = {name: part / whole if whole else float("nan") for name, (part, whole) in parts.items()}
        return shares | {"angle_deg": float(np.median(self.angles)) if self.angles else float("nan")}


def true_planes(
    scene: Scene,
    camera: PinholeCamera,
    pose: np.ndarray,  # [4, 4] world_from_camera
    *,
    noise_scale: float,  # multiple of the Kinect noise that sigma(z) assumes, as in `PlaneDetectionConfig`
    config: PlaneDetectionConfig | None = None,  # limits of range and incidence
    matching: MatchingConfig | None = None,  # limits within which the graph joins two planes
) -> TruePlanes:
    """Return the true planes of one view, joined from the triangles of the mesh as the module's docstring describes."""
    config, matching = config or PlaneDetectionConfig(), matching or MatchingConfig()
    shape = (camera.height, camera.width)
    eye = pose[:3, 3]
    rays = camera.rays().reshape(-1, 3) @ pose[:3, :3].T.astype(np.float32)
    hits = scene.raycaster.cast(eye, rays)
    depth = np.where(np.isfinite(hits.distance), hits.distance, 0.0).astype(np.float32)
    face, at = np.unique(hits.face, return_inverse=True)
    corners = scene.mesh.vertices[scene.mesh.faces[np.maximum(face, 0)]].astype(np.float64)  # [F, 3, 3]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(length, 1e-12)[:, None]
    normals *= np.where(((eye - corners[:, 0]) * normals).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    sight = rays.astype(np.float64) * depth[:, None]
    cosine = -(sight * normals[at]).sum(axis=1) / np.maximum(np.linalg.norm(sight, axis=1), 1e-9)
    usable = (depth > 0) & (depth <= config.max_depth) & (cosine > np.cos(np.radians(config.max_incidence_deg)))
    points = sight + eye
    gap = 0.005 + 1.5 * noise_scale * axial_sigma(depth)
    pixels = np.bincount(at[usable], minlength=len(face)) * ((face >= 0) & (length > 1e-12))
    parallel = np.cos(np.radians(_FACE_ANGLE_DEG))

    labels = np.full(len(depth), -1)
    planes: list[list] = []
    seeds: list[int] = []
    while pixels.any():
        seed = int(pixels.argmax())
        normal = normals[seed]
        offset = -normal @ corners[seed, 0]
        open_ = usable & (pixels[at] > 0)
        own = open_ & (normals[at] @ normal > parallel) & (np.abs(points @ normal + offset) < gap)
        if own.sum() >= 3:  # fit the common plane of all joined pixels
            centre = points[own].mean(axis=0)
            fitted = np.linalg.eigh(np.cov((points[own] - centre).T))[1][:, 0]
            fitted = fitted * (1.0 if fitted @ normal > 0 else -1.0)
            if fitted @ normal > parallel:
                normal, offset = fitted, -fitted @ centre
                own = open_ & (normals[at] @ normal > parallel) & (np.abs(points @ normal + offset) < gap)
        labels[own] = len(planes)
        planes.append([*normal, offset])
        seeds.append(face[seed])
        pixels[at[own]] = 0
        pixels[seed] = 0
    table = np.array(planes).reshape(-1, 4)
    sizes = np.bincount(labels[labels >= 0], minlength=len(table))
    large = sizes >= _LARGE * len(depth)
    structural = np.zeros(len(table), bool)
    if scene.labels is not None and len(seeds):
        structural = scene.labels.structural[scene.labels.face_part[np.array(seeds)]]
    sums = np.stack([np.bincount(labels[labels >= 0], points[labels >= 0, k], minlength=len(table)) for k in range(3)])
    centroids = sums.T / np.maximum(sizes, 1)[:, None]
    away = np.abs(table[:, :3] @ centroids.T + table[:, 3:])
    near = table[:, :3] @ table[:, :3].T > np.cos(np.radians(matching.coplanar_angle_deg))
    near &= np.minimum(away, away.T) < matching.coplanar_distance
    near &= np.linalg.norm(centroids[:, None] - centroids[None], axis=2) < matching.coplanar_reach
    np.fill_diagonal(near, False)
    labels = labels.reshape(shape)
    clear = large & ~(near & (sizes >= _SMALL * len(depth))[None]).any(axis=1)
    for plane in np.flatnonzero(clear):
        inside = cv2.distanceTransform(np.pad(labels == plane, 1).astype(np.uint8), cv2.DIST_L2, 5)
        clear[plane] = inside.max() >= _WIDE * camera.width
    return TruePlanes(depth.reshape(shape), labels, table, large, clear, structural)


def score_segments(
    labels: Labels,
    normals: np.ndarray,  # [S, 3] world
    truth: TruePlanes,
    tally: Tally,
) -> None:
    """Compare the S segments ``labels`` of one view with its true planes, and add the counts to ``tally``."""
    count, total = len(normals), len(truth.planes)
    both = (labels >= 0) & (truth.labels >= 0)
    shared = np.bincount(truth.labels[both] * count + labels[both], minlength=total * count).reshape(total, count)
    true_size = np.bincount(truth.labels[truth.labels >= 0], minlength=total)
    size = np.bincount(labels[labels >= 0], minlength=count)
    same = 2 * shared >= np.maximum(true_size[:, None] + size[None] - shared, 1)
    found = same.any(axis=1)
    tally.large += int(truth.large.sum())
    tally.found += int((truth.large & found).sum())
    tally.clear += int(truth.clear.sum())
    tally.clear_found += int((truth.clear & found).sum())
    tally.structural += int((truth.large & truth.structural).sum())
    tally.structural_found += int((truth.large & truth.structural & found).sum())
    large = size >= _LARGE * labels.size
    tally.segments += int(large.sum())
    tally.right += int((large & same.any(axis=0)).sum())
    for plane in np.flatnonzero(truth.large & found):
        cosine = abs(truth.planes[plane, :3] @ normals[same[plane].argmax()])
        tally.angles += (float(np.degrees(np.arccos(min(1.0, cosine)))),)


def opencv_detector(camera: PinholeCamera, *, noisy: bool) -> Detector | None:
    """Return a detector that uses OpenCV's plane finder, or None if OpenCV is older than version 5 and has none.

    ``noisy`` says whether images have Kinect noise. Block and segment sizes are the best measured ones: blocks of 4
    pixels for images of 160 pixels width (docs/notebook/lab_notes.md).
    """
    if not hasattr(cv2, "findPlanes") or not hasattr(cv2, "RgbdNormals_create"):
        return None
    matrix = camera.matrix.astype(np.float32)
    matrix[:2, 2] -= 0.5  # the origin of OpenCV's pixel coordinates is the centre of the first pixel
    shape = (camera.height, camera.width)
    method = cv2.RgbdNormals_RGBD_NORMALS_METHOD_FALS  # type: ignore[attr-defined]
    finder = cv2.RgbdNormals_create(*shape, cv2.CV_32F, matrix, 5, 50.0, method)  # type: ignore[attr-defined]
    block = max(4, camera.width // 40)
    # Coefficients a, b, c of the depth noise `axial_sigma`, written as a z^2 + b z + c.
    error = (GROWTH, -2.0 * GROWTH * MIN_DEPTH_M, MIN_SIGMA_M + GROWTH * MIN_DEPTH_M**2) if noisy else (0.0, 0.0, 0.0)

    def detect(frame: Frame) -> tuple[Labels, np.ndarray]:
        points = cv2.depthTo3d(np.where(frame.depth > 0, frame.depth, np.nan).astype(np.float32), matrix)
        mask, planes = cv2.findPlanes(
            points, finder.apply(points), None, None, block, int(0.006 * frame.depth.size), 0.01, *error
        )
        labels = np.where(mask == 255, -1, mask.astype(np.int64))
        found = np.zeros((int(labels.max(initial=-1)) + 1, 3))
        if planes is not None:
            found[: len(planes)] = np.asarray(planes).reshape(-1, 4)[: len(found), :3]
        return labels, found @ frame.world_from_camera[:3, :3].T

    return detect


def detection_rows(
    scene: Scene,
    *,
    sizes: Sequence[tuple[int, int]] = SIZES,  # (width, height)
    noises: Sequence[DepthNoise] = NOISES,
    views: int = 20,
    seed: int = 3,
) -> list[dict[str, Any]]:
    """Return one row per image size and noise, with results of this package's detector and of OpenCV (``cv2_``).

    A row has the number of planes in all ``views``, recall, precision, the median angle in degrees, and the median wall
    time in ms.
    """
    poses = benchmark_views(scene, views, np.random.default_rng(seed))
    rows = []
    for size in sizes:
        camera = PinholeCamera.from_size(*size)
        for noise in noises:
            rng = np.random.default_rng(seed + 1)
            scale = depth_noise_scale(noise)
            truths = [true_planes(scene, camera, pose, noise_scale=scale) for pose in poses]
            frames = [
                Frame(
                    np.zeros((camera.height, camera.width, 3), np.uint8),
                    noisy_depth(truth.depth, camera, rng, model=noise),
                    pose,
                    camera,
                )
                for truth, pose in zip(truths, poses)
            ]
            ours, time_ours = _measured(_our_detector(scale), frames, truths)
            row: dict[str, Any] = {"scene": scene.name, "size": f"{size[0]}x{size[1]}", "noise": noise}
            row |= {"planes": ours.large, "clear": ours.clear} | ours.figures()
            if scene.labels is not None and ours.structural:
                row["structural_recall"] = ours.structural_found / ours.structural
            row["ms"], row["ms_q1_q3"] = float(np.median(time_ours)), tuple(np.percentile(time_ours, (25, 75)).tolist())
            other = opencv_detector(camera, noisy=noise != "none")
            if other is not None:
                theirs, time_theirs = _measured(other, frames, truths)
                row |= {f"cv2_{name}": value for name, value in theirs.figures().items()}
                row["cv2_ms"] = float(np.median(time_theirs))
            rows.append(row)
    return rows


def graph_rows(
    scene: Scene, *, keyframes: int = 60, candidates: int = CANDIDATES, seed: int = 5
) -> list[dict[str, Any]]:
    """Return one row with the wall time of plane detection and plane graph per decision, in milliseconds.

    Times are medians over a third of the keyframes: those in which the number of planes in the graph is closest to 60.
    ``sum_ms`` excludes detection. It includes the update of the graph with quality, surprise and deficits, the
    visibility of planes from all candidates, and the features `structure` and `deficiency`. Views are drawn as in
    `detection_rows`; sensor, map, volume and threads are as in the preset ``default``.
    """
    from activestructure_gym.config import configure
    from activestructure_gym.features import FEATURES, FeatureContext
    from activestructure_gym.mapping import Mapper, MapperConfig
    from activestructure_gym.mapping.gaussian_map import LOG_SCALE, MEAN
    from activestructure_gym.sensors import RGBDSensor
    from activestructure_gym.volume import VoxelVolume

    config, rng = configure(), np.random.default_rng(seed)
    poses, offered = benchmark_views(scene, keyframes, rng), benchmark_views(scene, candidates, rng)
    sensor, mapper = RGBDSensor(scene, config.sensor, rng), Mapper(MapperConfig(), rng)
    volume, graph = VoxelVolume(scene.bounds, config.volume), PlaneSceneGraph(config.planes)
    seconds: dict[str, list[float]] = {
        name: [] for name in ("detection", "update", "visibility", "structure", "deficiency")
    }
    counts = []
    for pose in poses:
        frame = sensor.capture(pose)
        volume.integrate(frame, sensor_range=config.sensor.max_range)
        mapper.observe(frame)
        context = FeatureContext(
            mapper=mapper,
            volume=volume,
            planes=graph,
            camera=config.sensor.camera.resized(
                max(1, round(config.sensor.width * config.views.scoring_scale)),
                max(1, round(config.sensor.height * config.views.scoring_scale)),
            ),
            bounds=scene.bounds,
            coverage_alpha=config.views.coverage_alpha,
            max_range=config.sensor.max_range,
            world_from_camera=offered,
        )
        marks = [time.perf_counter()]
        detection = segment_planes(frame, graph.config.detection)
        marks.append(time.perf_counter())
        live = mapper.map.parameters[:, : mapper.map.count]
        points = MapPoints.from_log_scales(live[MEAN], live[LOG_SCALE])
        graph.integrate(frame, detection)
        graph.assess(space_state=volume.state_at, map_points=points)
        marks.append(time.perf_counter())
        _ = context.visible  # computed here, so the times of the features do not include it
        marks.append(time.perf_counter())
        for feature in ("structure", "deficiency"):
            FEATURES.get(feature)(context)
            marks.append(time.perf_counter())
        for name, taken in zip(seconds, np.diff(marks)):
            seconds[name].append(1000.0 * taken)
        counts.append(len(graph.nodes))
    # The first keyframe is left out, since kernels are compiled during it.
    near = 1 + np.argsort(np.abs(np.array(counts[1:]) - PLANES), kind="stable")[: max(1, keyframes // 3)]
    row: dict[str, Any] = {"scene": scene.name, "keyframes": keyframes, "candidates": candidates}
    row["nodes"] = tuple(np.percentile([counts[k] for k in near], (0, 100)).astype(int).tolist())
    row |= {f"{name}_ms": float(np.median(np.array(values)[near])) for name, values in seconds.items()}
    total = np.sum([np.array(values)[near] for name, values in seconds.items() if name != "detection"], axis=0)
    return [row | {"sum_ms": float(np.median(total)), "sum_q1_q3": tuple(np.percentile(total, (25, 75)).tolist())}]


def _our_detector(noise_scale: float) -> Detector:
    config = PlaneDetectionConfig(depth_noise_scale=noise_scale)

    def detect(frame: Frame) -> tuple[Labels, np.ndarray]:
        found = segment_planes(frame, config)
        return found.labels, np.array([segment.normal for segment in found.segments]).reshape(-1, 3)

    return detect


def _measured(detect: Detector, frames: Sequence[Frame], truths: Sequence[TruePlanes]) -> tuple[Tally, np.ndarray]:
    tally = Tally()
    detect(frames[0])  # compiles kernels
    taken = np.empty(len(frames))
    for k, (frame, truth) in enumerate(zip(frames, truths)):
        start = time.perf_counter()
        labels, normals = detect(frame)
        taken[k] = 1000.0 * (time.perf_counter() - start)
        score_segments(labels, normals, truth, tally)
    return tally, taken


@dataclass(frozen=True)
class Planes:
    """Measure plane detection in depth images next to OpenCV's, and the cost of the plane graph per decision."""

    scenes: tuple[str, ...] = ()
    """Use these scenes, separated by commas or spaces; by default a room and an apartment."""
    quick: bool = False
    """Run a small version, which shows only that the benchmark works."""

    def run(self) -> int:
        """Measure, print a table, and return 0."""
        from activestructure_gym.scenes.library import load_scene

        console = make_console()
        sizes, views, keyframes = (SIZES[:1], 4, 8) if self.quick else (SIZES, 20, 60)
        with console.status("measuring the planes"):
            loaded = [load_scene(spec) for spec in split_scenes(self.scenes) or SCENES]
            rows = [row for scene in loaded for row in detection_rows(scene, sizes=sizes, views=views)]
            costs = [row for scene in loaded for row in graph_rows(scene, keyframes=keyframes)]
        print_rows(console, costs, "milliseconds of the planes per decision, 256 candidates")
        print_rows(console, rows, "planes found on this machine, and those of OpenCV")
        return 0


if __name__ == "__main__":
    sys.exit(run(Planes))
