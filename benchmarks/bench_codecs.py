"""Time of writing a sample: PNG by three writers, truth maps by OpenEXR's lossless methods, and a whole sample.

    python benchmarks/bench_codecs.py

The images are the Motorcycle pair (741 x 500); the truth maps are made from its measured depth. CPU time in ms of all
threads, minimum of five runs. OpenCV has a row if it is installed.
"""

import io
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from PIL import Image
from rich.console import Console
from rich.table import Table

from twinlens.camera import ThinLens
from twinlens.camera.truth import Truth
from twinlens.dataset import Dataset, Sample, Shot, write_sample
from twinlens.dataset.channels import TRUTH
from twinlens.dataset.codecs.exr import decode_exr
from twinlens.dataset.codecs.png import decode_png, encode_png
from twinlens.dataset.sample_files import sample_files
from twinlens.scoring import motorcycle

RUNS = 5


def cpu_ms(function: Callable[[], Any]) -> float:
    """Least CPU time of `function`, milliseconds."""
    times = []
    for _ in range(RUNS):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return 1e3 * min(times)


def real_sample() -> Sample:
    """Motorcycle as a sample: its images, and truth from its depth (unknown pixels are rays that hit nothing)."""
    pair = motorcycle()
    rig = pair.calibration.rig()
    depth = pair.calibration.depth(pair.disp0)
    hit = np.isfinite(depth)
    camera = rig.cameras[0]
    position = np.where(
        hit[..., None],
        camera.unproject(camera.pixel_grid()) * np.where(hit, depth, 1)[..., None],
        np.inf,
    )
    slope = np.stack(
        [*np.gradient(np.where(hit, depth, 0))[::-1], np.full(depth.shape, -0.01)],
        axis=-1,
    )
    normal = (slope / np.linalg.norm(slope, axis=-1, keepdims=True)).astype(np.float32)
    ids = np.where(hit, 1 + np.floor(4 * np.where(hit, depth, 0)), 0).astype(np.int32)
    kind = hit.astype(np.uint8)
    names = tuple(f"part {i}" for i in range(ids.max()))
    visible = pair.mask0_nonocc == 255
    truth = Truth(
        depth,
        position,
        pair.disp0,
        visible,
        normal,
        normal,
        ids,
        ids,
        kind,
        names,
        names,
    )
    return Sample(
        rig, (Shot(ThinLens(0.01, 3.0), (pair.im0, pair.im1)),), (truth, truth)
    )


def png_rows(image: np.ndarray) -> list[tuple[str, float, int]]:
    """(writer, CPU ms, bytes) of one 8-bit image."""

    def by_pillow(level: int) -> bytes:
        stream = io.BytesIO()
        Image.fromarray(image).save(stream, "PNG", compress_level=level)
        return stream.getvalue()

    writers: dict[str, Callable[[], Any]] = {
        "twinlens: Paeth, run lengths": lambda: encode_png(image)
    }
    writers |= {
        f"Pillow, level {level}": lambda level=level: by_pillow(level)
        for level in (1, 6)
    }
    try:
        import cv2

        writers["OpenCV, its default"] = lambda: cv2.imencode(".png", image)[1]
    except ImportError:
        pass
    return [(name, cpu_ms(writer), len(writer())) for name, writer in writers.items()]


def exr_rows(channels: dict[str, np.ndarray]) -> list[tuple[str, float, int]]:
    """(method, CPU ms, bytes) of one view's truth."""

    def encode(method: Any) -> bytes:
        stream = io.BytesIO()
        OpenEXR.File(
            {"compression": method, "type": OpenEXR.scanlineimage}, channels
        ).write(stream)
        return stream.getvalue()

    names = ("NO", "RLE", "ZIPS", "ZIP", "PIZ")
    methods = {name: getattr(OpenEXR, f"{name}_COMPRESSION") for name in names}
    return [
        (name, cpu_ms(lambda m=m: encode(m)), len(encode(m)))
        for name, m in methods.items()
    ]


def whole_rows(sample: Sample, folder: Path) -> list[tuple[str, float, int]]:
    """(step, CPU ms, bytes) of a sample with two images and two truths."""
    files = sample_files(sample)
    size = sum(len(data) for data in files.values())
    write_sample(folder / "s", sample)
    stored = Dataset(folder)[0]
    return [
        ("encode (sample_files)", cpu_ms(lambda: sample_files(sample)), size),
        (
            "encode, hash, write, flush (write_sample)",
            cpu_ms(lambda: write_sample(folder / "s", sample, True)),
            size,
        ),
        ("read one image", cpu_ms(lambda: stored.im0), len(files["im0.png"])),
        ("read one truth", cpu_ms(lambda: stored.truth0), len(files["truth0.exr"])),
    ]


def table(title: str, rows: list[tuple[str, float, int]]) -> Table:
    """The rows, for the terminal."""
    result = Table("", "CPU ms", "kB", title=title)
    for name, milliseconds, size in rows:
        result.add_row(name, f"{milliseconds:.1f}", f"{size / 1e3:.0f}")
    return result


def main() -> None:
    """Print the three tables."""
    sample = real_sample()
    image = sample.shots[0].images[0]
    data = TRUTH.encode(sample, 0)
    np.testing.assert_array_equal(decode_png(encode_png(image)), image)
    console = Console()
    console.print(table("One 8-bit image as PNG", png_rows(image)))
    console.print(
        table("One view's truth as EXR", exr_rows(dict(decode_exr(data).channels)))
    )
    with tempfile.TemporaryDirectory() as folder:
        console.print(
            table("A sample: two images, two truths", whole_rows(sample, Path(folder)))
        )


if __name__ == "__main__":
    main()
