"""The choice of the backend: no LLVM library ends the process, and each result is reported. Some probes are real."""

import importlib
import json
import os
import shutil
import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path

import pytest

from twinlens.errors import BackendError, InputError
from twinlens.rendering import llvm

backend = importlib.import_module(
    "twinlens.rendering.backends"
)  # the room's `backend` is the function
DEBIAN = Path("/usr/lib/x86_64-linux-gnu")


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    """No cached probes, no environment variables, no GPU."""
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.delenv("TWINLENS_BACKEND", raising=False)
    monkeypatch.setattr(backend, "_has_cuda_driver", lambda: False)
    return tmp_path / "cache"


@pytest.fixture
def offer(monkeypatch):
    """Set the LLVM libraries of the machine."""
    return lambda *files: monkeypatch.setattr(
        llvm, "candidates", lambda: [Path(file) for file in files]
    )


@pytest.fixture
def bare(monkeypatch):
    """A machine without any LLVM library."""
    monkeypatch.setattr(llvm, "_FOLDERS", ())
    monkeypatch.setattr(llvm, "_packaged", lambda name: None)


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


def broken(folder) -> Path:
    file = folder / "libLLVM-99.so"
    file.write_text("not a library\n")
    return file


def old_ones() -> list[Path]:
    return [
        file
        for file in (DEBIAN / "libLLVM-15.so.1", DEBIAN / "libLLVM-14.so.1")
        if file.exists()
    ]


def test_broken_and_old_libraries_are_reported(offer, tmp_path):
    """Real children: a text file, LLVM 15, which aborts its process, and LLVM 14, which is refused."""
    files = [broken(tmp_path), *old_ones()]
    offer(*files)
    with pytest.raises(BackendError, match="rendering needs LLVM, and ") as caught:
        backend.doctor()
    message = str(caught.value)
    for file in files:
        assert file.name in message
    assert "install it: " in message
    assert "\n" not in message


@pytest.mark.skipif(
    not (DEBIAN / "libLLVM-15.so.1").exists(), reason="no LLVM 15 on this machine"
)
def test_an_llvm_path_that_aborts_leads_to_the_library_of_the_environment(tmp_path):
    """The whole way, in a process that must not die: DRJIT_LIBLLVM_PATH names LLVM 15."""
    script = (
        "import importlib\n"
        "b = importlib.import_module('twinlens.rendering.backends')\n"
        "b._has_cuda_driver = lambda: False\n"
        "chosen = b.backend(); mi = b.mitsuba()\n"
        "scene = mi.load_dict(mi.cornell_box()); mi.render(scene, spp=1)\n"
        "print(chosen.variant, chosen.probes[0].answer)"
    )
    child = run_python(
        script,
        DRJIT_LIBLLVM_PATH=str(DEBIAN / "libLLVM-15.so.1"),
        DRJIT_CACHE_DIR=str(tmp_path),
    )
    assert child.returncode == 0, child.stderr
    assert child.stdout.startswith("llvm_ad_rgb aborts the process")


def test_a_missing_library_path_is_reported(monkeypatch, bare, tmp_path):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-gone.so"))
    with pytest.raises(BackendError, match=r"libLLVM-gone\.so fails: no such file; "):
        backend.doctor()


@pytest.mark.parametrize(
    ("system", "machine", "command"),
    [
        ("linux", "x86_64", "pip install karellen-llvm-core==19.1.7"),
        ("linux", "aarch64", "apt install libllvm19"),
        ("darwin", "arm64", "brew install llvm"),
    ],
)
def test_a_machine_without_llvm_is_told_what_to_install(
    monkeypatch, bare, system, machine, command
):
    monkeypatch.setattr("sys.platform", system)
    monkeypatch.setattr("platform.machine", lambda: machine)
    with pytest.raises(BackendError, match=f"no LLVM library .*{command}") as caught:
        backend.doctor()
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)


def test_the_pinned_version_is_the_tested_one():
    text = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    pins = tomllib.loads(text)["project"]["dependencies"]
    pin = f"{llvm.PACKAGE}=={llvm.TESTED_VERSION}"
    marker = "sys_platform == 'linux' and platform_machine == 'x86_64'"
    assert f"{pin}; {marker}" in pins


def test_the_library_of_the_environment_needs_no_probe(monkeypatch, answers):
    """Nor does it as the DRJIT_LIBLLVM_PATH that worker processes inherit, or by one of its links."""
    probed = answers({})
    chosen = backend.doctor()
    assert Path(chosen.library) == llvm.environment_library()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", chosen.library)
    assert backend.doctor().library == chosen.library
    assert probed == []


def test_another_version_in_the_environment_is_probed(monkeypatch, answers):
    library = llvm.environment_library()
    monkeypatch.setattr(llvm, "TESTED_VERSION", "1.0")
    probed = answers({library.name: "works"})
    assert backend.doctor().library == str(library)
    assert probed == [library.name]


def test_the_environment_works_without_the_links_of_its_pth_file(tmp_path):
    """An environment as pip leaves it before Python's first start: files of the wheel alone."""
    lib = tmp_path / "lib"
    (lib / "x86_64").mkdir(parents=True)
    names = ("libunwind.so.1", "libc++abi.so.1", "libc++.so.1")
    for source in [llvm.environment_library(), *map(llvm._packaged, names)]:
        folder = lib if source.name.startswith("libLLVM") else lib / "x86_64"
        shutil.copy(source, folder)
    script = (
        "import pathlib, sys; from twinlens.rendering import backend, llvm\n"
        "files = {file.name: file for file in pathlib.Path(sys.argv[1]).rglob('*.so*')}\n"
        "def packaged(name):\n"
        "    return next(file for key, file in files.items() if key.startswith(name))\n"
        "llvm._packaged = packaged\n"
        "chosen = backend(); import mitsuba as mi\n"
        "mi.render(mi.load_dict(mi.cornell_box()), spp=1); print(chosen.library)"
    )
    child = run_python(script, str(lib), TWINLENS_BACKEND="llvm", DRJIT_LIBLLVM_PATH="")
    assert child.stdout.strip() == str(lib / "libLLVM.so.19.1"), child.stderr


def test_a_library_name_without_a_folder_is_found_by_the_loader(monkeypatch):
    """The system knows where libLLVM-42.so is, in a folder that this module does not."""
    monkeypatch.setattr(llvm, "_PROBE", "raise SystemExit(0)")
    assert llvm.probe("llvm_ad_rgb", Path("libLLVM-42.so")).works


def test_a_working_llvm_is_chosen_after_a_broken_one(offer, answers, tmp_path):
    offer(
        broken(tmp_path),
        "/nowhere/libLLVM-16.so",
        "/nowhere/libLLVM-42.so",
        "/nowhere/libLLVM-43.so",
    )
    probed = answers(
        {
            "libLLVM-99.so": "fails: x",
            "libLLVM-16.so": "aborts the process (signal 6)",
            "libLLVM-42.so": "works",
        }
    )
    chosen = backend.doctor()
    assert (chosen.name, chosen.variant, chosen.library) == (
        "llvm",
        "llvm_ad_rgb",
        "/nowhere/libLLVM-42.so",
    )
    assert probed == ["libLLVM-99.so", "libLLVM-16.so", "libLLVM-42.so"]


def test_a_working_cuda_device_is_preferred(monkeypatch, offer, answers):
    monkeypatch.setattr(backend, "_has_cuda_driver", lambda: True)
    offer("/nowhere/libLLVM-42.so")
    answers({"cuda": "works"})
    assert backend.doctor().variant == "cuda_ad_rgb"


def test_a_cuda_driver_without_a_device_is_not_used(monkeypatch, offer, answers):
    monkeypatch.setattr(backend, "_has_cuda_driver", lambda: True)
    offer("/nowhere/libLLVM-42.so")
    answers({"cuda": "fails: no device", "libLLVM-42.so": "works"})
    assert backend.doctor().variant == "llvm_ad_rgb"


def test_candidates_are_the_users_library_the_environments_then_the_newest(
    monkeypatch, tmp_path
):
    packaged = llvm.environment_library()
    for name in (
        "libLLVM-9.so",
        "libLLVM-14.so.1",
        "libLLVM.so.19.1",
        "libLLVM-20.so",
        "libc.so",
    ):
        (tmp_path / name).write_text("")
    monkeypatch.setattr(llvm, "_FOLDERS", (str(tmp_path),))
    newest_first = [
        "libLLVM-20.so",
        "libLLVM.so.19.1",
        "libLLVM-14.so.1",
        "libLLVM-9.so",
    ]
    assert llvm.candidates()[0] == packaged
    assert [file.name for file in llvm.candidates()[1:]] == newest_first
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-14.so.1"))
    names = [file.name for file in llvm.candidates()]
    assert names == [
        "libLLVM-14.so.1",
        packaged.name,
        "libLLVM-20.so",
        "libLLVM.so.19.1",
        "libLLVM-9.so",
    ]


def test_links_to_one_library_are_one_candidate(monkeypatch, bare, tmp_path):
    (tmp_path / "libLLVM.so.19.1").write_text("")
    (tmp_path / "libLLVM-19.so").symlink_to("libLLVM.so.19.1")
    (tmp_path / "libLLVM.so").symlink_to("libLLVM-19.so")
    monkeypatch.setattr(llvm, "_FOLDERS", (str(tmp_path),))
    assert [file.name for file in llvm.candidates()] == ["libLLVM.so.19.1"]


def test_a_probe_is_cached_until_the_library_changes(answers, tmp_path):
    library = broken(tmp_path)
    probed = answers({"libLLVM-99.so": "fails: broken"})
    first = llvm.probe("llvm_ad_rgb", library)
    assert llvm.probe("llvm_ad_rgb", library) == first
    assert len(probed) == 1
    library.write_text("another file, of another size\n")
    llvm.probe("llvm_ad_rgb", library)
    assert len(probed) == 2


@pytest.mark.parametrize(
    "damage", ["", "{", "[1, 2]", '"text"', "null", "\x00\xff", "rows"]
)
def test_a_damaged_probe_cache_is_ignored(answers, own_cache, tmp_path, damage):
    library = broken(tmp_path)
    probed = answers({"libLLVM-99.so": "works"})
    llvm.probe("llvm_ad_rgb", library)
    memory = own_cache / "twinlens-backends.json"
    rows = {key: ["not", "a", "row"] for key in json.loads(memory.read_text())}
    memory.write_bytes(
        json.dumps(rows).encode() if damage == "rows" else damage.encode("latin-1")
    )
    assert llvm.probe("llvm_ad_rgb", library).works
    assert len(probed) == 2
    assert llvm.probe("llvm_ad_rgb", library).works
    assert len(probed) == 2


def test_a_read_only_cache_folder_only_costs_a_probe(monkeypatch, answers, tmp_path):
    """The folder's name is that of a file, which also fails for root."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path / "file"))
    probed, library = answers({"libLLVM-99.so": "works"}), broken(tmp_path)
    for _ in range(2):
        assert llvm.probe("llvm_ad_rgb", library).works
    assert len(probed) == 2


def test_a_probe_that_hangs_is_reported_as_a_timeout(monkeypatch, tmp_path):
    """A real child that sleeps."""
    monkeypatch.setattr(llvm, "_PROBE_SECONDS", 0.5)
    monkeypatch.setattr(llvm, "_PROBE", "import time; time.sleep(60)")
    result = llvm.probe("llvm_ad_rgb", broken(tmp_path))
    assert not result.works
    assert "did not answer" in result.answer


def test_a_timeout_is_not_cached(answers, tmp_path):
    probed, library = (
        answers({"libLLVM-99.so": "did not answer within 120 s"}),
        broken(tmp_path),
    )
    for _ in range(2):
        llvm.probe("llvm_ad_rgb", library)
    assert len(probed) == 2


@pytest.mark.parametrize(
    ("script", "answer"),
    [
        ("raise SystemExit(0)", "works"),
        ("import os; os.abort()", "aborts the process (signal 6)"),
        ("raise RuntimeError('two\\nlines')", "fails: lines"),
        (
            "raise RuntimeError('word ' * 70 + 'end.')",
            f"fails: RuntimeError: {'word ' * 70}end.",
        ),
        (
            "raise RuntimeError('word ' * 200)",
            f"fails: RuntimeError: {'word ' * 76}...",
        ),
        (
            "raise ImportError('no LLVM was found! Set the variable.')",
            "fails: ImportError: no LLVM was found!",
        ),
        ("raise SystemExit(3)", "fails with exit code 3"),
    ],
)
def test_every_exit_of_a_probe_has_a_message(monkeypatch, script, answer):
    quiet = "import resource; resource.setrlimit(resource.RLIMIT_CORE, (0, 0)); "
    monkeypatch.setattr(llvm, "_PROBE", quiet + script)
    assert llvm.probe("llvm_ad_rgb").answer == answer


@pytest.mark.parametrize("wish", ["scalar", "llvm19", "gpu"])
def test_an_unknown_backend_name_is_an_error(monkeypatch, wish):
    monkeypatch.setenv("TWINLENS_BACKEND", wish)
    with pytest.raises(InputError, match="auto, cuda, llvm") as caught:
        backend.backend.__wrapped__()
    assert "\n" not in str(caught.value)


def test_an_empty_backend_name_is_none(monkeypatch):
    monkeypatch.setenv("TWINLENS_BACKEND", "")
    assert backend._wanted() == "auto"


@pytest.mark.parametrize("wish", ["llvm", "cuda"])
def test_a_backend_that_does_not_work_is_an_error(monkeypatch, offer, answers, wish):
    offer("/nowhere/libLLVM-15.so")
    answers({"libLLVM-15.so": "aborts the process (signal 6)"})
    monkeypatch.setenv("TWINLENS_BACKEND", wish)
    reason = {"llvm": "libLLVM-15.so aborts", "cuda": "no NVIDIA driver"}[wish]
    with pytest.raises(BackendError, match=reason) as caught:
        backend.doctor()
    assert "\n" not in str(caught.value)


HOST = (
    "import mitsuba; mitsuba.set_variant('{variant}'); "
    "from twinlens.rendering import backend; print(backend().variant)"
)


def test_a_variant_set_by_the_host_is_kept():
    library = str(llvm.environment_library())
    child = run_python(HOST.format(variant="llvm_ad_rgb"), DRJIT_LIBLLVM_PATH=library)
    assert child.stdout.strip() == "llvm_ad_rgb", child.stderr


def test_an_unsupported_variant_is_an_error():
    child = run_python(HOST.format(variant="scalar_rgb"))
    assert child.returncode == 1
    last = child.stderr.splitlines()[-1]
    assert "BackendError: mitsuba's variant is already scalar_rgb" in last


def test_the_working_llvm_of_this_machine_is_used():
    """Where an LLVM works, `auto` finds it: the machine's own candidates, real probes."""
    child = run_python(
        "from twinlens.rendering import backend; b = backend(); print(b.name, b.library)"
    )
    name, library = child.stdout.split()
    assert name in ("llvm", "cuda")
    assert name == "cuda" or Path(library).exists()


def test_a_missing_library_named_by_the_user_leads_to_the_one_that_works():
    """The whole way."""
    script = (
        "from twinlens.rendering.backends import mitsuba; mi = mitsuba()\n"
        "mi.render(mi.load_dict(mi.cornell_box()), spp=1); print(mi.variant())"
    )
    child = run_python(script, DRJIT_LIBLLVM_PATH="/nonexistent")
    assert child.returncode == 0, child.stderr
    assert child.stdout.strip() in ("llvm_ad_rgb", "cuda_ad_rgb")


def test_a_host_that_imported_mitsuba_with_a_broken_path_gets_one_line():
    script = "import mitsuba; from twinlens.rendering import backend; backend()"
    child = run_python(script, DRJIT_LIBLLVM_PATH="/nonexistent")
    last = child.stderr.splitlines()[-1] if child.stderr else ""
    assert (
        child.returncode == 0
        or "BackendError: llvm_ad_rgb does not work in this process" in last
    )


def test_importing_twinlens_imports_no_renderer():
    child = run_python(
        "import sys, twinlens, twinlens.rendering; print('mitsuba' in sys.modules, 'drjit' in sys.modules)"
    )
    assert child.stdout.split() == ["False", "False"], child.stderr


def run_python(script, *arguments, **environment):
    usual = {
        key: value
        for key, value in os.environ.items()
        if key not in ("TWINLENS_BACKEND", "DRJIT_CACHE_DIR")
    }
    return subprocess.run(
        [sys.executable, "-c", script, *arguments],
        env=usual | environment,
        capture_output=True,
        text=True,
        timeout=200,
    )


def test_a_host_that_loaded_another_library_first_gets_one_line():
    """Debian's LLVM 15 aborts the process at its first render."""
    code = """
        from pathlib import Path
        from twinlens.rendering import backend, backends
        backend()
        try:
            backends._check_loaded(Path("/usr/lib/libLLVM-99.so"))
        except backends.BackendError as error:
            print(error)
    """
    answer = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True
    )
    assert "has loaded" in answer.stdout
    assert "DRJIT_LIBLLVM_PATH=/usr/lib/libLLVM-99.so" in answer.stdout
