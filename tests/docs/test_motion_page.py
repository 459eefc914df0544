"""The Python block of docs/motion.md runs, and its [[motion]] tables are motions."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).parents[2] / "docs"
pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="docs/ is not next to tests/")


def page(kind):
    return re.findall(rf"```{kind}\n(.*?)```", (DOCS / "motion.md").read_text(), re.S)


def test_the_program_of_the_page_runs(monkeypatch):
    monkeypatch.chdir(DOCS.parent)
    names: dict[str, object] = {}
    (block,) = page("python")
    exec(block.replace("320, 240", "48, 36"), names)
    answer, left = names["answer"], names["left"]
    assert answer.flow.shape == (36, 48, 2)
    assert 0.5 < answer.visible.mean() < 1
    moved = np.linalg.norm(answer.scene_flow, axis=-1)
    assert 0.3 < moved[np.isfinite(moved)].max() < 0.7  # the ball: 0.3 m, and it turns
    assert left.hit.all()


def test_the_tables_of_the_page_are_read(tmp_path):
    from twinlens.scenes import load_scene

    (block,) = page("toml")
    (tmp_path / "path.tum").write_text("0 0 0 0 0 0 0 1\n2 4 0 0 0 0 1 0\n")
    names = [table["object"] for table in tomllib.loads(block)["motion"]]
    objects = "".join(
        f"[objects.{name}]\nshape = 'sphere'\nmaterial = 'grey'\n" for name in names
    )
    head = (
        "camera = { position = [0, -3, 1], look_at = [0, 0, 0], depth_range = [1, 9] }\n"
        "materials.grey.type = 'diffuse'\n"
    )
    (tmp_path / "scene.toml").write_text(head + objects + block)
    scene = load_scene(tmp_path / "scene.toml")
    assert [motion.object for motion in scene.motion] == names
    assert scene.at(1.0).motion == ()
