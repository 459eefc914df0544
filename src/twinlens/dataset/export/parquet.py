"""Parquet, as Hugging Face's `datasets` reads it: a row a sample, images and maps as encoded files inside it.

`datasets.load_dataset("parquet", data_files="*.parquet")` decodes the columns marked as images: im0, im1 and the masks
are PNG, the disparities PFM (Pillow's mode F, +inf unknown). The calibration stands in columns of its own.

Source: Apache Parquet; Hugging Face datasets, "Image" feature: a struct of `bytes` and `path`.
"""

import importlib
import io
import json
from collections.abc import Iterable, Iterator
from typing import Any

from twinlens.dataset.codecs.pfm import encode_pfm
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.export.source import Source
from twinlens.dataset.files import read_bytes
from twinlens.errors import MissingExtraError

FILE_BYTES = 256 * 1024 * 1024
IMAGES = ("im0", "im1", "disp0", "disp1", "mask0_nonocc", "mask1_nonocc")
NUMBERS = ("width", "height", "fx", "fy", "cx0", "cx1", "cy", "baseline", "doffs", "ndisp")


def parquet(sources: Iterable[Source], file_bytes: int = FILE_BYTES) -> Iterator[tuple[str, bytes]]:
    """train-00000.parquet and so on, each closed with the sample that reaches `file_bytes`; a row group a sample.

    Raises MissingExtraError without pyarrow.
    """
    schema = _schema()
    number, stream, writer = 0, io.BytesIO(), None
    for source in sources:
        writer = writer or _writer(stream, schema)
        writer.write_table(_table(source, schema))
        if stream.tell() >= file_bytes:
            yield f"train-{number:05d}.parquet", _closed(writer, stream)
            number, stream, writer = number + 1, io.BytesIO(), None
    if writer:
        yield f"train-{number:05d}.parquet", _closed(writer, stream)


def _schema() -> Any:
    pa, _ = _pyarrow()
    image = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    numbers = [(name, pa.int32() if name in ("width", "height", "ndisp") else pa.float64()) for name in NUMBERS]
    fields = [("name", pa.string()), *((name, image) for name in IMAGES), *numbers, ("record", pa.string())]
    features: dict[str, Any] = {name: {"dtype": str(kind), "_type": "Value"} for name, kind in fields}
    features |= {name: {"_type": "Image"} for name in IMAGES}
    features |= {name: {"dtype": "float64", "_type": "Value"} for name, kind in numbers if kind == pa.float64()}
    return pa.schema(fields, metadata={"huggingface": json.dumps({"info": {"features": features}})})


def _table(source: Source, schema: Any) -> Any:
    pa, _ = _pyarrow()
    sample, calibration = source.sample, source.sample.calibration
    files = {"im0.png": source.image(0), "im1.png": source.image(1)}
    files |= {f"disp{i}.pfm": encode_pfm(sample.disparity(i)) for i in (0, 1)}
    files |= {f"mask{i}nocc.png": encode_png(sample.mask_nonocc(i)) for i in (0, 1)}
    entries = ({"bytes": data, "path": f"{source.name}/{name}"} for name, data in files.items())
    fx, fy, cx0, cy = calibration.cam0
    place = (calibration.width, calibration.height, fx, fy, cx0, calibration.cam1[2], cy)
    numbers = (*place, calibration.baseline, calibration.doffs, sample.ndisp)
    record = read_bytes(sample.folder / "sample.json").decode() if sample.has("sample.json") else ""
    row: dict[str, Any] = {"name": sample.name, "record": record}
    row |= dict(zip(IMAGES, entries, strict=True)) | dict(zip(NUMBERS, numbers, strict=True))
    return pa.Table.from_pylist([row], schema=schema)


def _writer(stream: io.BytesIO, schema: Any) -> Any:
    # The columns are compressed files already.
    return _pyarrow()[1].ParquetWriter(stream, schema, compression="NONE")


def _closed(writer: Any, stream: io.BytesIO) -> bytes:
    writer.close()
    return stream.getvalue()


def _pyarrow() -> tuple[Any, Any]:
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise MissingExtraError("exporting to parquet needs pyarrow: pip install 'twinlens[parquet]'") from None
