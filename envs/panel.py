"""Draw the image that ``render()`` returns: camera, map and floor plan side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from activestructure_gym.volume import FREE, OCCUPIED

if TYPE_CHECKING:
    from activestructure_gym.reconstruction import Reconstruction
    from activestructure_gym.sensors import Frame
    from activestructure_gym.volume import VoxelVolume

TILE = (270, 480)  # height and width in pixels of the camera image and of the rendered map
# Okabe-Ito colours, legible to colour-blind readers.
UNKNOWN_COLOUR, FREE_COLOUR, OCCUPIED_COLOUR = (120, 124, 130), (245, 245, 240), (40, 44, 52)
PARTLY_COLOUR = (200, 192, 178)  # occupied at some heights, free at others: the camera may pass above or below
PATH_COLOUR, AGENT_COLOUR, CANDIDATE_COLOUR = (0, 114, 178), (213, 94, 0), (0, 158, 115)
MARGIN, CAPTION = 8, 26  # pixels: left margin and height of a caption


def draw_panel(reconstruction: Reconstruction, frame: Frame) -> np.ndarray:  # [H, W, 3] uint8
    """Draw the last keyframe, the map rendered at its pose, and the plan with path, agent and candidates."""
    rendered = reconstruction.mapper.render(frame.camera, frame.world_from_camera).color
    views = [_fit(frame.rgb, TILE), _fit((np.clip(rendered, 0, 1) * 255).astype(np.uint8), TILE)]
    left = np.concatenate([_captioned(views[0], "camera"), _captioned(views[1], "Gaussian map")], axis=0)
    plan = _fit(draw_plan(reconstruction, left.shape[0] - CAPTION), (left.shape[0] - CAPTION, left.shape[0]))
    text = (
        f"frame {reconstruction.frames}/{reconstruction.frame_budget}   {reconstruction.metres:.1f} m   "
        f"{reconstruction.mapper.map.count} Gaussians   {len(reconstruction.planes.nodes)} planes"
    )
    return np.concatenate([left, _captioned(plan, text)], axis=1)


def plan_image(volume: VoxelVolume, height_m: float) -> np.ndarray:  # [X, Y, 3] uint8
    """Return a top view of the volume's voxels within 0.5 m above and below ``height_m`` (metres, world).

    A pixel is a column of voxels. It is dark if the known voxels are all occupied, and light if they are all free.
    It has a colour in between if both occur, for example at a table below the camera.
    """
    center = int(volume.voxel_of(np.array([[volume.origin[0], volume.origin[1], height_m]]))[0, 2])
    half = max(1, round(0.5 / volume.config.voxel_size))
    band = volume.state[:, :, max(0, center - half) : center + half + 1]
    free, occupied = (band == FREE).any(axis=2), (band == OCCUPIED).any(axis=2)
    image = np.empty((*band.shape[:2], 3), np.uint8)
    image[:] = UNKNOWN_COLOUR
    image[free] = FREE_COLOUR
    image[occupied] = OCCUPIED_COLOUR
    image[free & occupied] = PARTLY_COLOUR
    return image


def draw_plan(reconstruction: Reconstruction, size: int) -> np.ndarray:  # [h, w, 3] uint8, longer side = size
    """Draw the plan at the agent's height, with the y axis up."""
    volume = reconstruction.volume
    image = plan_image(volume, reconstruction.pose[2, 3])
    scale = size / max(image.shape[:2])
    # Image rows run in the direction of -y.
    image = np.ascontiguousarray(image.transpose(1, 0, 2)[::-1])
    width, height = round(image.shape[1] * scale), round(image.shape[0] * scale)
    image = cv2.resize(image, (width, height), interpolation=cv2.INTER_NEAREST)

    def pixel(points: np.ndarray) -> np.ndarray:  # [N, >=2] world -> [N, 2] pixels
        cells = (points[:, :2] - volume.origin[:2]) / volume.config.voxel_size
        return np.stack([cells[:, 0] * scale, height - cells[:, 1] * scale], axis=1).round().astype(np.int32)

    for position in np.unique(reconstruction.candidates.world_from_camera[:, :3, 3], axis=0):
        cv2.circle(image, pixel(position[None])[0].tolist(), 3, CANDIDATE_COLOUR, -1, cv2.LINE_AA)
    path = pixel(np.stack(reconstruction.trajectory)[:, :3, 3])
    cv2.polylines(image, [path.reshape(-1, 1, 2)], False, PATH_COLOUR, 2, cv2.LINE_AA)
    ahead = reconstruction.pose[:3, 3] + 0.4 * reconstruction.pose[:3, 2]
    here, nose = pixel(reconstruction.pose[None, :3, 3])[0].tolist(), pixel(ahead[None])[0].tolist()
    cv2.circle(image, here, 6, AGENT_COLOUR, -1, cv2.LINE_AA)
    cv2.line(image, here, nose, AGENT_COLOUR, 3, cv2.LINE_AA)
    return image


def _fit(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Scale an image to fit ``size`` (height, width) with its aspect ratio, centred on a dark background."""
    height, width = size
    scale = min(height / image.shape[0], width / image.shape[1])
    inner = max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale))
    resized = cv2.resize(image, inner, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    canvas = np.full((height, width, 3), 24, np.uint8)
    top, left = (height - inner[1]) // 2, (width - inner[0]) // 2
    canvas[top : top + inner[1], left : left + inner[0]] = resized
    return canvas


def _captioned(image: np.ndarray, text: str) -> np.ndarray:
    """Return the image below a strip with the text."""
    strip = np.full((CAPTION, image.shape[1], 3), 24, np.uint8)
    cv2.putText(strip, text, (MARGIN, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (235, 235, 235), 1, cv2.LINE_AA)
    return np.concatenate([strip, image], axis=0)
