"""The choice of the backend: no LLVM library ends the process, and each result is reported. Some probes are real."""

import importlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from twinlens.errors import BackendError, InputError
from twinlens.rendering import llvm

backends = importlib.import_module("twinlens.rendering.backends")
DEBIAN = Path("/usr/lib/x86_64-linux-gnu")
OLD = [DEBIAN / "libLLVM-15.so.1", DEBIAN / "libLLVM-14.so.1"]
VARIANT = "llvm_ad_rgb"


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    """No cached probes, no environment variables, no GPU."""
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.delenv("TWINLENS_BACKEND", raising=False)
    monkeypatch.setattr(backends, "_has_cuda_driver", lambda: False)
    return tmp_path / "cache"


@pytest.fixture
def offer(monkeypatch):
    """Set the LLVM libraries of the machine."""

    def arrange(*files):
        monkeypatch.setattr(llvm, "candidates", lambda: [Path(file) for file in files])

    return arrange


@pytest.fixture
def answers(monkeypatch):
    """Set the answer of the probe of each library, and return the list of libraries that are probed."""
    probed = []

    def arrange(by_name):
        def run(variant, library):
            probed.append("cuda" if library is None else library.name)
            return by_name[probed[-1]]

        monkeypatch.setattr(llvm, "_run", run)
        return probed

    return arrange


@pytest.fixture
def broken(tmp_path):
    file = tmp_path / "libLLVM-99.so"
    file.write_text("not a library\n")
    return file


def refusal():
    """The message, of one line, of a machine on which nothing can be rendered."""
    with pytest.raises(BackendError) as caught:
        backends.doctor()
    assert caught.value.exit_code == 2
    message = str(caught.value)
    assert "\n" not in message
    return message


def run_python(script, *arguments, **environment):
    ours = ("TWINLENS_BACKEND", "DRJIT_CACHE_DIR")
    usual = {key: value for key, value in os.environ.items() if key not in ours}
    return subprocess.run(
        [sys.executable, "-c", script, *arguments],
        env=usual | environment,
        capture_output=True,
        text=True,
        timeout=200,
    )


RENDER = "mi.render(mi.load_dict(mi.cornell_box()), spp=1); "


def test_broken_and_old_libraries_are_reported(offer, broken):
    """Real children: a text file, LLVM 15, which aborts its process, and LLVM 14, which is refused."""
    files = [broken, *(file for file in OLD if file.exists())]
    offer(*files)
    message = refusal()
    assert message.startswith("rendering needs LLVM, and ")
    assert all(file.name in message for file in files)
    assert "install it: " in message


def test_a_library_of_the_user_that_fails_leads_to_that_of_the_environment(tmp_path):
    """The whole way, in a process that must not die: a missing file, and LLVM 15, which aborts its process."""
    script = (
        "import importlib\n"
        "b = importlib.import_module('twinlens.rendering.backends')\n"
        "b._has_cuda_driver = lambda: False\n"
        "chosen = b.backend(); mi = b.mitsuba(); import drjit as dr\n"
        "doubled = 2 * dr.minimum(dr.arange(mi.Float, 4), 2.5); assert doubled[3] == 5\n"
        "print(chosen.variant, chosen.probes[0].answer)"
    )
    libraries = {"/nonexistent": "fails: no such file"}
    if OLD[0].exists():
        libraries[str(OLD[0])] = "aborts the process"
    for library, answer in libraries.items():
        cache = {"DRJIT_CACHE_DIR": str(tmp_path)}
        child = run_python(script, DRJIT_LIBLLVM_PATH=library, **cache)
        assert child.returncode == 0, child.stderr
        assert child.stdout.startswith(f"{VARIANT} {answer}")


def test_the_tested_library_of_the_environment_needs_no_probe(monkeypatch, answers):
    """Nor does it as the DRJIT_LIBLLVM_PATH that worker processes inherit, or by one of its links."""
    library = llvm.environment_library()
    probed = answers({library.name: "works"})
    assert Path(backends.doctor().library) == library
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(library))
    assert Path(backends.doctor().library) == library
    assert probed == []
    monkeypatch.setattr(llvm, "TESTED_VERSION", "1.0")
    assert Path(backends.doctor().library) == library
    assert probed == [library.name]


@pytest.mark.slow
def test_the_environment_works_without_the_links_of_its_pth_file(tmp_path):
    """An environment as pip leaves it before Python's first start: files of the wheel alone."""
    lib = tmp_path / "lib"
    (lib / "x86_64").mkdir(parents=True)
    shutil.copy(llvm.environment_library(), lib)
    for name in ("libunwind.so.1", "libc++abi.so.1", "libc++.so.1"):
        shutil.copy(llvm._packaged(name), lib / "x86_64")
    script = (
        "import pathlib, sys; from twinlens.rendering import backend, llvm\n"
        "files = {file.name: file for file in pathlib.Path(sys.argv[1]).rglob('*.so*')}\n"
        "def packaged(name):\n"
        "    return next(file for key, file in files.items() if key.startswith(name))\n"
        "llvm._packaged = packaged\n"
        "chosen = backend(); import mitsuba as mi\n"
        f"{RENDER} print(chosen.library)"
    )
    child = run_python(script, str(lib), TWINLENS_BACKEND="llvm", DRJIT_LIBLLVM_PATH="")
    assert child.stdout.strip() == str(lib / "libLLVM.so.19.1"), child.stderr


def test_a_working_llvm_is_chosen_after_broken_ones(offer, answers):
    works = "/nowhere/libLLVM-42.so"
    offer("libLLVM-99.so", "libLLVM-16.so", works, "/nowhere/libLLVM-43.so")
    results = {
        "libLLVM-99.so": "fails: x",
        "libLLVM-16.so": "aborts the process",
        "libLLVM-42.so": "works",
    }
    probed = answers(results)
    chosen = backends.doctor()
    assert (chosen.name, chosen.variant, chosen.library) == ("llvm", VARIANT, works)
    assert probed == [*results]


@pytest.mark.parametrize(
    ("answer", "variant"), [("works", "cuda_ad_rgb"), ("fails: no device", VARIANT)]
)
def test_a_cuda_device_is_preferred_if_it_works(
    monkeypatch, offer, answers, answer, variant
):
    monkeypatch.setattr(backends, "_has_cuda_driver", lambda: True)
    offer("/nowhere/libLLVM-42.so")
    answers({"cuda": answer, "libLLVM-42.so": "works"})
    assert backends.doctor().variant == variant


def test_candidates_are_the_users_library_the_environments_then_the_newest(
    monkeypatch, tmp_path
):
    newest_first = ["libLLVM-20.so", "libLLVM.so.19.1", "libLLVM-14.so.1", "libLLVM-9.so"]  # fmt: skip
    for name in (*sorted(newest_first), "libc.so"):
        (tmp_path / name).write_text("")
    (tmp_path / "libLLVM.so").symlink_to("libLLVM.so.19.1")  # the same library
    monkeypatch.setattr(llvm, "_FOLDERS", (str(tmp_path),))

    def names():
        return [file.name for file in llvm.candidates()]

    packaged = llvm.environment_library()
    assert llvm.candidates()[0] == packaged
    assert names()[1:] == newest_first
    wish = newest_first.pop(2)
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / wish))
    assert names() == [wish, packaged.name, *newest_first]


def test_a_probe_is_cached_until_the_library_changes(answers, broken):
    probed = answers({"libLLVM-99.so": "fails: broken"})
    first = llvm.probe(VARIANT, broken)
    assert llvm.probe(VARIANT, broken) == first
    assert len(probed) == 1
    broken.write_text("another file, of another size\n")
    llvm.probe(VARIANT, broken)
    assert len(probed) == 2


@pytest.mark.parametrize("damage", [b"", b"{", b"[1, 2]", b"null", b"\x00\xff", None])
def test_a_damaged_probe_cache_is_ignored(answers, own_cache, broken, damage):
    """None: its rows are."""
    probed = answers({"libLLVM-99.so": "works"})
    llvm.probe(VARIANT, broken)
    memory = own_cache / "twinlens-backends.json"
    rows = {key: ["not", "a", "row"] for key in json.loads(memory.read_text())}
    memory.write_bytes(json.dumps(rows).encode() if damage is None else damage)
    for _ in range(2):
        assert llvm.probe(VARIANT, broken).works
        assert len(probed) == 2


def test_a_probe_that_hangs_is_a_timeout_which_is_not_cached(monkeypatch, broken):
    """A real child that sleeps; then one that answers."""
    monkeypatch.setattr(llvm, "_PROBE_SECONDS", 0.5)
    monkeypatch.setattr(llvm, "_PROBE", "import time; time.sleep(60)")
    result = llvm.probe(VARIANT, broken)
    assert not result.works
    assert "did not answer" in result.answer
    monkeypatch.setattr(llvm, "_run", lambda variant, library: "works")
    assert llvm.probe(VARIANT, broken).works


LONG = "word " * 70
TOO_LONG = "word " * 200
EXITS = {
    "raise SystemExit(0)": "works",
    "import os; os.abort()": "aborts the process (signal 6)",
    "raise RuntimeError('two\\nlines')": "fails: lines",
    f"raise RuntimeError('{LONG}end.')": f"fails: RuntimeError: {LONG}end.",
    f"raise RuntimeError('{TOO_LONG}')": f"fails: RuntimeError: {'word ' * 76}...",
    "raise ImportError('no LLVM! Set it.')": "fails: ImportError: no LLVM!",
    "raise SystemExit(3)": "fails with exit code 3",
}


@pytest.mark.parametrize(("script", "answer"), EXITS.items())
def test_every_exit_of_a_probe_has_a_message(monkeypatch, script, answer):
    no_core_file = "import resource; resource.setrlimit(resource.RLIMIT_CORE, (0, 0)); "
    monkeypatch.setattr(llvm, "_PROBE", no_core_file + script)
    assert llvm.probe(VARIANT).answer == answer


def test_an_unknown_backend_name_is_an_error_and_an_empty_one_is_none(monkeypatch):
    for wish in ("scalar", "llvm19"):
        monkeypatch.setenv("TWINLENS_BACKEND", wish)
        with pytest.raises(InputError, match="auto, cuda, llvm") as caught:
            backends.backend.__wrapped__()
        assert "\n" not in str(caught.value)
    monkeypatch.setenv("TWINLENS_BACKEND", "")
    assert backends._wanted() == "auto"


@pytest.mark.parametrize(
    ("wish", "reason"),
    [("llvm", "libLLVM-15.so aborts"), ("cuda", "no NVIDIA driver")],
)
def test_a_backend_that_does_not_work_is_an_error(
    monkeypatch, offer, answers, wish, reason
):
    offer("/nowhere/libLLVM-15.so")
    answers({"libLLVM-15.so": "aborts the process (signal 6)"})
    monkeypatch.setenv("TWINLENS_BACKEND", wish)
    assert reason in refusal()


HOST = (
    "import mitsuba; mitsuba.set_variant('{}'); "
    "from twinlens.rendering import backend; print(backend().variant)"
)


def test_a_variant_set_by_the_host_is_kept_or_an_error():
    library = {"DRJIT_LIBLLVM_PATH": str(llvm.environment_library())}
    child = run_python(HOST.format(VARIANT), **library)
    assert child.stdout.strip() == VARIANT, child.stderr
    child = run_python(HOST.format("scalar_rgb"))
    assert child.returncode == 1
    last = child.stderr.splitlines()[-1]
    assert "BackendError: mitsuba's variant is already scalar_rgb" in last
