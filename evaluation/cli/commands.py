"""The subcommands and their options. Light to import: each one loads what it needs when it runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal, Protocol

import tyro

Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]


def _option(metavar: str, default: str | None = None) -> Any:
    """What help calls a value, and what it says of the default where the value itself says nothing."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=default)


Names = Annotated[tuple[str, ...], _option("NAME [NAME ...]")]
NoNames = Annotated[tuple[str, ...], _option("NAME [NAME ...]", "")]
Changes = Annotated[tuple[str, ...], _option("FIELD=VALUE [FIELD=VALUE ...]", "")]
Text = Annotated[str | None, _option("TEXT", "")]
Path = Annotated[str | None, _option("PATH", "")]
Count = Annotated[int | None, _option("N", "")]
Runs = Annotated[tuple[str, ...], tyro.conf.Positional, _option("[RUN ...]", "")]


@dataclass(frozen=True)
class Compare:
    """Run policies on scenes under one budget; ends with a table, curves and pictures.

    Without any option: `random` against `pixel_only` in a furnished room, in less than a minute.
    """

    scenes: Annotated[tuple[str, ...], _option("SCENE [SCENE ...]", "(default: room)")] = ()
    """What to explore, separated by commas or spaces: names (see `asg scenes`), files, folders."""
    policies: Names = ("random", "pixel_only")
    (
        "Who explores: names (see `asg policies`), package.module:Class, `ladder` (the paper's ablation, A to E), or "
        '`all`. Options stand behind a question mark: "active_gs?travel=shared" is a planner with everybody\'s travel '
        "term."
    )
    seeds: Annotated[tuple[str, ...], _option("N [N ...]")] = ("0",)
    """Whole numbers from 0 on. Equal seeds start at the same place, so policies are compared in pairs."""
    preset: Annotated[str | None, _option("fast|default|paper", "(default: default)")] = None
    """What `asg config PRESET` prints."""
    frames: Count = None
    """Frame budget of every episode; the preset's if not given."""
    out: Path = None
    """Directory for the results; runs/<date>-<time> if not given."""
    resume: Switch = False
    (
        "Go on with the comparison in --out: finished runs are kept and not repeated. Scenes, policies or seeds given "
        "as well are added to it; everything else stays as it was."
    )
    trust_code: Switch = False
    """Let files (the record of --resume, a checkpoint) name code, package.module:Name, that is run."""
    engine: Annotated[str, _option("local|inline|ray")] = "local"
    (
        "local: one process per run, several at a time; inline: one after the other in this process; ray: on a Ray "
        "cluster."
    )
    workers: int = 0
    """Runs at a time; 0 is one per core."""
    timeout: float = 0.0
    """Minutes after which a run is stopped and tried again; 0 is any time."""
    retries: int = 1
    """How often a run is tried again that was killed or ran out of time."""
    start: Annotated[str | None, _option("X,Y,Z,YAW", "")] = None
    """Where every episode starts: x,y,z,yaw in metres and degrees (write --start=-1,2,1.4,90)."""
    set: Changes = ()
    """Changes of the configuration (see `asg config`), e.g. sensor.depth_noise=kinect mapper.iterations=8."""
    views: Annotated[int | None, _option("N", "(default: 64)")] = None
    """Held-out views that PSNR and SSIM are measured on."""
    protocols: Names = ("standard",)
    """What finished maps are measured by: standard always is, activegamer can be as well."""
    lpips_weights: Path = None
    """Folder with AlexNet's and LPIPS's weights. Also looked for: ASG_LPIPS_WEIGHTS, torch's hub cache."""
    samples: Annotated[int | None, _option("N", "(default: 200000)")] = None
    """Points of the true surface that geometry is measured on, seen or not."""
    view_source: Literal["free_space", "recorded"] = "free_space"
    """Drawn in the scene's free space, or recorded with the scene."""
    baseline: Text = None
    """The policy the report measures the others against; see `asg report --help`."""

    def run(self) -> int:
        """See `compare.compare`."""
        from activestructure_gym.evaluation.cli.compare import compare

        return compare(self)


@dataclass(frozen=True)
class Scenes:
    """List the scenes known by name, or check one: size, free space, what of it can be seen."""

    spec: Annotated[str | None, tyro.conf.Positional, _option("[SCENE]", "")] = None
    """A name with options (apartment?seed=3&rooms=4), a mesh file (house.glb?units=cm&up=auto) or a folder."""
    picture: Path = None
    """Write a picture of the scene to this PNG file."""
    json: Switch = False
    """For programs."""

    def run(self) -> int:
        """See `scenes.scenes`."""
        from activestructure_gym.evaluation.cli.scenes import scenes

        return scenes(self)


@dataclass(frozen=True)
class Doctor:
    """Say what works here, what does not, and which package is missing."""

    def run(self) -> int:
        """See `doctor.doctor`."""
        from activestructure_gym.evaluation.cli.doctor import doctor

        return doctor()


@dataclass(frozen=True)
class Bench:
    """Measure a part on this machine: speed of the sensor or the rasteriser, planes found, quality of maps, cost of
    their growth, what the supervisor of a comparison costs, time of an episode's evaluation and of every policy's
    decisions, steps per second of the environment in one process and in two."""

    what: Annotated[
        Literal["sensor", "splatting", "planes", "mapping", "growth", "grid", "evaluation", "policies", "env"],
        tyro.conf.Positional,
    ]
    """The part to measure."""
    scene: Annotated[str | None, _option("SCENE,...", "")] = None
    (
        "The scenes the sensor looks at (room), whose planes are sought (a room and an apartment), that are mapped "
        "(two apartments), that a grid explores (room), where policies decide or that steps are taken in "
        "(apartment?rooms=3); separated by commas."
    )
    out: Path = None
    """Directory for the figure and the numbers of mapping and growth; only printed if not given."""
    quick: Switch = False
    """Planes, mapping, growth, grid, evaluation, policies and env in small, to see that they run."""
    preset: Annotated[str, _option("fast|default|paper")] = "fast"
    """Of env."""

    workloads: Names = ("W1", "W2", "W3", "W4")
    (
        "Of splatting: mapping iterations at 160x120 with 20k Gaussians (W1), 320x240 with 80k (W2), 640x480 with 300k "
        "(W3), and 64 candidate views of 50k (W4)."
    )
    repeats: int = 15
    """How often everything of splatting is timed."""
    baseline: bool = True
    """Measure plain torch beside splatting, for the ratios: minutes instead of half a minute."""

    def run(self) -> int:
        """See `bench.bench`."""
        from activestructure_gym.evaluation.cli.bench import bench

        return bench(self)


@dataclass(frozen=True)
class Evaluate:
    """Measure finished runs again, from their stored maps alone, and say whether the numbers are the same.

    With --map and --scene: measure a map of any origin.
    """

    runs: Runs = ()
    """Run directories, or a comparison's directory for all of its runs."""
    protocol: NoNames = ()
    """standard, activegamer, or both; those that the run was measured by if not given. New numbers are kept."""
    map: Path = None
    """A map file instead of runs: 3DGS PLY, SplaTAM's params.npz, or a run's map.npz."""
    scene: Annotated[str | None, _option("SCENE", "")] = None
    """The scene of --map."""
    poses: Path = None
    """The trajectory.npz that --map was made along; without it there is no TSDF surface."""
    out: Path = None
    """Write the numbers of --map to this JSON file."""
    trust_code: Switch = False
    """Let the runs' files name code, package.module:Name, that is run."""
    lpips_weights: Path = None
    """Folder with AlexNet's and LPIPS's weights. Also looked for: ASG_LPIPS_WEIGHTS, torch's hub cache."""

    def run(self) -> int:
        """See `evaluate.evaluate`."""
        from activestructure_gym.evaluation.cli.evaluate import evaluate

        return evaluate(self)


@dataclass(frozen=True)
class Train:
    """Train a learned policy on procedural apartments, or score policies on layouts nobody was trained on.

    bc copies an expert, rank learns the order of its gains, ppo learns from rewards (best from a checkpoint of bc).
    """

    what: Annotated[Literal["bc", "rank", "ppo", "score"], tyro.conf.Positional]
    """The method, or score."""
    out: Path = None
    """The run's directory; runs/<method>-<date>-<time> if not given. Its policy is learned:DIRECTORY."""
    resume: Switch = False
    """Go on with the run in --out, with everything as it was begun; no other option is needed."""
    trust_code: Switch = False
    """Let files (the record of --resume, a checkpoint) name code, package.module:Name, that is run."""
    seed: int = 0
    """Of everything: layouts, starts, noise, weights. Equal seeds give equal networks on one machine."""
    workers: int = 0
    """Processes at a time; 0 is one per core. Changes no result."""

    preset: Annotated[str, _option("fast|default|paper")] = "fast"
    """What `asg config PRESET` prints."""
    frames: Count = None
    """Frame budget of every episode; the preset's if not given."""
    set: Changes = ()
    """Changes of the configuration (see `asg config`), e.g. mapper.iterations=0."""
    layouts: Count = None
    """Procedural apartments to train on (240 if not given); of score: to test on, one episode each (24)."""
    rooms: Annotated[tuple[int, ...], _option("N [N ...]")] = (1, 2, 3)
    """Rooms of the layouts, in turn."""
    gains: Names = ("pixel", "hole_area")
    """What the policy is told about every candidate (see `asg features`)."""
    noise: bool = True
    """Another sensor noise in every training episode; validation and score are without."""
    reward: Literal["rate", "auc", "env"] = "rate"
    """What PPO is paid: new surface per frame spent, the area under the coverage, or the environment's reward."""

    teacher: Annotated[str, _option("NAME")] = "oracle"
    """bc, rank: oracle (the true new surface of every candidate), or the gain a greedy expert goes by (hole_area)."""
    episodes: int = 480
    """bc, rank: episodes of the expert, two on each layout."""
    temperature: float = 0.04
    """bc: how sharply its probabilities fall with the expert's score; what PPO begins from draws from them."""
    data: Path = None
    """bc, rank: directory of the expert's episodes, to share it between runs; --out's own if not given."""
    epochs: int = 60
    """bc, rank."""
    start: Path = None
    """ppo: the checkpoint to begin from (a run's directory or a file)."""
    iterations: int = 40
    """ppo: of --envs times --steps steps each."""
    steps: int = 128
    """ppo: per environment and iteration."""
    envs: int = 8
    """ppo: environments at a time; changes results, unlike --workers."""
    gamma: float = 0.3
    """ppo: discount per decision."""
    learning_rate: Annotated[float | None, _option("X", "")] = None
    """1e-3; of ppo 3e-4, from a checkpoint 5e-5."""
    validate_every: int = 10
    """Epochs or iterations between validations."""
    validation_layouts: int = 36
    """Apartments to validate on, one episode each."""

    policies: Names = ("pixel_only", "hole_area")
    """score: who plays, beside random and the one-step oracle."""
    scenes: Annotated[tuple[str, ...], _option("SCENE [SCENE ...]", "")] = ()
    """score: further scenes, each with an episode per seed."""
    seeds: Annotated[tuple[str, ...], _option("N [N ...]", "(default: 0 to 19)")] = tuple(str(n) for n in range(20))
    """score: of the episodes on --scenes; each takes the scene's next start pose."""
    baseline: NoNames = ()
    """score: whom the others are measured against, a column for each; pixel_only if not given, where it plays."""

    def run(self) -> int:
        """See `train.train`."""
        from activestructure_gym.evaluation.cli.train import train

        return train(self)


@dataclass(frozen=True)
class Report:
    """Write the report of finished runs: one page that needs nothing else, and tables as Markdown, CSV and LaTeX."""

    runs: Annotated[tuple[str, ...], tyro.conf.Positional, _option("RUN [RUN ...]", "")]
    """Directories of comparisons, of single runs, or both; made under the same conditions."""
    out: Path = None
    """Directory for the report; that of the comparison if one is given, else runs/report-<date>-<time>."""
    baseline: Text = None
    (
        "The policy the others are measured against; if not given, the first of activestructure-a, pixel_only and "
        "random that took part."
    )

    def run(self) -> int:
        """See `report.report`."""
        from activestructure_gym.evaluation.cli.report import report

        return report(self)


@dataclass(frozen=True)
class Export:
    """Write a run's map in a format that other programs read."""

    run_directory: Annotated[str, tyro.conf.Positional, _option("RUN")]
    """The directory of a finished run."""
    format: Annotated[Literal["ply", "splat", "splatam"] | None, _option("ply|splat|splatam", "")] = None
    """ply: 3D Gaussian splatting PLY, which every splat viewer opens; splat: 32 bytes per Gaussian, for web pages;
    splatam: SplaTAM's params.npz, with the path. If not given, what the name in --out ends with says it, else ply."""
    out: Path = None
    """The file, which ends with .ply, .splat or .npz (splatam); map.ply, map.splat or params.npz in the working
    directory if not given."""
    up: Literal["z", "y", "-y"] = "z"
    """What is up in the file: z as in the scene, -y for SuperSplat and most viewers of splats, y for three.js and game
    engines. The map is turned about the scene's origin."""

    def run(self) -> int:
        """See `export.export`."""
        from activestructure_gym.evaluation.cli.export import export

        return export(self)


@dataclass(frozen=True)
class Policies:
    """List the policies known by name: what each decides by, whose it is, which gains it needs; or describe one."""

    name: Annotated[str | None, tyro.conf.Positional, _option("[NAME]", "")] = None
    """One of them, with its options and its description."""
    json: Switch = False
    """For programs."""

    def run(self) -> int:
        """See `listing.policies`."""
        from activestructure_gym.evaluation.cli.listing import policies

        return policies(self)


@dataclass(frozen=True)
class Features:
    """List the gains of a candidate view that a policy can ask for: what each is, and its unit."""

    json: Switch = False
    """For programs."""

    def run(self) -> int:
        """See `listing.features`."""
        from activestructure_gym.evaluation.cli.listing import features

        return features(self)


@dataclass(frozen=True)
class Config:
    """Print the configuration of an episode: every field with its value, its default and its meaning."""

    preset: Annotated[str, tyro.conf.Positional, _option("[fast|default|paper]")] = "default"
    """The preset."""
    set: Changes = ()
    """Changes of it, as compare and train take them; what they change is said at the end."""
    json: Switch = False
    """For programs; `gym.make(..., config=...)` takes it."""

    def run(self) -> int:
        """See `listing.config`."""
        from activestructure_gym.evaluation.cli.listing import config

        return config(self)


@dataclass(frozen=True)
class Cache:
    """Show what is kept on disk between runs, or remove it: what scenes share, and compiled kernels.

    The cache of scenes keeps itself below ASG_CACHE_MAX (4GiB if not set): what was used longest ago goes first.
    """

    what: Annotated[Literal["show", "clear"], tyro.conf.Positional] = "show"
    """show or clear."""
    part: Annotated[Literal["all", "scenes", "kernels"], tyro.conf.Positional] = "all"
    """What to show or to remove; all of it is computed or compiled again when it is needed."""
    json: Switch = False
    """For programs."""

    def run(self) -> int:
        """See `cache.cache`."""
        from activestructure_gym.evaluation.cli.cache import cache

        return cache(self)


@dataclass(frozen=True)
class Completion:
    """Print a script that lets a shell complete commands, options and names.

    bash: eval "$(asg completion bash)" in ~/.bashrc; zsh: the same in ~/.zshrc after compinit; fish: asg completion
    fish > ~/.config/fish/completions/asg.fish
    """

    shell: Annotated[Literal["bash", "zsh", "fish"], tyro.conf.Positional]
    """The shell."""

    def run(self) -> int:
        """See `completion.completion`."""
        from activestructure_gym.evaluation.cli.completion import completion

        return completion(self)


class Command(Protocol):
    """What a subcommand is: options, and what to do with them."""

    def run(self) -> int:
        """The exit code."""


COMMANDS: dict[str, type[Command]] = {
    "compare": Compare,
    "scenes": Scenes,
    "doctor": Doctor,
    "bench": Bench,
    "train": Train,
    "evaluate": Evaluate,
    "report": Report,
    "export": Export,
    "policies": Policies,
    "features": Features,
    "config": Config,
    "cache": Cache,
    "completion": Completion,
}
