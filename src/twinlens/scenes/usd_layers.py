"""The files that a USD file is made of, checked before usd-core opens any of them.

A layer may name others, anywhere on the machine and on the web. So layers are opened one by one, and the names in each
are checked by the rule of all mesh files before the stage is composed: only files below the scene's folder. Source:
OpenUSD, `Sdf.Layer.GetCompositionAssetDependencies` and the specification of .usdz.
"""

import posixpath
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from twinlens.errors import FileError, InputError, format_value

_MOST_LAYERS = 1000
_PACKAGED = re.compile(r"^(?P<package>.*\.usdz)\[(?P<inside>[^\[\]]+)\]$")

Find = Callable[[str, Path], Path]
"""The path of a file that the file at a path names. Raises InputError outside the scene's folder."""


class UsdFiles:
    """The layers of a file, and the content of its pictures.

    allow: called with the size of each layer before it is opened.

    Raises InputError for a layer that names a file outside the folder, that does not exist, or that changes with time
    by other files.
    """

    def __init__(
        self, path: Path, sdf: Any, find: Find, allow: Callable[[int], None]
    ) -> None:
        self.path = path
        self.allow = allow
        self._sdf = sdf
        self._find = find
        self._seen: set[str] = set()
        self._check(str(path))

    def picture(self, asset: Any, layer: str) -> bytes:
        """The content of an asset that an attribute in a layer names. Raises InputError."""
        name = asset.path
        if not name:
            raise InputError("a texture has no file")
        resolved = self._resolved(name, layer)
        packaged = _PACKAGED.match(resolved)
        if packaged is None:
            return Path(resolved).read_bytes()
        with zipfile.ZipFile(packaged["package"]) as archive:
            return archive.read(packaged["inside"])

    def _check(self, layer: str) -> None:
        """Check the names in a layer and in those that it names."""
        if layer in self._seen:
            return
        self._seen.add(layer)
        if len(self._seen) > _MOST_LAYERS:
            raise InputError(f"has more than {_MOST_LAYERS} layers")
        if not _PACKAGED.match(layer):
            self.allow(Path(layer).stat().st_size)
        opened = self._sdf.Layer.FindOrOpen(layer)
        if opened is None:
            raise FileError(f"{layer}: not a USD file; is it complete?")
        self._refuse_clips(opened)
        # References to other prims of the same layer have no name.
        for name in filter(None, opened.GetCompositionAssetDependencies()):
            self._check(self._resolved(name, layer))

    def _resolved(self, name: str, layer: str) -> str:
        """The file that a layer names, in its folder or in its package."""
        package = _PACKAGED.match(layer)
        if package is None and layer.lower().endswith(".usdz"):
            # The first file of a package is its root layer.
            with zipfile.ZipFile(layer) as archive:
                names = archive.namelist()
            package = _PACKAGED.match(f"{layer}[{names[0]}]") if names else None
        if package is None:
            return str(self._find(name, Path(layer)))
        folder = posixpath.dirname(package["inside"])
        inside = posixpath.normpath(posixpath.join(folder, name))
        with zipfile.ZipFile(package["package"]) as archive:
            if inside not in archive.namelist():
                raise InputError(f"no file {format_value(name)} in the package")
        return f"{package['package']}[{inside}]"

    def _refuse_clips(self, layer: Any) -> None:
        """Value clips read further files when a value is asked for. Prims and their variants have them."""
        paths_with_clips: list[str] = []

        def visit(path: Any) -> None:
            spec = layer.GetObjectAtPath(path)
            if spec is not None and spec.HasInfo("clips"):
                paths_with_clips.append(str(path))

        layer.Traverse(self._sdf.Path.absoluteRootPath, visit)
        if paths_with_clips:
            raise InputError(
                f"{paths_with_clips[0]} has value clips; export it without them"
            )
