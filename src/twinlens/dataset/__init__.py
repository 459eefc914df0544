"""Samples and datasets on disk: codecs, samples, manifests, verification, export and loading. Never renders.

docs/format.md describes the files.
"""

from twinlens.dataset.card import describe, write_card
from twinlens.dataset.codecs.calib import Calibration
from twinlens.dataset.codecs.pfm import read_disparity, read_pfm, write_pfm
from twinlens.dataset.codecs.png import encode_png, read_image, read_png, write_png
from twinlens.dataset.dataset import Dataset, Manifest, Row, open_sample, read_manifest, row_of, write_manifest
from twinlens.dataset.files import remove_unfinished
from twinlens.dataset.metadata import About, write_croissant
from twinlens.dataset.real_pairs import downloaded_pairs, motorcycle
from twinlens.dataset.sample import Sample, Shot, sample_files, write_sample
from twinlens.dataset.storage import Place, RemotePath, place
from twinlens.dataset.stored import StoredSample
from twinlens.dataset.verify import repair_hint, unchecked, unfinished, verify_place

__all__ = [
    "About",
    "Calibration",
    "Dataset",
    "Manifest",
    "Place",
    "RemotePath",
    "Row",
    "Sample",
    "Shot",
    "StoredSample",
    "describe",
    "downloaded_pairs",
    "encode_png",
    "motorcycle",
    "open_sample",
    "place",
    "read_disparity",
    "read_image",
    "read_manifest",
    "read_pfm",
    "read_png",
    "remove_unfinished",
    "repair_hint",
    "row_of",
    "sample_files",
    "unchecked",
    "unfinished",
    "verify_place",
    "write_card",
    "write_croissant",
    "write_manifest",
    "write_pfm",
    "write_png",
    "write_sample",
]
