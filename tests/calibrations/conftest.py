from tests.cli.conftest import twinlens  # noqa: F401  a fixture
