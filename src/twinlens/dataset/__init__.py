"""Samples and datasets on disk: codecs, samples, manifests, verification, export and loading. Never renders.

docs/format.md describes the files.
"""

from twinlens.dataset.card import describe as describe
from twinlens.dataset.codecs.calib import Calibration as Calibration
from twinlens.dataset.codecs.pfm import (
    read_disparity as read_disparity,
    read_pfm as read_pfm,
    write_pfm as write_pfm,
)
from twinlens.dataset.codecs.png import (
    read_image as read_image,
    read_png as read_png,
    write_png as write_png,
)
from twinlens.dataset.dataset import (
    Dataset as Dataset,
    Manifest as Manifest,
    Row as Row,
    open_sample as open_sample,
    read_manifest as read_manifest,
    write_manifest as write_manifest,
)
from twinlens.dataset.metadata import About as About
from twinlens.dataset.real_pairs import (
    downloaded_pairs as downloaded_pairs,
    open_pair as open_pair,
)
from twinlens.dataset.sample import Frame as Frame, Sample as Sample, Shot as Shot
from twinlens.dataset.sample_files import write_sample as write_sample
from twinlens.dataset.storage import (
    Place as Place,
    RemotePath as RemotePath,
    place as place,
)
from twinlens.dataset.stored import StoredSample as StoredSample
from twinlens.dataset.training import (
    collate as collate,
    crop as crop,
    stereo_flip as stereo_flip,
)
from twinlens.dataset.verify import verify_place as verify_place
