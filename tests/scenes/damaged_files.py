"""Files of every form that is read, damaged at random by a seed, and what reading them must do.

Bytes are damaged as disks and downloads do it, and texts as people do who edit them: numbers, lines and words.
"""

import json
import os
import random
import re
import resource
import shutil
import signal
import struct
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import trimesh

from tests.calibrations.calibration_files import KALIBR
from tests.calibrations.test_colmap_binary import MODEL as COLMAP
from tests.calibrations.test_makers import EUROC_LEFT, EUROC_RIGHT, write_euroc
from tests.calibrations.test_reading import (
    KINDS,
    SHIFT,
    files_of,
    intrinsics,
    opencv_file,
)
from tests.dataset.test_calib import MOTORCYCLE
from tests.scenes.gltf_files import png, square, write, write_colored
from tests.scenes.test_gltf_forms import BASISU, KTX2, with_picture
from tests.scenes.test_picture_kinds import PICTURES
from tests.scenes.test_ply_forms import FORMATS, LADDER, STRIP, ply
from tests.scenes.test_xml_check import HARMLESS
from tests.scenes.usd_files import (
    SQUARE,
    TEXTURED,
    instancer,
    prim,
    read_in_a_fork,
    usda,
    write_pictures,
)
from twinlens.calibrations import read_rig
from twinlens.dataset.codecs.calib import read_calib
from twinlens.errors import TwinlensError
from twinlens.scenes.assets import SceneContext, read_mesh, read_picture
from twinlens.scenes.model_files import read_model
from twinlens.scenes.xml_file import read_scene_xml

FORMS = Path(__file__).with_name("gltf_forms")
COMPRESSED = {"draco": ("draco",), "meshopt": ("meshopt", "-cz", "-c-")}
KTX2_MARK = b"\xabKTX 20\xbb"
LONGEST_S = 30  # of processor time; a reader takes a hundredth of it
LONGEST_WAIT_S = 300  # the machine may be busy
MOST_MEMORY = 1 << 20  # kB above that of the good files
LONGEST_MESSAGE = 1500

NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
WORD = re.compile(rb"[A-Za-z_]\w*")
ODD = [b"0", b"-1", b"1e400", b"nan", b"inf", b"99999999999", b"1e-320", b"4294967296",
       b"-2147483649", b"65535", b"3.5", b"true", b'""', b"[]", b"{}"]  # fmt: skip
OBJ = b"""mtllib m.mtl
v 0 0 0
v 1 0 0
v 1 1 0 1 0 0
v 0.5 0.2 0.1
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vn 0 0 1
usemtl red
s 1
f 1/1/1 2/2/1 3/3/1 4/1/1 5/2/1
usemtl b c
f -1/1 -2/2 -3/3
l 1 2
"""
MTL = b"""newmtl red
Kd 1 0.5 0.2
Ks 0 0 0
Ns 10
d 0.5
Ke 1 2 3
Ni 1.4
map_Kd -s 2 2 1 t.png
norm -bm 1 t.png
illum 2
newmtl b c
Pr 0.5
Pm 1
Tr 0.2
map_d t.png
"""


def damaged(good, rng):
    """A file that is cut, or has other bytes, numbers, lines or words; of a .glb file also the header alone."""
    if good[:4] == b"glTF" and (start := good.find(KTX2_MARK)) > 0:
        return with_damaged_picture(good, start, rng)
    if good[:4] == b"glTF" and rng.randrange(3):
        return with_damaged_header(good, rng)
    return rng.choice(DAMAGES)(good, rng)


def with_damaged_header(good, rng):
    """A .glb file whose chunks have the right lengths. Source: glTF 2.0, chapter 4."""
    size = struct.unpack_from("<I", good, 12)[0]
    text = rng.choice(DAMAGES)(good[20 : 20 + size].rstrip(), rng)
    text += b" " * (-len(text) % 4)
    rest = good[20 + size :]
    start = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)  # fmt: skip
    return start + text + rest


def with_damaged_picture(good, start, rng):
    """A .glb file that ends with a KTX2 picture, of the same length. Numbers of 4 bytes stand in its header."""
    data = bytearray(good)
    for _ in range(rng.randint(1, 4)):
        is_header = rng.randrange(2)
        place = start + rng.randrange(12, 104 if is_header else len(good) - start)
        data[place] = rng.randrange(256)
    if not rng.randrange(4):
        place = rng.randrange(start, len(good))
        data[place:] = bytes(len(good) - place)
    return bytes(data)


def cut(good, rng):
    return good[: rng.randrange(len(good))]


def flipped(good, rng):
    data = bytearray(good)
    for _ in range(rng.randint(1, 6)):
        data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data)


def removed(good, rng):
    place = rng.randrange(len(good))
    return good[:place] + good[place + rng.randint(1, 40) :]


def inserted(good, rng):
    place = rng.randrange(len(good))
    return good[:place] + rng.randbytes(rng.randint(1, 12)) + good[place:]


def other_number(good, rng):
    numbers = list(NUMBER.finditer(good))
    if not numbers:
        return cut(good, rng)
    chosen = rng.choice(numbers)
    return good[: chosen.start()] + rng.choice(ODD) + good[chosen.end() :]


def without_a_line(good, rng):
    lines = good.splitlines(keepends=True)
    del lines[rng.randrange(len(lines))]
    return b"".join(lines)


def exchanged(good, rng):
    """Two numbers or two words in each other's place."""
    parts = list(rng.choice([NUMBER, WORD]).finditer(good))
    if len(parts) < 2:
        return cut(good, rng)
    first, second = sorted(rng.sample(parts, 2), key=lambda part: part.start())
    between = good[first.end() : second.start()]
    return b"".join(
        [good[: first.start()], second.group(), between, first.group(), good[second.end() :]]
    )  # fmt: skip


EDITS = [other_number, exchanged]
DAMAGES = [cut, flipped, removed, inserted, without_a_line, *EDITS * 3]
"""Most edits get past a parser; most others do not."""


def model(path):
    made = read_model(path, SceneContext(path.parent)).mesh
    assert np.isfinite(made.vertices).all()
    assert made.faces.max() < len(made.vertices)


def mesh(path):
    made = read_mesh(path)
    assert np.isfinite(made.vertices).all()
    assert made.faces.max() < len(made.vertices)


def picture(path):
    assert np.isfinite(read_picture(path, raw=True)).all()


def written(folder, files):
    """Files by name as those of a folder."""
    folder.mkdir(exist_ok=True)
    for name, data in files.items():
        (folder / name).write_bytes(data)


# Each function writes good files to a folder, and gives (file to damage, function that reads, file that it reads).


def is_compressed(name, form):
    return any(mark in name for mark in COMPRESSED[form])


def copies_of(folder, chosen):
    """The chosen of the files that other programs wrote, and how they are read."""
    paths = [path for path in sorted(FORMS.glob("*.glb")) if chosen(path.name)]
    copies = [Path(shutil.copy(path, folder)) for path in paths]
    return [(path, model, path) for path in copies]


def glb_files(folder):
    plain = write(folder / "a.glb", square(baseColorTexture=None))
    colored = write_colored(folder / "b.glb", np.eye(4, 3), "u1", alphaMode="BLEND")
    own = [(path, model, path) for path in (plain, colored)]
    of_others = copies_of(
        folder, lambda name: not any(is_compressed(name, form) for form in COMPRESSED)
    )
    return [*own, *of_others]


def compressed_files(folder, form):
    return copies_of(folder, lambda name: is_compressed(name, form))


def gltf_files(folder):
    files = trimesh.Scene(square()).export(file_type="gltf")
    written(folder, files)
    path = folder / "model.gltf"
    return [(path, model, path)]


def obj_files(folder):
    written(folder, {"a.obj": OBJ, "m.mtl": MTL, "t.png": png(np.ones((2, 2, 4)))})
    path = folder / "a.obj"
    return [(path, model, path), (path, mesh, path)]


def mtl_files(folder):
    obj_files(folder)
    return [(folder / "m.mtl", model, folder / "a.obj")]


def ply_files(folder):
    box = trimesh.creation.box()
    box.visual.vertex_colors = np.zeros((8, 4), np.uint8)
    paths = []
    for encoding in ("ascii", "binary"):
        path = folder / f"{encoding}.ply"
        path.write_bytes(box.export(file_type="ply", encoding=encoding))
        paths.append((path, mesh, path))
    for form in FORMATS:
        path = folder / f"strips-{form}.ply"
        path.write_bytes(ply(LADDER, [STRIP], form))
        paths.append((path, mesh, path))
    return paths


def stl_files(folder):
    box = trimesh.creation.box()
    text = box.export(file_type="stl_ascii").encode()
    written(folder, {"a.stl": box.export(file_type="stl"), "b.stl": text})
    return [(folder / name, mesh, folder / name) for name in ("a.stl", "b.stl")]


def png_files(folder):
    import cv2

    rng = np.random.default_rng(0)
    paths = []
    for channels in (1, 3, 4):
        for kind in (np.uint8, np.uint16):
            texels = rng.integers(0, np.iinfo(kind).max, (6, 9, channels), dtype=kind)
            path = folder / f"{channels}-{texels.itemsize}.png"
            cv2.imwrite(str(path), texels)
            paths.append((path, picture, path))
    return paths


def picture_files(folder):
    """Pictures of TGA and TIFF."""
    written(folder, {name: data for name, (data, _) in PICTURES.items()})
    return [(folder / name, picture, folder / name) for name in PICTURES]


def ktx2_files(folder):
    """Models with KTX2 pictures, which are damaged alone."""
    paths = []
    for source in sorted(KTX2.glob("*.ktx2")):
        path = folder / f"{source.stem}.glb"
        path.write_bytes(with_picture(source.read_bytes(), BASISU, True))
        paths.append((path, model, path))
    return paths


def xml_files(folder):
    (folder / "deep").mkdir()
    written(folder / "deep", {"t.png": png(np.ones((1, 1, 3)))})
    written(folder, {"s.xml": HARMLESS.encode()})
    return [(folder / "s.xml", read_scene_xml, folder / "s.xml")]


def calibration_files(folder):
    """Those of other programs, where any file of a rig is damaged, and calib.txt."""
    made = []
    for kind in KINDS:
        below = folder / kind.replace(" ", "-")
        below.mkdir()
        paths = files_of(kind, below)
        parts = [part for part in sorted(below.rglob("*")) if part.is_file()]
        parts = [part for part in parts if part.stat().st_size]
        made += [(part, lambda _, paths=paths: read_rig(*paths), part) for part in parts]  # fmt: skip
    written(folder, {"chain.yaml": KALIBR.encode()})
    made.append((folder / "chain.yaml", read_rig, folder / "chain.yaml"))
    left = write_euroc(folder, "cam0", EUROC_LEFT)
    right = write_euroc(folder, "cam1", EUROC_RIGHT)
    made += [(part, lambda _: read_rig(left, right), part) for part in (left, right)]
    binary = [Path(shutil.copy(path, folder)) for path in sorted(COLMAP.glob("*.bin"))]
    made += [(part, lambda _: read_rig(*binary), part) for part in binary]
    turned = {"R": np.array([[0.01], [-0.04], [0.02]]), "T": SHIFT[:, None]}
    size = {"image_width": 640, "image_height": 480}
    vector = opencv_file(folder / "vector.yml", **intrinsics(), **size, **turned)
    made.append((vector, read_rig, vector))
    calib = folder / "calib.txt"
    calib.write_text(MOTORCYCLE)
    return [*made, *[(calib, read_calib, calib)] * 3]


def usd_files(folder, suffix):
    from pxr import Sdf, UsdUtils

    write_pictures(folder)
    copies = """
      int[] protoIndices = [0, 0]
      point3f[] positions = [(5, 0, 0), (6, 0, 0)]
    """
    prims = TEXTURED.replace("SPACE", "") + prim("Cylinder", "tube", "")
    prims += instancer("copies", ["/copies/square"], copies, SQUARE)
    text = usda(folder / "text.usda", prims)
    plain = folder / f"m.{'usda' if suffix == 'usdz' else suffix}"
    Sdf.Layer.FindOrOpen(str(text)).Export(str(plain))
    path = folder / f"m.{suffix}"
    if suffix == "usdz":
        UsdUtils.CreateNewUsdzPackage(str(plain), str(path))
    return [(path, read_in_a_fork, path)]


KINDS_OF_FILES = {
    "glb": glb_files,
    "draco": lambda folder: compressed_files(folder, "draco"),
    "meshopt": lambda folder: compressed_files(folder, "meshopt"),
    "gltf": gltf_files,
    "obj": obj_files,
    "mtl": mtl_files,
    "ply": ply_files,
    "stl": stl_files,
    "png": png_files,
    "pictures": picture_files,
    "ktx2": ktx2_files,
    "xml": xml_files,
    "calibrations": calibration_files,
    "usda": lambda folder: usd_files(folder, "usda"),
    "usdc": lambda folder: usd_files(folder, "usdc"),
    "usdz": lambda folder: usd_files(folder, "usdz"),
}


def outcomes(kind, folder, count, seed=0):
    """How many of `count` damaged files were read and refused, and the faults: (message, data) by kind of fault.

    Every file is read, or refused by a TwinlensError of one line, in `LONGEST_S` and without much memory.
    """
    folder = Path(folder)
    files = KINDS_OF_FILES[kind](folder)
    good = {path: path.read_bytes() for path, _, _ in files}
    rng = random.Random(f"{kind} {seed}")
    counts, faults = Counter(), {}
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGALRM, _too_long)
    for _, read, read_path in files:
        read(read_path)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    slowest = 0.0
    for number in range(count):
        path, read, read_path = files[number % len(files)]
        data = damaged(good[path], rng)
        path.write_bytes(data)
        signal.alarm(LONGEST_WAIT_S)
        start = processor_time()
        try:
            read(read_path)
            counts["read"] += 1
        except TwinlensError as error:
            counts["refused"] += 1
            if "\n" in str(error) or len(str(error)) > LONGEST_MESSAGE:
                faults[f"long: {str(error)[:80]}"] = str(error), data
        except Exception as error:
            faults[f"{type(error).__name__}: {str(error)[:80]}"] = repr(error), data
        finally:
            signal.alarm(0)
            path.write_bytes(good[path])
        seconds = processor_time() - start
        slowest = max(slowest, seconds)
        if seconds > LONGEST_S:
            faults["time"] = f"{seconds:.1f} s", data
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    if grown > MOST_MEMORY:
        faults["memory"] = f"{grown} kB more", b""
    return counts, faults, slowest


def processor_time():
    """Seconds of this process and of its children that have ended."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _too_long(*_):
    raise TimeoutError("too long")


if __name__ == "__main__":
    import sys
    import tempfile

    with tempfile.TemporaryDirectory() as place:
        result = outcomes(sys.argv[1], place, int(sys.argv[2]), int(sys.argv[3]))
    print(sys.argv[1], json.dumps(result[0]), f"slowest {result[2]:.2f} s")
    for fault, (message, content) in result[1].items():
        print("  FAULT", fault, "|", message[:300], "|", content[:300])
