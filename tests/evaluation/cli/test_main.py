"""The command line from outside: what is said, what is returned, what is left on disk."""

import json
import subprocess
import sys

import numpy as np
import pytest

from activestructure_gym._version import __version__
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.cli.commands import GROUPS, SHOWN, help_text, summary


@pytest.fixture(autouse=True)
def somewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ASG_CACHE_DIR", str(tmp_path.parent / "cache"))


def test_help_names_every_command_and_loads_nothing_heavy():
    script = (
        "import sys; from activestructure_gym.evaluation.cli import main; code = main(['--help']);"
        "print([m for m in ('torch', 'numba', 'scipy', 'matplotlib', 'cv2', 'trimesh', 'rich', 'tyro')"
        " if m in sys.modules], code)"
    )
    environment = {"PYTHONPATH": ":".join(sys.path), "PATH": "/usr/bin:/bin"}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment)
    assert done.stdout.splitlines()[-1] == "[] 0", done.stdout + done.stderr
    assert list(GROUPS) == ["Run", "Look", "Check", "List", "Files", "System"]
    assert all(f"\n{group}\n" in done.stdout for group in GROUPS)
    assert all(f"\n  {name} " in done.stdout and f"  {summary(name)}\n" in done.stdout for name in SHOWN)
    assert max(map(len, done.stdout.splitlines())) <= 80


@pytest.mark.parametrize("command, others", [("train bc", "compare"), ("bench", "train"), ("cache", "bench")])
def test_help_of_a_command_loads_that_command_alone(command, others):
    script = (
        f"import sys; from activestructure_gym.evaluation.cli import main; code = main(['help', *{command.split()}]);"
        "print([m for m in ('torch', 'numba', 'scipy', 'matplotlib', 'cv2', 'trimesh',"
        f" 'activestructure_gym.evaluation.cli.{others}') if m in sys.modules], code)"
    )
    environment = {"PYTHONPATH": ":".join(sys.path), "PATH": "/usr/bin:/bin"}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment)
    assert done.stdout.splitlines()[-1] == "[] 0", done.stdout + done.stderr


def test_version_and_no_argument(capsys):
    assert main(["-V"]) == 0 and capsys.readouterr().out.split() == ["activestructure-gym", __version__]
    assert main(["--version"]) == 0 and capsys.readouterr().out.split() == ["activestructure-gym", __version__]
    assert main([]) == 0 and capsys.readouterr().out.strip() == help_text()


@pytest.mark.parametrize("command", ["compare", "scenes", "doctor", "bench", "train", "evaluate"])
def test_every_command_explains_itself(command, capsys):
    assert main([command, "--help"]) == 0
    assert f"usage: asg {command}" in capsys.readouterr().out


def write_obj(path, vertices, faces="f 1 2 3\n"):
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in vertices) + faces)


@pytest.fixture
def bad_meshes(tmp_path):
    write_obj(tmp_path / "empty.obj", [(0, 0, 0), (1, 0, 0)], faces="")
    write_obj(tmp_path / "nan.obj", [(0, 0, 0), ("nan", 0, 0), (0, 3, 0)])
    corners = 1000 * np.array([(x, y, z) for x in (0, 5) for y in (0, 4) for z in (0, 2.6)])
    faces = "f 1 2 4 3\nf 5 6 8 7\nf 1 2 6 5\nf 3 4 8 7\nf 1 3 7 5\nf 2 4 8 6\n"
    write_obj(tmp_path / "millimetres.obj", corners, faces)
    (tmp_path / "text.glb").write_text("this is not a mesh")
    # 150 m long: a building may be, but no volume of 0.1 m voxels.
    write_obj(tmp_path / "inches.obj", corners * 0.03, faces)


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["compare", "--scenes", "missing.glb"], ["missing.glb"]),
        (["compare", "--scenes", "empty.obj"], ["empty.obj", "no triangles"]),
        (["compare", "--scenes", "nan.obj"], ["nan.obj", "NaN"]),
        (["compare", "--scenes", "millimetres.obj"], ["millimetres.obj", "units=mm"]),
        (["compare", "--scenes", "text.glb"], ["text.glb"]),
        (["compare", "--scenes", "inches.obj"], ["150 x 120 x 78 m", "units"]),
        (["compare", "--scenes", "box", "--set", "volume.voxel_size=0.001"], ["voxels of 0.001 m"]),
        (["compare", "--scenes", "box", "--set", 'features=["deep"]'], ["unknown feature 'deep'"]),
        (["compare", "--scenes", "box", "--set", "sensor=3"], ["sensor must be a group of fields"]),
        (["compare", "--scenes", "box", "--workers", "-1"], ["--workers", "-1"]),
        (["compare", "--scenes", "box", "--seeds", "²"], ["whole number"]),
        (["compare", "--scenes", "bx"], ["unknown scene 'bx'", "did you mean 'box'"]),
        (["compare", "--scenes", "box", "--start", "0.01,0.01,1.3,0"], ["start"]),
        (["compare", "--scenes", "box", "--start", "90,90,1.3,0"], ["start"]),
        (["compare", "--scenes", "box", "--policies", "learned:nowhere"], ["not a checkpoint", "nowhere"]),
        (["compare", "--scenes", "box", "--policies", "frontire"], ["unknown policy 'frontire'"]),
        (["compare", "--scenes", "box", "--frames", "0"], ["frame budget must be at least 1, got 0"]),
        (["compare", "--scenes", "box", "--frames", "-5"], ["frame budget must be at least 1, got -5"]),
        (["compare", "--scenes", "box", "--seeds", "one"], ["whole number", "'one'"]),
        (["compare", "--scenes", "box", "--preset", "quick"], ["unknown preset 'quick'"]),
        (["compare", "--scenes", "box", "--set", "sensor.widht=3"], ["did you mean 'width'"]),
        (["compare", "--scenes", "box", "--views", "0"], ["views must be a whole number from 1 to 2000"]),
        (["compare", "--scenes", "box", "--samples", "2147483648"], ["surface_samples", "from 1 to 5000000"]),
        (
            ["compare", "--scenes", "box", "--frames", "20", "--set", "frame_budget=10"],
            ["frame_budget=10: leave one out"],
        ),
        (["report"], ["asg: name the directory of a comparison or of a run to report on"]),
        (
            ["compare", "--scenes", "box", "--policies", "random", "--baseline", "nobody"],
            ["one of the policies, random;"],
        ),
        (["compare", "--scenes", "box", "--seeds", "3-1"], ["the smallest first", "3-1"]),
        (["compare", "--scenes", "box", "--seeds", "0..3"], ["0,2,5 or 0-4", "0..3"]),
        (["policies", "my_policy.py:Mine"], ["without .py it is my_policy:Mine"]),
        (["policies", "activestructure_gym.policies.pixel_only:pixelonly"], ["did you mean 'PixelOnly'"]),
        (["compare", "--scenes", "box", "--lpips-weights", "~nobody_there"], ["the LPIPS weights"]),
        (["compare", "--scenes", "box", "--lpips-weights", "text.glb"], ["LPIPS"]),
        (["compare", "--scenes", "x" * 5000], ["x... ("]),
        (["compare", "--scenes", "box", "--set", "volume.max_range=Infinity"], ["VolumeConfig.max_range", "finite"]),
        (["evaluate", "a" * 300], ["aaa"]),
        (["export", "a\nb\x1b[31m"], ["a b\\x1b[31m"]),
        (["train", "ppo", "--start", "~nobody_there"], ["~nobody_there"]),
        (["scenes", "missing.obj"], ["missing.obj"]),
        (["scenes", "--picture", "a.png"], ["needs a scene"]),
        (["scenes", "box", "--picture", "a.jpg"], [".png"]),
        (["evaluate"], ["name the directory"]),
        (["evaluate", "nothing"], ["nothing", "not a finished run"]),
        (["compre"], ["unknown command 'compre'", "did you mean 'compare'"]),
    ],
)
def test_bad_input_is_one_sentence_and_two_and_nothing_is_written(arguments, words, bad_meshes, tmp_path, capsys):
    if arguments[0] == "compare":
        arguments = [*arguments, "--out", "out"]
    before = sorted(tmp_path.rglob("*"))
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert all(word in captured.err for word in words), captured.err
    *notes, refusal = captured.err.splitlines()
    assert "asg: asg" not in refusal and refusal.count("did you mean") < 2
    assert refusal.startswith("asg: ") and all(line.startswith("asg: note: ") for line in notes), captured.err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("errno, code", [(28, 1), (30, 1), (13, 2), (36, 2)])
def test_what_the_file_system_says_is_one_sentence(errno, code, monkeypatch, capsys):
    from activestructure_gym.evaluation.cli.doctor import Doctor

    def fail(self):
        raise OSError(errno, "as it says", "runs/a\nb")

    monkeypatch.setattr(Doctor, "run", fail)
    assert main(["doctor"]) == code
    assert capsys.readouterr().err.startswith("asg: 'runs/a\\nb'")


def test_an_output_that_is_a_file_is_one_sentence(tmp_path, capsys):
    (tmp_path / "file").touch()
    for arguments in (
        ["compare", "--scenes", "box", "--out", "file"],
        ["compare", "--scenes", "box", "--out", "file/below"],
        ["train", "bc", "--out", "file"],
        ["train", "bc", "--out", "file/below"],
        ["train", "eval", "--out", "file"],
    ):
        assert main(arguments) == 2
        said = capsys.readouterr().err
        assert said.startswith("asg: ") and said.count("\n") == 1 and "file" in said, said


def test_resume_needs_to_know_what(capsys):
    assert main(["compare", "--scenes", "box", "--resume"]) == 2
    assert "--resume needs --out" in capsys.readouterr().err


def test_a_foreign_directory_is_not_written_into(tmp_path, capsys):
    (tmp_path / "thesis.tex").touch()
    assert main(["compare", "--scenes", "box", "--out", "."]) == 2
    assert "holds other files" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize("option", [["--frmes", "3"], ["--frames", "many"], ["--retries", "some"]])
def test_mistyped_options_end_with_two(option, capsys):
    assert main(["compare", *option]) == 2
    assert option[0] in "".join(capsys.readouterr())


def test_ctrl_c_ends_with_130(monkeypatch, capsys):
    from activestructure_gym.evaluation.cli.doctor import Doctor

    def interrupt(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(Doctor, "run", interrupt)
    assert main(["doctor"]) == 130
    assert capsys.readouterr().err == "asg: stopped\n"


def test_code_of_others_that_exits_is_no_success(monkeypatch, capsys):
    monkeypatch.setattr("activestructure_gym.evaluation.cli.doctor.Doctor.run", lambda self: sys.exit(0))
    assert main(["doctor"]) == 1
    assert "asg: a policy, a feature or a scene ended the program (exit code 0)" in capsys.readouterr().err


def test_too_little_address_space_is_one_sentence(monkeypatch, capsys):
    resource = pytest.importorskip("resource")
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (700_000 * 1024, -1))
    assert main(["doctor"]) == 2
    assert capsys.readouterr().err == (
        "asg: the address space is limited to 0.7 GB (ulimit -v), and a run needs about 2 GB: raise the limit\n"
    )


def test_doctor_names_every_backend_and_the_missing_package(monkeypatch, capsys):
    from activestructure_gym.sensors import renderer

    states = {"raycast": "works", "pyrender": "package pyrender is missing: pip install 'this[extra]'"}
    monkeypatch.setattr(renderer, "renderer_status", lambda: states)
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    for word in ("raycast", "pip install 'this[extra]'", "cpu", "gsplat", "reference", "inline", "local", "numba"):
        assert word in out


def test_doctor_fails_where_the_main_job_cannot_run(monkeypatch, capsys):
    from activestructure_gym.sensors import renderer

    monkeypatch.setattr(renderer, "renderer_status", lambda: {"raycast": "numba cannot be imported"})
    assert main(["doctor"]) == 1
    assert "sensor raycast does not work" in capsys.readouterr().out


def test_doctor_says_what_a_datasets_folder_holds(tmp_path, capsys):
    (tmp_path / "room_1").mkdir()
    assert main(["doctor", "--dataset", "replica", str(tmp_path)]) == 1
    told = capsys.readouterr().out
    assert "mesh.ply" in told and "missing (needed)" in told and "0 of 8 scenes can be used" in told
    assert main(["doctor", "--dataset", "kitchen", str(tmp_path)]) == 2
    assert "--dataset takes replica or matterport3d, and a folder" in capsys.readouterr().err


@pytest.mark.slow
def test_doctor_counts_damaged_kernels(monkeypatch, capsys, tmp_path):
    from activestructure_gym.compiling import files

    whole, damaged = tmp_path / "a.kernel", tmp_path / "b.kernel"
    for file in (whole, damaged):
        files.write(file, bytes(32), b"machine code")
    monkeypatch.setattr(files, "kernel_files", lambda: [whole, damaged])
    assert main(["doctor"]) == 0 and "works, 2 kernels" in " ".join(capsys.readouterr().out.split())
    damaged.write_bytes(damaged.read_bytes()[:-1])
    assert main(["doctor"]) == 0 and "1 of 2 files damaged" in " ".join(capsys.readouterr().out.split())


def test_scenes_are_listed_and_described(capsys, tmp_path):
    assert main(["scenes"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in ("apartment", "box", "replica:PATH", "rooms=3"))
    assert main(["scenes", "box?size=4,3,2.5", "--picture", "box.png"]) == 0
    out = capsys.readouterr().out
    assert "triangles" in out and "free space" in out and "can be seen" in out
    from PIL import Image

    with Image.open(tmp_path / "box.png") as image:
        assert min(image.size) > 200


def test_a_scene_without_floor_is_noticed(tmp_path, capsys):
    corners = np.array([(x, y, z) for x in (0, 5) for y in (0, 4) for z in (0, 2.6)])
    walls_and_ceiling = "f 1 2 4 3\nf 5 6 8 7\nf 1 2 6 5\nf 3 4 8 7\nf 2 4 8 6\n"
    for name, floor in (("bottomless.obj", ""), ("whole.obj", "f 1 3 7 5\n")):
        write_obj(tmp_path / name, corners, walls_and_ceiling + floor)
        assert main(["scenes", name]) == 0
        assert ("no floor below" in capsys.readouterr().out) == (not floor)


def write_boxes(path, *boxes):
    """Closed boxes, each (low, high), as one OBJ file."""
    sides = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    corners = [
        p for low, high in boxes for p in np.stack(np.meshgrid(*zip(low, high), indexing="ij"), -1).reshape(-1, 3)
    ]
    faces = [" ".join(str(8 * n + k) for k in side) for n in range(len(boxes)) for side in sides]
    write_obj(path, corners, "".join(f"f {face}\n" for face in faces))


@pytest.mark.slow
def test_the_regions_of_a_scene_are_listed_and_chosen(tmp_path, capsys, monkeypatch):
    write_boxes(tmp_path / "storeys.obj", ((0, 0, 0), (5, 4, 2.4)), ((0, 0, 2.6), (4, 4, 5.1)))
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["scenes", "storeys.obj?up=z", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["regions"]
    assert [row["used"] for row in rows] == [True, False] and [row["floor_z_m"] for row in rows] == [0.0, 2.6]
    assert [row["ceiling_m"] for row in rows] == [2.4, 2.5]
    assert rows[0]["seen_share"] + rows[1]["seen_share"] == pytest.approx(1.0, abs=0.02)
    chosen = f"storeys.obj?up=z&inside={rows[1]['inside']}"
    assert main(["scenes", chosen, "--picture", "upper.png"]) == 0
    out = capsys.readouterr().out
    table = out[out.index("Regions of free space") :].splitlines()
    assert max(map(len, table)) <= 80 and [line[:3] for line in table[3:5]] == ["  1", "* 2"]
    assert main(["compare", "--scenes", chosen, "--start=2,2,1.3,0", "--policies", "random", "--preset", "fast"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "is free, but in another region than the one in use: region 1 of `asg list scenes`" in said


def test_a_room_without_ceiling_is_not_given_one(tmp_path, capsys):
    corners = np.array([(x, y, z) for x in (0, 5) for y in (0, 4) for z in (0, 2.6)])
    write_obj(tmp_path / "open.obj", corners, "f 1 2 4 3\nf 5 6 8 7\nf 1 2 6 5\nf 3 4 8 7\nf 1 3 7 5\n")
    assert main(["scenes", "open.obj?up=z"]) == 0
    out = capsys.readouterr().out
    assert "no ceiling found" in out and "plausible" not in out


def test_bench_prints_what_was_measured(monkeypatch, capsys):
    from activestructure_gym.evaluation.benchmarks import sensors as benchmark

    rows = [{"scene": "box", "size": (160, 90), "raycast": 123.456, "pyrender": None}]
    monkeypatch.setattr(benchmark, "run_sensor_benchmark", lambda scenes: rows if scenes == ("box",) else [])
    assert main(["bench", "sensor", "--scenes", "box"]) == 0
    out = capsys.readouterr().out
    assert "160 .. 90" in out and "123" in out and "n/a" in out


def test_bench_of_the_environment_prints_speed_and_stages(monkeypatch, capsys):
    from activestructure_gym.evaluation.benchmarks import env as env_benchmark

    def measured(scenes, *, notify, **options):
        notify("[scene]")
        return [{"scene": scenes[0], **options}], [{"stage": "planes", "ms_per_step": 6.25}]

    monkeypatch.setattr(env_benchmark, "run_env_benchmark", measured)
    assert main(["bench", "env", "--quick", "--preset", "paper"]) == 0
    out = capsys.readouterr().out
    assert "box" in out and "paper" in out and "6.25" in out


def test_bench_of_the_rasteriser_takes_workloads_and_repeats(monkeypatch, capsys):
    from activestructure_gym.evaluation.benchmarks import information as information_benchmark
    from activestructure_gym.evaluation.benchmarks import splatting as benchmark

    asked = []
    of_keyframes = [{"keyframes": 137, "decision_ms": 20.0}]
    monkeypatch.setattr(information_benchmark, "run_information_benchmark", lambda **options: of_keyframes)

    def measure(names, *, progress, **options):
        asked.append((names, options))
        return [{"workload": name, "vs_torch": 71.26} for name in names]

    monkeypatch.setattr(benchmark, "run_splatting_benchmark", measure)
    assert main(["bench", "splatting", "--workloads", "W1,W4", "--repeats", "3", "--no-baseline"]) == 0
    assert asked == [(("W1", "W4"), {"repeats": 3, "baseline": False})]
    shown = capsys.readouterr().out
    assert "71.3" in shown and "137" in shown
    assert main(["bench", "splatting"]) == 0
    assert asked[1] == (("W1", "W2", "W3", "W4"), {"repeats": 15, "baseline": True})


def test_json_of_a_record_is_plain():
    from activestructure_gym.evaluation.machine import hardware as machine

    json.dumps([machine.versions(), machine.hardware()], allow_nan=False)
