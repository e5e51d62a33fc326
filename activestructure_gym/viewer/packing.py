"""Pack a recorded episode into bytes that a browser unpacks quickly; most numbers become integers of 8 or 16 bits.

Layout: four bytes with the length of a JSON text (little endian), the text, then the arrays. Each array begins at a
multiple of four bytes. The text gives each array's type, shape and offset, and holds all other data.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from activestructure_gym.mapping.gaussian_map import COLOR, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION
from activestructure_gym.viewer.recorder import Film, Moment

_TYPES = {"uint8": "u1", "uint16": "u2", "int8": "i1", "float32": "f4", "int32": "i4"}
_STEPS = 65535  # quantisation steps of positions along each side of the bounding box; also the largest frame of uint16
_MAX_GAUSSIANS = 4_000_000  # of a page; larger maps are subsampled evenly
_MIN_LOG, _LOG_STEP = -9.0, 0.05  # log of the standard deviation in metres: 0.1 mm to 40 m in steps of 5 %


def packed(parts: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> bytes:
    """Return named arrays, and other data for the JSON text, as bytes in the layout of this module."""
    places: dict[str, Any] = {}
    body = bytearray()
    for name, array in parts.items():
        body += bytes(-len(body) % 4)
        data = np.ascontiguousarray(array)
        places[name] = {"type": _TYPES[data.dtype.name], "shape": list(data.shape), "at": len(body)}
        body += data.tobytes()
    head = json.dumps({**header, "arrays": places}, allow_nan=False).encode()
    head += b" " * (-(4 + len(head)) % 4)
    return len(head).to_bytes(4, "little") + head + bytes(body)


def film_parts(film: Film) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return the quantised arrays of a recorded episode, and the data that the page needs to decode them."""
    arrays, header = _gaussians(film)
    header |= {"bounds": film.bounds.tolist(), "camera": list(film.camera)}
    return {**arrays, **_moments(film.moments, film.poses)}, header


def _gaussians(film: Film) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    every = -(-film.gaussians.shape[1] // _MAX_GAUSSIANS) or 1
    live, added, removed = film.gaussians[:, ::every], film.added[::every], film.removed[::every]
    means = live[MEAN].T.astype(np.float64)
    low = means.min(axis=0) if len(means) else np.zeros(3)
    side = np.maximum(means.max(axis=0) - low if len(means) else np.ones(3), 1e-3)
    length = np.maximum(np.linalg.norm(live[QUATERNION], axis=0), 1e-12)
    short = not film.moments or film.moments[-1].frame < _STEPS
    frames = np.uint16 if short else np.int32
    last = np.iinfo(frames).max  # marks Gaussians that were never removed
    arrays = {
        "means": np.round((means - low) / side * _STEPS).astype(np.uint16),
        "scales": np.clip(np.round((live[LOG_SCALE].T - _MIN_LOG) / _LOG_STEP), 0, 255).astype(np.uint8),
        "rotations": np.round(live[QUATERNION].T / length[:, None] * 127).astype(np.int8),
        "colours": np.clip(np.round(live[COLOR].T * 255), 0, 255).astype(np.uint8),
        "opacities": np.round(255 / (1 + np.exp(-live[OPACITY_LOGIT].astype(np.float64)))).astype(np.uint8),
        "added": np.minimum(added, last).astype(frames),
        "removed": np.minimum(removed, last).astype(frames),
    }
    header = {"low": low.tolist(), "side": side.tolist(), "log": [_MIN_LOG, _LOG_STEP]}
    return arrays, header | {"never_removed": int(last), "every": every}


def _moments(moments: Sequence[Moment], poses: np.ndarray) -> dict[str, np.ndarray]:
    counts = {
        "candidate_starts": [len(m.candidates) for m in moments],
        "plane_starts": [len(m.planes) for m in moments],
        "tree_starts": [len(m.tree) for m in moments],
        "image_starts": [length for m in moments for length in (len(m.true), len(m.rendered))],
    }
    starts = {name: np.cumsum([0, *lengths]).astype(np.int32) for name, lengths in counts.items()}
    none, three = np.zeros((0, 8)), np.zeros((0, 3))
    return {
        **starts,
        "frames": np.array([m.frame for m in moments], np.int32),
        "walked": np.array([m.poses for m in moments], np.int32),
        "rows": np.array([m.row for m in moments], np.int32),
        "poses": np.concatenate([poses[:, :3, 3], poses[:, :3, 0], poses[:, :3, 2]], axis=1).astype(np.float32),
        "candidates": np.concatenate([none, *(m.candidates for m in moments)]).astype(np.float32),
        "scores": np.concatenate([np.zeros(0), *(m.scores for m in moments)]).astype(np.float32),
        "planes": np.concatenate([np.zeros((0, 12)), *(m.planes.reshape(-1, 12) for m in moments)]).astype(np.float32),
        "structural": np.concatenate([np.zeros(0, np.uint8), *(m.structural for m in moments)]).astype(np.uint8),
        "centroids": np.concatenate([three, *(m.centroids.reshape(-1, 3) for m in moments)]).astype(np.float32),
        "tree": np.concatenate([np.zeros((0, 2)), *(m.tree.reshape(-1, 2) for m in moments)]).astype(np.int32),
        "images": np.frombuffer(b"".join(part for m in moments for part in (m.true, m.rendered)), np.uint8),
    }
