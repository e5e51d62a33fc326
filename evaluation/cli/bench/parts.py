"""``asg bench sensor``, ``splatting`` and ``planes``: parts of the reconstruction, each alone."""

from __future__ import annotations

from dataclasses import dataclass

from activestructure_gym.evaluation.cli.bench.tables import SceneNames, print_rows, split_names
from activestructure_gym.evaluation.cli.fields import Names, Switch
from activestructure_gym.evaluation.cli.options import split_list
from activestructure_gym.evaluation.cli.output import make_console


@dataclass(frozen=True)
class Sensor:
    """Speed of the sensor: RGB-D frames per second by renderer and size."""

    scene: SceneNames = None
    """The scenes it looks at, separated by commas; room if not given."""

    def run(self) -> int:
        """Measure and print."""
        from activestructure_gym.evaluation.benchmarks.sensors import run_sensor_benchmark

        console = make_console()
        with console.status("measuring the sensor"):
            rows = run_sensor_benchmark(split_names(self.scene) or ["room"])
        print_rows(console, rows, "speed of the sensor on this machine")
        return 0


@dataclass(frozen=True)
class Splatting:
    """Speed of the rasteriser, in what mapping and the scoring of candidate views ask of it."""

    workloads: Names = ("W1", "W2", "W3", "W4")
    (
        "Mapping iterations at 160x120 with 20k Gaussians (W1), 320x240 with 80k (W2), 640x480 with 300k (W3), and 64 "
        "candidate views of 50k (W4)."
    )
    repeats: int = 15
    """How often everything is timed."""
    baseline: bool = True
    """Measure plain torch beside it, for the ratios: minutes instead of half a minute."""

    def run(self) -> int:
        """Measure and print."""
        from activestructure_gym.evaluation.benchmarks.information import run_information_benchmark
        from activestructure_gym.evaluation.benchmarks.splatting import run_splatting_benchmark

        console = make_console()
        with console.status("measuring the splatting") as status:

            def tell(line: str) -> None:
                status.update(f"measuring the {line}")

            rows = run_splatting_benchmark(
                split_list(self.workloads), repeats=self.repeats, baseline=self.baseline, progress=tell
            )
            of_keyframes = run_information_benchmark(repeats=self.repeats, progress=tell)
        print_rows(console, rows, "speed of the rasteriser on this machine")
        print_rows(console, of_keyframes, "a decision's information of the keyframes, processor ms")
        return 0


@dataclass(frozen=True)
class Planes:
    """Planes found in depth pictures, beside those of OpenCV, and what the graph of planes costs a decision."""

    scene: SceneNames = None
    """The scenes whose planes are sought, separated by commas; a room and an apartment if not given."""
    quick: Switch = False
    """In small, to see that it runs."""

    def run(self) -> int:
        """Measure and print."""
        from activestructure_gym.evaluation.benchmarks import planes as benchmark
        from activestructure_gym.scenes.library import load_scene

        console = make_console()
        sizes, views, keyframes = (benchmark.SIZES[:1], 4, 8) if self.quick else (benchmark.SIZES, 20, 60)
        with console.status("measuring the planes"):
            loaded = [load_scene(spec) for spec in split_names(self.scene) or benchmark.SCENES]
            rows = [row for scene in loaded for row in benchmark.detection_rows(scene, sizes=sizes, views=views)]
            costs = [row for scene in loaded for row in benchmark.graph_rows(scene, keyframes=keyframes)]
        print_rows(console, costs, "milliseconds of the planes per decision, 256 candidates")
        print_rows(console, rows, "planes found on this machine, beside those of OpenCV")
        return 0
