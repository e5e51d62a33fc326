"""Compare two policies on one scene, and print the results of their runs.

python examples/01_compare.py
"""

import tempfile

from activestructure_gym import compare
from activestructure_gym.evaluation import Conditions, StandardProtocol

protocol = StandardProtocol(views=2, surface_samples=5000, points_source="means")
conditions = Conditions(preset="fast", frame_budget=20, protocol=protocol)
with tempfile.TemporaryDirectory() as folder:
    result = compare(["box"], ["random", "pixel_only"], folder, conditions=conditions, engine="inline")
    for run in result.runs:
        numbers = run.metrics["metrics"]
        print(run.policy, f"C.R. {numbers['completion_ratio']:.1f} %", f"PSNR {numbers['psnr']:.1f} dB")
