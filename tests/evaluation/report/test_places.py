import pytest

from activestructure_gym.evaluation.report.places import without_places


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/home/me/scenes/flat.glb", "flat.glb"),
        ("mesh:/home/me/flat.glb?up=z&layout=/tmp/x.json", "mesh:flat.glb?up=z&layout=x.json"),
        (
            "asg compare --scenes /home/me/a.glb,/home/me/b.glb --out=/tmp/c/",
            "asg compare --scenes a.glb,b.glb --out=c",
        ),
        ("'/home/me' is no scene", "'me' is no scene"),
        ("~/scenes/a.glb and C:\\Users\\me\\a.glb", "a.glb and a.glb"),
        (
            "../shared/a.glb, runs/mine, ./b and docs/guide/protocols.md",
            "../shared/a.glb, runs/mine, ./b and docs/guide/protocols.md",
        ),
        ("12 m/s, 1 / 2, 3/4 and https://example.org/a/b", "12 m/s, 1 / 2, 3/4 and https://example.org/a/b"),
    ],
)
def test_of_an_absolute_path_the_name_is_left(text, shown):
    assert without_places(text) == shown
