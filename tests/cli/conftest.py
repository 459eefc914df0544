import pytest

from twinlens.cli import run
from twinlens.dataset import card
from twinlens.dataset.pictures import panels, statistics_figure

FIGURES = {}
QUICK = ("--size", "64x48", "--spp", "2", "--no-denoise")
BALL = """
[camera]
position = [0, -3, 1]
look_at = [0, 0, 0.5]
depth_range = [1.0, 9.0]
[materials.grey]
type = "diffuse"
[lights.sky]
type = "constant"
[objects.ball]
shape = "sphere"
material = "grey"
"""


@pytest.fixture(scope="module", autouse=True)
def _figures_of_as_many_panels_are_drawn_once():
    """Cards have figures; tests of the card look at these."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(card, "statistics_figure", _figure)
        yield


def _figure(many):
    count = len(panels(many))
    if count not in FIGURES:
        FIGURES[count] = statistics_figure(many)
    return FIGURES[count]


@pytest.fixture(scope="session")
def ball(tmp_path_factory):
    """A scene that costs nothing to load: `ball`."""
    path = tmp_path_factory.mktemp("scenes") / "ball.toml"
    path.write_text(BALL)
    return path


@pytest.fixture
def twinlens(capsys):
    """Run a command line in this process: (exit code, stdout, stderr)."""

    def call(*arguments):
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return code, out, err

    return call


@pytest.fixture(scope="session")
def dataset(tmp_path_factory):
    """A dataset of one scene through two lenses."""
    folder = tmp_path_factory.mktemp("rendered") / "out"
    assert (
        run(
            [
                "render",
                "cards",
                "--lens",
                "pinhole",
                "--lens",
                "thin:30",
                *QUICK,
                "-o",
                str(folder),
            ]
        )
        == 0
    )
    return folder
