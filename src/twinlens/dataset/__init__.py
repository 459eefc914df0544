"""Samples and datasets on disk: codecs, samples, manifests, verification, export and loading. Never renders.

docs/format.md describes the files.
"""

from twinlens.dataset.card import describe, write_card
from twinlens.dataset.codecs.calib import Calibration, read_calib, write_calib
from twinlens.dataset.codecs.exr import read_exr, write_exr
from twinlens.dataset.codecs.pfm import encode_pfm, read_disparity, read_pfm, write_pfm
from twinlens.dataset.codecs.png import encode_png, read_image, read_png, write_png
from twinlens.dataset.dataset import Dataset, Manifest, Row, open_sample, read_manifest, row_of, write_manifest
from twinlens.dataset.files import hash_files, remove_unfinished
from twinlens.dataset.metadata import About, write_croissant
from twinlens.dataset.quantities import statistics
from twinlens.dataset.real_pairs import DownloadedPair, RealPair, downloaded_pairs, motorcycle
from twinlens.dataset.sample import Sample, Shot, sample_files, write_sample
from twinlens.dataset.storage import Place, RemotePath, Where, is_whole, place
from twinlens.dataset.stored import StoredSample, StoredShot
from twinlens.dataset.truth_files import read_truth
from twinlens.dataset.verify import repair_hint, unchecked, unfinished, verify_dataset, verify_place, verify_sample
from twinlens.dataset.visibility import mask_from_both, mask_from_one

__all__ = [
    "About",
    "Calibration",
    "Dataset",
    "DownloadedPair",
    "Manifest",
    "Place",
    "RealPair",
    "RemotePath",
    "Row",
    "Sample",
    "Shot",
    "StoredSample",
    "StoredShot",
    "Where",
    "describe",
    "downloaded_pairs",
    "encode_pfm",
    "encode_png",
    "hash_files",
    "is_whole",
    "mask_from_both",
    "mask_from_one",
    "motorcycle",
    "open_sample",
    "place",
    "read_calib",
    "read_disparity",
    "read_exr",
    "read_image",
    "read_manifest",
    "read_pfm",
    "read_png",
    "read_truth",
    "remove_unfinished",
    "repair_hint",
    "row_of",
    "sample_files",
    "statistics",
    "unchecked",
    "unfinished",
    "verify_dataset",
    "verify_place",
    "verify_sample",
    "write_calib",
    "write_card",
    "write_croissant",
    "write_exr",
    "write_manifest",
    "write_pfm",
    "write_png",
    "write_sample",
]
