import pytest

from activestructure_gym.features.keyframe_information import KeyframeInformation
from activestructure_gym.policies.gauss_mi.reliability import DirectionalReliability
from benchmarks import policies as policy_benchmark
from benchmarks.command import run
from benchmarks.policies import Policies, run_policy_benchmark


def test_a_row_per_policy_on_one_state():
    said = []
    rows = run_policy_benchmark(
        "box", policies=["random", "pixel_only"], preset="fast", gaussians=1, frames=12, repeats=2,
        notify=said.append,
    )  # fmt: skip
    assert [row["policy"] for row in rows] == ["random", "pixel_only"]
    states = [[row[key] for key in ("candidates", "gaussians", "keyframes", "planes", "threads")] for row in rows]
    assert states[0] == states[1] and min(states[0]) > 0
    for row in rows:
        low, high = row["quartiles"]
        assert 0 < low <= row["decision_s"] <= high
        assert row["decision_s"] >= max(row["features_s"], row["policy_s"], row["offer_s"]) > 0
    assert any("exploring" in line for line in said) and said[-1] == "round 2 of 2: random"


def test_the_row_by_hand():
    times = [
        {"planning": 0.02, "features": f, "policy": 0.01, "cpu": 1.0} for f in (0.05, 0.08, 0.09, 0.06, 9.0)
    ]  # fmt: skip
    row = policy_benchmark._row("activestructure", times)
    assert row["decision_s"] == pytest.approx(0.11) and row["limit"] == "under 0.12"
    assert row["quartiles"] == pytest.approx((0.09, 0.12)) and row["features_s"] == pytest.approx(0.08)
    times[0]["features"] = times[3]["features"] = 0.3
    assert policy_benchmark._row("activestructure", times)["limit"] == "OVER 0.12"
    assert policy_benchmark._row("activestructure?discovery=unseen", times)["limit"] == "OVER 0.12"
    assert policy_benchmark._row("naruto", times)["limit"] == "under 2"


def test_new_keyframes_are_measured_in_every_round(monkeypatch):
    measured, voted = [], []
    measure, vote = KeyframeInformation._measure, DirectionalReliability._vote
    monkeypatch.setattr(KeyframeInformation, "_measure", lambda *a: (measured.append(a[1]), measure(*a))[1])
    monkeypatch.setattr(DirectionalReliability, "_vote", lambda *a: (voted.append(a[1]), vote(*a))[1])
    decide, spent = policy_benchmark._decision, {}

    def counting(env, name):
        before = len(measured), len(voted)
        seconds = decide(env, name)
        spent.setdefault(name, []).append((len(measured) - before[0], len(voted) - before[1]))
        return seconds

    monkeypatch.setattr(policy_benchmark, "_decision", counting)
    rows = run_policy_benchmark(
        "box", policies=["gauss_mi", "fisherrf"], preset="fast", gaussians=1, frames=12, repeats=2
    )
    votes, shares = spent["gauss_mi"], spent["fisherrf"]
    assert votes[0][1] > 0 and len({*votes}) == 1
    assert shares[0][0] > 0 and len({*shares}) == 1
    assert votes[0][1] < rows[0]["keyframes"]  # the others voted before


def test_every_scene_is_measured(monkeypatch, capsys):
    def measured(scene, **options):
        assert options.pop("notify")
        return [{"policy": "random", "decision_s": 0.125, "options": options}]

    monkeypatch.setattr(policy_benchmark, "run_policy_benchmark", measured)
    assert run(Policies, ["--scenes", "box,room", "--quick"]) == 0
    out = capsys.readouterr().out
    assert "0.125" in out and "box" in out and "room" in out and "repeats 1" in out
    assert run(Policies, []) == 0
    assert policy_benchmark.SCENE in capsys.readouterr().out
    words = "--policies random hole_area --gaussians 80 --frames 30 --repeats 3 --quick"
    assert run(Policies, words.split()) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "frames 30, repeats 3, gaussians 80" in out and "policies random .. hole_area" in out
    assert run(Policies, ["--policies", "nobody"]) == 2
    assert "unknown policy 'nobody'" in capsys.readouterr().err
    assert run(Policies, ["--repeats", "0"]) == 2
    assert "--repeats must be at least 1, got 0" in capsys.readouterr().err
