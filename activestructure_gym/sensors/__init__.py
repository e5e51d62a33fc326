"""Simulate RGB-D cameras: renderers (ray casting, pyrender) behind one protocol, noise models, frames.

Renderers are loaded when a sensor is made; importing this package loads neither numba nor OpenGL.
"""

from activestructure_gym.geometry.frame import Frame
from activestructure_gym.sensors.noise import DEPTH_NOISE
from activestructure_gym.sensors.renderer import RENDERERS, Renderer, make_renderer, renderer_status
from activestructure_gym.sensors.rgbd import RGBDSensor, SensorConfig

__all__ = [
    "DEPTH_NOISE",
    "RENDERERS",
    "Frame",
    "RGBDSensor",
    "Renderer",
    "SensorConfig",
    "make_renderer",
    "renderer_status",
]
