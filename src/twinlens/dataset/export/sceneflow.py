"""SceneFlow's FlyingThings3D: one frame a scene, in the clean pass, disparity of both views as PFM.

Those datasets have no calibration file, since every one of their cameras is the same; here each scene has calib.txt
beside its disparity. Disparity is positive in both views, and unknown is +inf, which training code drops with what lies
beyond its range.

Source: Mayer et al., A large dataset to train convolutional networks for disparity, optical flow, and scene flow
estimation, 2016; https://lmb.informatik.uni-freiburg.de/resources/datasets/SceneFlowDatasets.en.html.
"""

from collections.abc import Iterable, Iterator

from twinlens.dataset.codecs.calib import encode_calib
from twinlens.dataset.codecs.pfm import encode_pfm
from twinlens.dataset.export.source import Source

_FRAME = "0006"  # the first of every original scene


def sceneflow(sources: Iterable[Source]) -> Iterator[tuple[str, bytes]]:
    """SceneFlow/FlyingThings3D/{frames_cleanpass,disparity}/TRAIN/A/<number>/{left,right}/0006.{png,pfm}."""
    for source in sources:
        scene = f"TRAIN/A/{source.index:04d}"
        for i, side in enumerate(("left", "right")):
            yield f"SceneFlow/FlyingThings3D/frames_cleanpass/{scene}/{side}/{_FRAME}.png", source.image(i)
            disparity = encode_pfm(source.disparity(i))
            yield f"SceneFlow/FlyingThings3D/disparity/{scene}/{side}/{_FRAME}.pfm", disparity
        yield f"SceneFlow/FlyingThings3D/disparity/{scene}/calib.txt", encode_calib(source.sample.calibration).encode()
