"""Layouts of a few large files: WebDataset (tar shards) and Parquet (as Hugging Face's `datasets` reads it).

Shards contain no time and no owner: the same samples give the same bytes.

Sources: https://github.com/webdataset/webdataset, "The WebDataset Format"; POSIX.1-2001, pax; Apache Parquet; Hugging
Face datasets, "Image" feature: a struct of `bytes` and `path`.
"""

import importlib
import io
import json
import tarfile
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from twinlens.dataset.export.layouts import Source
from twinlens.dataset.files import read_bytes
from twinlens.errors import MissingExtraError

FILE_BYTES = 256 * 1024 * 1024
IMAGES = ("im0", "im1", "disp0", "disp1", "mask0_nonocc", "mask1_nonocc")
NUMBERS = ("width", "height", "fx", "fy", "cx0", "cx1", "cy", "baseline", "doffs", "ndisp")


_END = bytes(2 * tarfile.BLOCKSIZE)


def webdataset(sources: Iterable[Source], shard_bytes: int = FILE_BYTES) -> Iterator[tuple[str, bytes]]:
    """shard-000000.tar and so on; a shard ends with the sample that reaches `shard_bytes`.

    Files of a sample follow each other under a common key: ``train/0001.im0.png`` is entry "im0.png" of sample
    train/0001. A key ends at the first dot, so "." in a sample's name is written as "%2E", and "%" as "%25".
    """
    number, stream = 0, io.BytesIO()
    for source in sources:
        key = source.sample.name.replace("%", "%25").replace(".", "%2E")
        for name, data in source.files(least=-np.inf):
            _append(stream, f"{key}.{name}", data)
        if source.sample.has("sample.json"):
            _append(stream, f"{key}.json", read_bytes(source.sample.folder / "sample.json"))
        if stream.tell() >= shard_bytes:
            yield f"shard-{number:06d}.tar", stream.getvalue() + _END
            number, stream = number + 1, io.BytesIO()
    if stream.tell():
        yield f"shard-{number:06d}.tar", stream.getvalue() + _END


def parquet(sources: Iterable[Source], file_bytes: int = FILE_BYTES) -> Iterator[tuple[str, bytes]]:
    """train-00000.parquet and so on; a file ends with the sample that reaches `file_bytes`.

    One row and row group per sample: images and maps as encoded files (PNG, and PFM, which Pillow opens as mode F),
    calibration as columns. Raises MissingExtraError without pyarrow.
    """
    schema = _schema()
    number, stream, writer = 0, io.BytesIO(), None
    for source in sources:
        writer = writer or _pyarrow()[1].ParquetWriter(stream, schema, compression="NONE")  # content is compressed
        writer.write_table(_table(source, schema))
        if stream.tell() >= file_bytes:
            writer.close()
            yield f"train-{number:05d}.parquet", stream.getvalue()
            number, stream, writer = number + 1, io.BytesIO(), None
    if writer:
        writer.close()
        yield f"train-{number:05d}.parquet", stream.getvalue()


def _append(stream: io.BytesIO, name: str, data: bytes) -> None:
    header = tarfile.TarInfo(name)
    header.size, header.mode = len(data), 0o644
    stream.write(header.tobuf(tarfile.PAX_FORMAT))
    stream.write(data + bytes(-len(data) % tarfile.BLOCKSIZE))


def _schema() -> Any:
    pa, _ = _pyarrow()
    image = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    fields = [("name", pa.string()), *((name, image) for name in IMAGES)]
    fields += [(name, pa.int32() if name in ("width", "height", "ndisp") else pa.float64()) for name in NUMBERS]
    fields.append(("record", pa.string()))
    features = {
        name: {"_type": "Image"}
        if kind == image
        else {"dtype": str(kind).replace("double", "float64"), "_type": "Value"}
        for name, kind in fields
    }
    return pa.schema(fields, metadata={"huggingface": json.dumps({"info": {"features": features}})})


def _table(source: Source, schema: Any) -> Any:
    sample, calibration = source.sample, source.sample.calibration
    images = [{"bytes": data, "path": f"{source.name}/{name}"} for name, data in source.files(least=-np.inf)]
    fx, fy, cx0, cy = calibration.cam0
    size = (calibration.width, calibration.height)
    numbers = (*size, fx, fy, cx0, calibration.cam1[2], cy, calibration.baseline, calibration.doffs, sample.ndisp)
    record = read_bytes(sample.folder / "sample.json").decode() if sample.has("sample.json") else ""
    row: dict[str, Any] = {"name": sample.name, "record": record}
    row |= dict(zip(IMAGES, images, strict=False)) | dict(zip(NUMBERS, numbers, strict=True))
    return _pyarrow()[0].Table.from_pylist([row], schema=schema)


def _pyarrow() -> tuple[Any, Any]:
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise MissingExtraError("exporting to parquet needs pyarrow: pip install 'twinlens[parquet]'") from None
