"""Many processes make the same bytes as one, also when one of them is killed on the way."""

import json
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
import warnings
from concurrent.futures import Future

import psutil
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
from twinlens.dataset import place
from twinlens.dataset.record import plain
from twinlens.errors import BackendError, InputError, MissingExtraError
from twinlens.factory import generate, read_recipe, sample, workers
from twinlens.factory.workers import (
    Order,
    dask_cluster,
    make_one,
    usual_workers,
    worker_processes,
)
from twinlens.rendering.backends import Backend
from twinlens.scenes.model_files import MaterialWarning

THREADS = os.cpu_count() or 1


FLYING = 'seed = 1\ncount = {count}\nfamilies = ["flying"]\nwidth = 64\nheight = 48\nspp = 2\n'


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    return write_recipe(tmp_path_factory.mktemp("recipe"), count=8)


@pytest.fixture(scope="module")
def whole(recipe, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "set"
    assert generate(read_recipe(recipe), folder).complete
    return folder


def workers_of(process):
    processes = psutil.Process(process.pid).children(recursive=True)
    return [child for child in processes if "spawn_main" in " ".join(child.cmdline())]


def wait_for_a_sample(process, folder):
    end = time.monotonic() + PATIENCE_S
    while rows_in(folder) < 1 and process.poll() is None and time.monotonic() < end:
        time.sleep(0.01)


def killing_one(process, folder):
    """SIGKILL one of a run's workers as soon as a sample is there."""
    wait_for_a_sample(process, folder)
    processes = workers_of(process)
    processes[0].kill()
    return len(processes)


def test_a_killed_worker_costs_nothing(recipe, whole, tmp_path):
    folder, killed = tmp_path / "set", []

    def report(fraction, text):
        if rows_in(folder) and not killed:
            killed.extend(multiprocessing.active_children())
            killed[0].kill()

    engine = worker_processes(1)
    assert generate(read_recipe(recipe), folder, engine=engine, report=report).complete
    assert len(killed) == 1
    assert digests(folder) == digests(whole)


@pytest.mark.slow
def test_a_killed_worker_of_a_command_costs_nothing(recipe, whole, tmp_path):
    process = start(recipe, tmp_path / "set", "--workers", "2")
    assert killing_one(process, tmp_path / "set") >= 2
    assert "8 of 8 samples" in finish(process)
    assert digests(tmp_path / "set") == digests(whole)


@pytest.mark.slow
def test_a_worker_that_dies_idle_while_another_one_works_costs_nothing(
    tmp_path, monkeypatch
):
    recipe = write_recipe(tmp_path, count=4)
    recipe.write_text(
        recipe.read_text().replace("spp = 1", "spp = { sweep = [2000, 1, 1] }")
    )
    read, end = read_recipe(recipe), time.monotonic() + PATIENCE_S

    def report(fraction, text):
        assert time.monotonic() < end, "a sample is pending for ever"

    work = workers.Work(read, place(tmp_path / "set"), plain(sample.made_with()))
    results = worker_processes(2)(work, range(3), report)
    assert next(results)[0] == 1
    idle = min(
        multiprocessing.active_children(),
        key=lambda child: sum(psutil.Process(child.pid).cpu_times()[:2]),
    )
    idle.kill()
    assert sorted(index for index, _ in results) == [0, 2]


def test_interrupts_stay_blocked_while_the_first_worker_starts():
    code = (
        "import multiprocessing, signal\n"
        "from twinlens.processes import blocked_interrupts\n"
        "with blocked_interrupts():\n"
        "    multiprocessing.get_context('spawn').Lock()\n"
        "    print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))\n"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "True\n"


@pytest.mark.slow
def test_workers_end_when_their_run_is_killed(recipe, tmp_path):
    process = start(recipe, tmp_path / "set", "--workers", "2")
    wait_for_a_sample(process, tmp_path / "set")
    orphans = workers_of(process)
    process.kill()
    process.communicate()
    assert len(orphans) >= 2
    _, alive = psutil.wait_procs(orphans, timeout=10)
    assert not alive


@pytest.mark.slow
def test_a_script_without_a_guard_is_named_as_the_cause(recipe, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from twinlens.factory import generate, read_recipe, worker_processes\n"
        f"generate(read_recipe({str(recipe)!r}), {str(tmp_path / 'set')!r}, engine=worker_processes(1))\n"
    )
    done = subprocess.run(
        [sys.executable, script],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert 'the guard `if __name__ == "__main__":`' in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("processors", "gib", "device", "samples", "count"),
    [
        (8, 16, "llvm", 100, 4),
        (8, 5, "llvm", 100, 2),
        (8, 16, "llvm", 25, 2),
        (8, 16, "llvm", 19, 0),
        (8, 16, "cuda", 100, 0),
    ],
)
def test_large_runs_of_random_scenes_get_several_processes(
    tmp_path, monkeypatch, processors, gib, device, samples, count
):
    backend = Backend(device, f"{device}_rgb", "as in the test")
    monkeypatch.setattr(workers, "processor_count", lambda: processors)
    monkeypatch.setattr(workers, "memory_bytes", lambda: gib << 30)
    monkeypatch.setattr(workers, "backend", lambda: backend)
    family = read_recipe(write_recipe(tmp_path, FLYING, count=1000))
    assert usual_workers(family, samples) == count
    assert usual_workers(read_recipe(write_recipe(tmp_path)), samples) == 0


@pytest.mark.slow
def test_a_process_is_replaced_after_some_samples_and_makes_the_same_bytes(
    recipe, whole, tmp_path, monkeypatch
):
    monkeypatch.setattr(workers, "RENEWED_AFTER", 3)
    seen = set()

    def report(fraction, text):
        seen.update(child.pid for child in multiprocessing.active_children())

    assert generate(
        read_recipe(recipe), tmp_path / "set", engine=worker_processes(1), report=report
    ).complete
    assert len(seen) == 3, "eight samples, three a process"
    assert digests(tmp_path / "set") == digests(whole)


@pytest.mark.slow
def test_ctrl_c_in_a_terminal_ends_the_workers_too_and_keeps_finished_samples(
    recipe, whole, tmp_path
):
    """A terminal sends SIGINT to every process of the command."""
    many = write_recipe(tmp_path, count=500)
    process = start(many, tmp_path / "set", "--workers", "2", start_new_session=True)
    wait_for_a_sample(process, tmp_path / "set")
    running = workers_of(process)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err) == (
        130, "\ntwinlens: interrupted; finished samples are kept; run the same command to resume\n"
    )  # fmt: skip
    assert not psutil.wait_procs(running, timeout=5)[1]
    assert rows_in(tmp_path / "set") >= 1
    assert not list((tmp_path / "set").glob(".*unfinished*"))


@pytest.mark.slow
@pytest.mark.parametrize("text", [RECIPE.replace("denoise = false", ""), FLYING])
def test_any_number_of_workers_makes_the_same_bytes(tmp_path, text):
    """Of denoised images, and of random scenes."""
    recipe, made = write_recipe(tmp_path, text, count=8), []
    for options in ((), ("--workers", "1"), ("--workers", "2"), ("--workers", "3")):
        folder = tmp_path / f"{len(made)}" / "set"
        finish(start(recipe, folder, *options))
        made.append(digests(folder))
    assert made == made[:1] * 4


@pytest.mark.slow
def test_a_scheduler_of_the_users_serves_as_well(recipe, whole, tmp_path):
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}

    def served(program, options):
        command = f"-m distributed.cli.{program} --no-dashboard {options}"
        arguments = [sys.executable, *command.split(), "--scheduler-file", "s.json"]
        return subprocess.Popen(arguments, cwd=tmp_path, **quiet)

    scheduler = tmp_path / "s.json"
    serving = [served("dask_scheduler", "--port 0")]
    try:
        while not scheduler.exists():
            time.sleep(0.05)
        serving.append(served("dask_worker", "--nthreads 2"))
        address = json.loads(scheduler.read_text())["address"]
        finish(start(recipe, tmp_path / "set", "--scheduler", address))
    finally:
        for process in reversed(serving):
            process.terminate()
            process.wait()
    assert digests(tmp_path / "set") == digests(whole)


def test_a_scheduler_that_does_not_answer_is_an_error():
    with pytest.raises(BackendError, match="no Dask scheduler answers at 'nonsense:"):
        dask_cluster("nonsense://x")


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'twinlens\[cluster\]'"):
        dask_cluster("tcp://host:1")


def test_a_worker_with_other_tools_refuses(recipe, tmp_path):
    read = read_recipe(recipe)
    order = Order(
        read.written,
        recipe,
        tmp_path,
        {"backend": "abacus", "versions": {}},
        {},
        THREADS,
    )
    with pytest.raises(
        InputError,
        match=r"this worker has another backend .* than the dataset: backend: 'abacus'",
    ):
        make_one(order, 0)
    assert not list(tmp_path.iterdir())


def test_warnings_of_a_worker_are_given_again_in_the_callers_process(monkeypatch):
    def rendered(*_):
        warnings.warn("m.glb: not rendered: skins", MaterialWarning, stacklevel=2)
        return None, None

    monkeypatch.setattr(workers, "_rendered", rendered)
    monkeypatch.setattr(workers, "written", lambda *_: "entry")
    made = Future()
    made.set_result(
        pickle.loads(
            pickle.dumps(make_one(Order({}, None, None, {}, {}, threads=1), 0))
        )
    )
    with pytest.warns(MaterialWarning, match=r"^m\.glb: not rendered: skins$"):
        assert list(
            workers._collected(lambda _: made, lambda: 1, [0], lambda *_: None)
        ) == [(0, "entry")]
