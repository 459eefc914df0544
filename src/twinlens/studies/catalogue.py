"""The studies by name, and where others come from: an installed package, or a file of one's own."""

import dataclasses
import importlib.metadata
import importlib.util
import os
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from twinlens.errors import FileError, InputError, TwinlensError, unknown
from twinlens.studies import aperture, baseline, focal_length, focus, pinhole, radiometric, texture, window
from twinlens.studies.model import Study
from twinlens.studies.run import run_study
from twinlens.studies.table import Table

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        aperture.STUDY,
        pinhole.STUDY,
        focus.STUDY,
        window.STUDY,
        baseline.STUDY,
        focal_length.STUDY,
        radiometric.STUDY,
        texture.STUDY,
    )
}
ENTRY_POINTS = "twinlens.studies"


def find_study(name: str | os.PathLike[str]) -> Study:
    """The study of this name, or the one called STUDY in the Python file of this name.

    A package offers one under the entry point `twinlens.studies`. A file's code is run.

    Raises InputError for an unknown name, with the nearest one; FileError for a file that gives no study.

    >>> find_study("apertur")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    twinlens.errors.InputError: unknown study 'apertur'; did you mean 'aperture'? (known: ...
    """
    text = os.fspath(name)
    if text in STUDIES:
        return STUDIES[text]
    if text.endswith(".py"):
        return _from_file(Path(text))
    installed = {point.name: point for point in importlib.metadata.entry_points(group=ENTRY_POINTS)}
    if text not in installed:
        raise unknown("study", text, [*STUDIES, *installed])
    return _checked(installed[text].load(), f"the entry point {installed[text].value}")


def study(name: str | os.PathLike[str], **choices: Any) -> Table:
    """Run a study and return its table; `choices` are those of `run_study`, which gives findings and pictures too.

    >>> table = study("texture", seeds=1)  # doctest: +SKIP
    >>> table.where(method="zncc").numbers("error_px")  # doctest: +SKIP
    """
    return run_study(find_study(name), **choices).table


def _from_file(path: Path) -> Study:
    if not path.is_file():
        raise FileError(f"{path}: there is no such file; a study of your own is a Python file that ends in STUDY = ...")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise FileError(f"{path}: cannot be imported as Python")
    module = importlib.util.module_from_spec(spec)
    _told(path, spec.loader.exec_module)(module)
    found = _checked(getattr(module, "STUDY", None), str(path))
    return dataclasses.replace(found, measure=_told(path, found.measure), conclude=_told(path, found.conclude))


def _told(path: Path, function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """The function of a user's file; what it raises becomes one line that says where in the file."""

    def call(given: Any) -> Any:
        try:
            return function(given)
        except TwinlensError:
            raise
        except (Exception, SystemExit) as error:
            frames = traceback.extract_tb(error.__traceback__)
            lines = [frame.lineno for frame in frames if frame.filename == str(path)]
            line = f", line {lines[-1]}" if lines else ""
            raise FileError(f"{path}{line}: {type(error).__name__}: {' '.join(str(error).split())}") from error

    return call


def _checked(found: Any, where: str) -> Study:
    if not isinstance(found, Study):
        raise InputError(f"{where}: gives no study; end it in STUDY = twinlens.studies.Study(...)")
    return found
