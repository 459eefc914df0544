"""Workers import nothing from the current folder, which may be a dataset of strangers."""

import os
import subprocess
import sys

import pytest

# Modules that Python imports before it runs the first function of a process.
SHADOWED = ["pickle", "random", "selectors", "signal", "socket", "struct", "tempfile"]
TRAP = "import pathlib\npathlib.Path(__file__).with_suffix('.ran').touch()\nraise ImportError('a trap')\n"
SCRIPT = """
import os
import sys
import twinlens.processes as processes

def here():
    import helper
    return helper.VALUE, os.environ.get("PYTHONSAFEPATH")

if __name__ == "__main__":
    if sys.argv[1] == "tracker":
        with processes.blocked_interrupts():
            pass
        print(("helped", os.environ.get("PYTHONSAFEPATH")))
    elif sys.argv[1] == "isolated":
        worker = processes.IsolatedWorker(None)
        print(worker.run(here, limit_s=60))
        worker.end()
    else:
        worker = processes.Worker(renewed_after=1)
        first = worker.submit(here).result(60)
        print(worker.submit(here).result(60))
        worker.stop()
        worker.join()
"""


@pytest.fixture
def trapped_folder(tmp_path):
    folder = tmp_path / "dataset"
    folder.mkdir()
    for name in SHADOWED:
        (folder / f"{name}.py").write_text(TRAP)
    return folder


def started(mode, folder, environment):
    """The output of the script, which lies beside its module `helper`, run in a folder."""
    script = folder.parent / "script.py"
    script.write_text(SCRIPT)
    (folder.parent / "helper.py").write_text("VALUE = 'helped'\n")
    command = [sys.executable, str(script), mode]
    # An empty entry of the path would be the current folder.
    others = [os.environ["PYTHONPATH"]] if os.environ.get("PYTHONPATH") else []
    search = os.pathsep.join([str(folder.parent), *others])
    variables = {**os.environ, "PYTHONPATH": search, **environment}
    return subprocess.run(
        command, cwd=folder, env=variables, capture_output=True, text=True, timeout=120
    )


@pytest.mark.parametrize("mode", ["tracker", "worker", "isolated"])
def test_files_in_the_current_folder_are_not_run(mode, trapped_folder):
    run = started(mode, trapped_folder, {})
    assert not list(trapped_folder.glob("*.ran")), run.stderr
    assert run.stdout.strip() == "('helped', None)", run.stderr
    assert not run.stderr


def test_workers_keep_the_variable_of_the_user(trapped_folder):
    run = started("worker", trapped_folder, {"PYTHONSAFEPATH": "yes"})
    assert run.stdout.strip() == "('helped', 'yes')", run.stderr
