"""The short table of a comparison: means over the scenes, with deviations over the seeds."""

import warnings

from activestructure_gym.evaluation.cli.result_table import result_tables
from tests.evaluation.report.conftest import maker


def columns(runs):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (table,) = result_tables(runs, 200)
    return {str(column.header): list(column.cells) for column in table.columns}


def test_the_deviation_is_over_the_seeds_of_the_means_over_the_scenes(tmp_path):
    numbers = {("a", 0): 20.0, ("b", 0): 30.0, ("a", 1): 22.0, ("b", 1): 32.0}  # means 25 and 27
    runs = [maker(tmp_path)(scene, seed=seed, psnr=psnr) for (scene, seed), psnr in numbers.items()]
    shown = columns(runs)
    assert shown["PSNR (dB) ↑"] == ["26.00 ± 1.41"]
    assert "C.R. surface (%) ↑" not in shown  # measured in no run, which gives no warning


def test_seeds_on_different_scenes_have_no_deviation(tmp_path):
    runs = [maker(tmp_path)("a", seed=0, psnr=20.0), maker(tmp_path)("b", seed=1, psnr=30.0)]
    assert columns(runs)["PSNR (dB) ↑"] == ["25.00"]
