"""`twinlens doctor`: the rendering backends of this machine."""

import os
import platform
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version

import click

from twinlens.cli.options import json_option, print_json
from twinlens.rendering import doctor

_PACKAGES = (
    "twinlens",
    "mitsuba",
    "drjit",
    "numpy",
    "numba",
    "OpenEXR",
    "trimesh",
    "scikit-image",
)


@click.command("doctor")
@json_option("the findings")
def command(as_json: bool) -> None:
    """Show which rendering backend works on this machine, why, and what to install.

    LLVM libraries: that of DRJIT_LIBLLVM_PATH, that of this Python environment, then those of the system, newest first.
    Those of the system are tested in a separate process, because some versions abort the process. The results are
    stored next to the kernel cache.

    \b
    Example:  twinlens doctor
    """
    chosen = doctor()
    versions = {name: _version(name) for name in _PACKAGES}
    if as_json:
        print_json({"backend": asdict(chosen), "versions": versions})
        return
    click.echo(f"backend   {chosen.variant}: {chosen.reason}")
    for probe in chosen.probes:
        click.echo(f"tried     {probe.path}: {probe.answer}")
    click.echo(
        f"machine   {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    )
    click.echo(
        "packages  "
        + ", ".join(f"{name} {number}" for name, number in versions.items())
    )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"
