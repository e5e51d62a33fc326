import numpy as np
import pytest

from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.npz import read_npz
from activestructure_gym.planes import QUALITY_MODES, PlaneSceneGraph
from activestructure_gym.planes.record import graph_arrays, graph_summary, seen_cells
from activestructure_gym.scenes import load_scene
from activestructure_gym.sensors import RGBDSensor, SensorConfig


@pytest.fixture(scope="module")
def graph() -> PlaneSceneGraph:
    """A furnished room from four of its start poses."""
    scene = load_scene("room?seed=3")
    sensor = RGBDSensor(scene, SensorConfig(width=96, height=54), np.random.default_rng(0))
    graph = PlaneSceneGraph()
    for pose in ground_truth_of(scene).free_space.start_poses[:4]:
        graph.update(sensor.capture(pose))
    sensor.close()
    assert len(graph.nodes) > 5 and graph.state.tree.any() and len(graph.deficiencies)
    return graph


def test_the_graph_comes_back_from_its_file(graph, tmp_path):
    np.savez_compressed(tmp_path / "graph.npz", **graph_arrays(graph))
    arrays = read_npz(tmp_path / "graph.npz")  # never unpickles
    for name, expected in {
        "ids": [node.id for node in graph.nodes],
        "normals": graph.state.normals,
        "offsets": graph.state.offsets,
        "centroids": graph.state.centroids,
        "areas": graph.state.areas,
        "observations": [node.observations for node in graph.nodes],
        "structural": graph.state.structural,
        "modes": graph.state.quality.modes,
        "quality": graph.state.quality.scores,
        "surprise": graph.state.surprise.total,
        "deficit": graph.state.deficit,
        "betweenness": graph.state.betweenness,
        "deficiency_centres": graph.deficiencies.centres,
        "deficiency_areas": graph.deficiencies.areas,
        "deficiency_planes": graph.deficiencies.planes,
    }.items():
        np.testing.assert_array_equal(arrays[name], expected, err_msg=name)
    np.testing.assert_allclose(arrays["surprise_factors"].prod(axis=1), arrays["surprise"])
    assert tuple(arrays["mode_names"]) == QUALITY_MODES
    reference = graph.as_networkx()
    rows = {node.id: k for k, node in enumerate(graph.nodes)}
    expected = {(rows[i], rows[j]): (data["weight"], data["tree"]) for i, j, data in reference.edges(data=True)}
    found = zip(arrays["edges"].tolist(), arrays["edge_weights"], arrays["edge_in_tree"])
    assert {tuple(sorted(pair)): (weight, tree) for pair, weight, tree in found} == {
        tuple(sorted(pair)): values for pair, values in expected.items()
    }


def test_every_seen_cell_stands_where_it_was(graph):
    arrays = graph_arrays(graph)
    for k, node in enumerate(graph.nodes):
        rows, columns = np.nonzero(seen_cells(arrays, k))
        axes, cell = arrays["patch_axes"][k], float(arrays["cell"])
        centres = arrays["patch_corners"][k] + cell * (np.stack([rows, columns], axis=1) + 0.5) @ axes
        np.testing.assert_allclose(centres, node.surface.cell_centres(*np.nonzero(node.surface.seen)), atol=1e-9)
        np.testing.assert_allclose(centres @ node.normal + node.offset, 0.0, atol=1e-9)
        assert len(rows) * cell**2 == pytest.approx(node.area)


def test_a_decision_records_both_kinds_of_planes(graph):
    summary = graph_summary(graph)
    structural = graph.state.structural
    assert summary["structural"] + summary["objects"] == len(graph.nodes)
    assert summary["deficit_structural"] == pytest.approx(graph.state.deficit[structural].mean())
    assert summary["quality"] == pytest.approx(graph.state.quality.scores.mean())
    assert summary["deficiency_centres"] == len(graph.deficiencies)
    assert summary["deficiency_area"] == pytest.approx(graph.deficiencies.areas.sum())
    empty = graph_summary(PlaneSceneGraph())
    assert empty["structural"] == 0 and empty["deficit"] is None and empty["deficiency_area"] == 0.0
