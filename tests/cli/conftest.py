import pytest

from twinlens.cli import run

QUICK = ("--size", "64x48", "--spp", "2", "--no-denoise")


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
    assert run(["render", "cards", "--lens", "pinhole", "--lens", "thin:30", *QUICK, "-o", str(folder)]) == 0
    return folder
