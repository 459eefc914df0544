"""WebDataset: shards of plain tar, the files of a sample one after the other under a common key.

A key ends at the first dot of a name: ``0001.im0.png`` is entry "im0.png" of sample "0001". The shards hold no time and
no owner, so the same samples give the same bytes.

Source: https://github.com/webdataset/webdataset, "The WebDataset Format"; POSIX.1-2001, pax.
"""

import io
import tarfile
from collections.abc import Iterable, Iterator

from twinlens.dataset.codecs.calib import encode_calib
from twinlens.dataset.codecs.pfm import encode_pfm
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.export.source import Source
from twinlens.dataset.files import read_bytes

SHARD_BYTES = 256 * 1024 * 1024


def webdataset(sources: Iterable[Source], shard_bytes: int = SHARD_BYTES) -> Iterator[tuple[str, bytes]]:
    """shard-000000.tar and so on, each closed with the sample that reaches `shard_bytes`."""
    number, stream = 0, io.BytesIO()
    for source in sources:
        for name, data in _entries(source):
            _append(stream, f"{source.name.replace('.', '-')}.{name}", data)
        if stream.tell() >= shard_bytes:
            yield f"shard-{number:06d}.tar", _closed(stream)
            number, stream = number + 1, io.BytesIO()
    if stream.tell():
        yield f"shard-{number:06d}.tar", _closed(stream)


def _entries(source: Source) -> Iterator[tuple[str, bytes]]:
    sample = source.sample
    for i in (0, 1):
        yield f"im{i}.png", source.image(i)
    for i in (0, 1):
        yield f"disp{i}.pfm", encode_pfm(sample.disparity(i))
        yield f"mask{i}nocc.png", encode_png(sample.mask_nonocc(i))
    yield "calib.txt", encode_calib(source.sample.calibration).encode()
    if sample.has("sample.json"):
        yield "json", read_bytes(sample.folder / "sample.json")


def _append(stream: io.BytesIO, name: str, data: bytes) -> None:
    header = tarfile.TarInfo(name)
    header.size, header.mode = len(data), 0o644
    stream.write(header.tobuf(tarfile.PAX_FORMAT))
    stream.write(data + bytes(-len(data) % tarfile.BLOCKSIZE))


def _closed(stream: io.BytesIO) -> bytes:
    stream.write(bytes(2 * tarfile.BLOCKSIZE))
    return stream.getvalue()
