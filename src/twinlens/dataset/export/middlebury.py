"""Middlebury's scene folders: as torchvision's Middlebury2014Stereo looks for them, and as its CarlaStereo does.

Source: https://vision.middlebury.edu/stereo/data/scenes2014/; torchvision.datasets, documentation of the two classes.
"""

from collections.abc import Iterable, Iterator

from twinlens.dataset.codecs.calib import encode_calib
from twinlens.dataset.codecs.pfm import encode_pfm
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.export.source import Source

_ASKED_FOR = "Middlebury2014/train/Adirondack-is-not-here.txt"
_WHY = """The scenes in this folder were made with twinlens; none is one of Middlebury's.
torchvision's Middlebury2014Stereo opens a folder only if an entry of it begins with the name of a published scene:
this file is that entry.
"""


def middlebury(sources: Iterable[Source]) -> Iterator[tuple[str, bytes]]:
    """Middlebury2014/train/<name>-perfect/: im0 im1 .png, disp0 disp1 .pfm, mask0nocc mask1nocc .png, calib.txt."""
    yield _ASKED_FOR, _WHY.encode()
    for source in sources:
        yield from _scene(source, f"Middlebury2014/train/{source.name}-perfect", "disp{}.pfm")


def carla(sources: Iterable[Source]) -> Iterator[tuple[str, bytes]]:
    """carla-highres/trainingF/<name>/: the same with disp0GT.pfm and disp1GT.pfm, as the MiddEval3 kit names them."""
    for source in sources:
        yield from _scene(source, f"carla-highres/trainingF/{source.name}", "disp{}GT.pfm")


def _scene(source: Source, folder: str, disparity: str) -> Iterator[tuple[str, bytes]]:
    for i in (0, 1):
        yield f"{folder}/im{i}.png", source.image(i)
        yield f"{folder}/{disparity.format(i)}", encode_pfm(source.disparity(i))
        yield f"{folder}/mask{i}nocc.png", encode_png(source.sample.mask_nonocc(i))
    yield f"{folder}/calib.txt", encode_calib(source.sample.calibration).encode()
