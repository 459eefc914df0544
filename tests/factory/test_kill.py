"""kill -9 at any moment costs at most the sample in the making: the next run ends with the same bytes.

Runs are processes of their own.
"""

import signal
import time

import numpy as np
import pytest

from tests.factory_recipes import (
    PATIENCE_S,
    RECIPE,
    digests,
    finish,
    rows_in,
    start,
    write_recipe,
)


def kill_after(process, folder, rows, delay):
    """SIGKILL `delay` seconds after so many rows are there; False where the run was done before."""
    end = time.monotonic() + PATIENCE_S
    while process.poll() is None and rows_in(folder) < rows and time.monotonic() < end:
        time.sleep(0.002)
    time.sleep(delay)
    alive = process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.communicate()
    return alive


def killed_and_resumed(folder, recipe, kills, rng):
    killed = 0
    for k in range(kills):
        process = start(recipe, folder)
        killed += kill_after(
            process, folder, rows_in(folder) + int(k > 0), float(rng.uniform(0, 0.15))
        )
    finish(start(recipe, folder))
    return killed


@pytest.mark.slow
@pytest.mark.parametrize(("count", "spp", "kills"), [(6, 1, 3), (30, 64, 20)])
def test_kills_change_nothing(tmp_path, count, spp, kills):
    """Samples are slow enough that the last kill comes before the last one."""
    text = RECIPE.replace("spp = 1", f"spp = {spp}")
    recipe = write_recipe(tmp_path, text, count=count)
    whole, killed = tmp_path / "whole" / "set", tmp_path / "killed" / "set"
    finish(start(recipe, whole))
    rng = np.random.default_rng(kills)
    assert killed_and_resumed(killed, recipe, kills, rng) >= 0.6 * kills
    assert digests(killed) == digests(whole)


@pytest.mark.parametrize(
    "kind", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_an_interrupt_leaves_whole_samples_and_says_how_to_go_on(tmp_path, kind):
    recipe, folder = write_recipe(tmp_path, count=500), tmp_path / "set"
    process = start(recipe, folder)
    end = time.monotonic() + PATIENCE_S
    while rows_in(folder) < 1 and time.monotonic() < end:
        time.sleep(0.01)
    process.send_signal(kind)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, err
    assert "run the same command to resume" in err
    assert "Traceback" not in err
    assert not list(folder.glob(".*unfinished*"))
    assert rows_in(folder) == len(
        [
            entry
            for entry in folder.iterdir()
            if entry.is_dir() and entry.name != ".rows"
        ]
    )
