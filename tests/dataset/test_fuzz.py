"""Ten thousand damaged files of each kind: a twinlens error or a read, in bounded memory, and nothing else."""

import resource

import dataset_scene
import numpy as np
import pytest

from twinlens.dataset.codecs import (
    decode_calib,
    decode_exr,
    decode_pfm,
    decode_png,
    encode_calib,
    encode_exr,
    encode_pfm,
    encode_png,
)
from twinlens.dataset.codecs.calib import Calibration
from twinlens.dataset.manifest import decode_manifest
from twinlens.dataset.record import decode_json, encode_json, lens_from_plain, rig_from_plain
from twinlens.dataset.sample import KIND, VERSION, sample_files
from twinlens.errors import TwinlensError

CASES = 10_000
PLANE = np.arange(24 * 31, dtype=np.float32).reshape(24, 31)
COLOR = np.stack([PLANE, PLANE[::-1], PLANE * 3], axis=-1)


def damage(good: bytes, rng: np.random.Generator) -> bytes:
    data = bytearray(good)
    front = rng.random() < 0.5  # headers are short and decide most
    for _ in range(rng.integers(0, 5)):
        place = rng.integers(min(len(data), 120) if front else len(data))
        data[place] = rng.choice([0, 255, data[place] ^ (1 << rng.integers(8)), rng.integers(256)])
    if rng.random() < 0.3:
        start = rng.integers(len(data))
        del data[start : start + rng.integers(1, 20)]
    if rng.random() < 0.3:
        data = data[: rng.integers(len(data) + 1)]
    if rng.random() < 0.2:
        data[rng.integers(len(data) + 1) :] += rng.bytes(rng.integers(1, 9))
    return bytes(data)


def calib_text(data: bytes) -> Calibration:
    return decode_calib(data.decode("utf-8", "replace"))


def record(data: bytes) -> None:
    plain = decode_json(data, "sample.json", KIND, VERSION)
    rig_from_plain(plain.get("rig"))
    for shot in plain.get("shots") if isinstance(plain.get("shots"), list) else []:
        lens_from_plain(shot.get("lens") if isinstance(shot, dict) else None)


MANIFEST = {"format": "twinlens-dataset", "version": 1, "seed": 3, "recipe": {"count": 2}, "info": {}}
MANIFEST["samples"] = [{"name": "train/0", "files": {"im0.png": "00"}, "info": {}}, {"name": "b", "files": {}}]

KINDS = {
    "pfm": (decode_pfm, encode_pfm(PLANE)),
    "color pfm": (decode_pfm, encode_pfm(COLOR)),
    "png": (decode_png, encode_png(COLOR.astype(np.uint8))),
    "16-bit png": (decode_png, encode_png(COLOR.astype(np.uint16))),
    "exr": (decode_exr, encode_exr({"depth": PLANE, "id": PLANE.astype(int)}, {"names": '["a"]'})),
    "calib.txt": (calib_text, encode_calib(Calibration.from_rig(dataset_scene.rig(), ndisp=64)).encode()),
    "sample.json": (record, sample_files(dataset_scene.sample())["sample.json"]),
    "dataset.json": (decode_manifest, encode_json(MANIFEST)),
}


def told(decode, data: bytes) -> bool:
    """Whether the data is refused, in one line."""
    try:
        decode(data)
    except TwinlensError as error:
        message = str(error)
    else:
        return False
    assert "\n" not in message
    return True


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files(kind):
    decode, good = KINDS[kind]
    rng = np.random.default_rng(0)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused = sum(told(decode, damage(good, rng)) for _ in range(CASES))
    assert refused > 0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB
