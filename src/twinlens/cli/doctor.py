"""`twinlens doctor`: what was found, what is chosen, what to install."""

import json
import os
import platform
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version

import click

_PACKAGES = ("twinlens", "mitsuba", "drjit", "numpy", "numba", "OpenEXR", "trimesh", "scikit-image")


@click.command("doctor")
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def command(as_json: bool) -> None:
    """Show which rendering backend works here, why, and what to install.

    Every LLVM library found is tried in a process of its own, newest first: some versions abort the process that
    uses them. The answers are remembered beside the kernel cache.

    \b
    Example:  twinlens doctor
    """
    from twinlens.rendering import doctor

    found = doctor()
    versions = {name: _version(name) for name in _PACKAGES}
    if as_json:
        click.echo(json.dumps({"backend": asdict(found), "versions": versions}, indent=1))
        return
    click.echo(f"backend   {found.variant}: {found.reason}")
    if found.advice:
        click.echo(f"advice    {found.advice}")
    for probe in found.probes:
        click.echo(f"tried     {probe.path}: {probe.answer}")
    click.echo(f"machine   {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    click.echo("packages  " + ", ".join(f"{name} {number}" for name, number in versions.items()))


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"
