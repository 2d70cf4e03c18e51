"""Many shapes of one mesh on disk, written while they are made: one npz, or a folder of OBJ files."""

from __future__ import annotations

import io
import os
import zipfile
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError
from capture_eval.files.atomic import atomic_path, write_bytes
from capture_eval.polygon_mesh import PolygonMesh

_ZIP_TIME = (1980, 1, 1, 0, 0, 0)  # a fixed date, so that equal arrays give equal bytes
_SEND_TO_DISK = getattr(os, "fdatasync", os.fsync)  # not every system has the cheaper one
Blocks = Iterable[NDArray[np.floating]]
Progress = Callable[[int, int], None]


class _WriteBehind(io.RawIOBase):
    """A file whose writes happen in a thread of their own, so that the next shapes are made meanwhile.

    A second thread sends to the disk what was written: the disk works from the start instead of waiting for the end,
    memory of the system does not fill with gigabytes that wait, and a closed file is on the disk.
    """

    _PENDING = 2  # writes that may wait; each holds one block

    def __init__(self, raw: io.FileIO) -> None:
        self._raw = raw
        self._place = 0
        self._pool = ThreadPoolExecutor(max_workers=1)
        self._syncing = ThreadPoolExecutor(max_workers=1)
        self._synced: Future[None] | None = None
        self._pending: deque[tuple[Future[None], bytearray]] = deque()
        self._free: list[bytearray] = []  # used again, since fresh memory costs more than copying

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        if len(self._pending) >= self._PENDING:
            self._finish_one()
        content = memoryview(data).cast("B")
        buffer = next((one for one in self._free if len(one) >= len(content)), None)
        if buffer is None:
            buffer = bytearray(len(content))
        else:
            self._free.remove(buffer)
        memoryview(buffer)[: len(content)] = content  # the caller uses its memory again
        written = self._pool.submit(self._write_all, memoryview(buffer)[: len(content)])
        self._pending.append((written, buffer))
        self._place += len(content)
        return len(content)

    def _finish_one(self) -> None:
        written, buffer = self._pending.popleft()
        written.result()
        self._free.append(buffer)

    def _write_all(self, left: memoryview) -> None:
        while left:
            left = left[self._raw.write(left) or 0 :]
        if self._synced is None or self._synced.done():
            self._sync()

    def _sync(self) -> None:
        if self._synced is not None:
            self._synced.result()  # a full disk may show only here
        self._synced = self._syncing.submit(_SEND_TO_DISK, self._raw.fileno())

    def tell(self) -> int:
        return self._place

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self.flush()
        self._place = self._raw.seek(offset, whence)
        return self._place

    def flush(self) -> None:
        while self._pending:
            self._finish_one()

    def close(self) -> None:
        if not self.closed:
            try:
                self.flush()
                self._sync()
                self._sync()
            finally:
                self._pool.shutdown(wait=True, cancel_futures=True)
                self._syncing.shutdown(wait=True)
                super().close()


def write_shapes_npz(
    path: Path,
    blocks: Blocks,
    shape: tuple[int, int, int],
    precision: np.dtype[Any],
    arrays: Mapping[str, NDArray[Any]],
    progress: Progress | None = None,
) -> None:
    """Write ``vertices`` (K, V, 3) from blocks and other arrays to one npz, uncompressed.

    Parameters
    ----------
    path : Path
        File to write, whole or not at all.
    blocks : iterable of (B, V, 3)
        Adding up to K shapes; each is written before the next is taken.
    shape : (int, int, int)
        K, V, 3.
    precision : dtype
        Of the blocks.
    arrays : mapping of name to array
        Small arrays beside the vertices.
    progress : callable, optional
        Called with (done, total).

    Raises
    ------
    InputError
        Blocks that do not add up to K shapes.
    """
    with (
        atomic_path(path) as temporary,
        open(temporary, "wb", buffering=0) as raw,
        _WriteBehind(raw) as behind,
        zipfile.ZipFile(behind, "w", zipfile.ZIP_STORED) as archive,
    ):
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.asanyarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", date_time=_ZIP_TIME), buffer.getvalue())
        member = zipfile.ZipInfo("vertices.npy", date_time=_ZIP_TIME)
        with archive.open(member, "w", force_zip64=True) as stream:
            header = {"descr": np.lib.format.dtype_to_descr(precision), "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(stream, header)
            done = 0
            for block in blocks:
                stream.write(np.ascontiguousarray(block, dtype=precision).data.cast("B"))
                done += len(block)
                if progress is not None:
                    progress(done, shape[0])
        if done != shape[0]:
            raise InputError(f"{path}: {done} shapes were made, {shape[0]} promised")


def write_shapes_obj(
    folder: Path, blocks: Blocks, mesh: PolygonMesh, count: int, progress: Progress | None = None
) -> list[Path]:
    """Write every shape as ``shape_00001.obj`` …, each whole or not at all.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    blocks : iterable of (B, V, 3)
        Shapes.
    mesh : PolygonMesh
        Faces and texture coordinates.
    count : int
        Number of shapes, for the width of the numbers and the progress.
    progress : callable, optional
        Called with (done, total).
    """
    tail = _face_text(mesh).encode()
    width = max(5, len(str(count)))
    written: list[Path] = []
    for block in blocks:
        for vertices in block:
            # the shortest text that reads back the same in its own precision
            rows = vertices.tolist() if vertices.dtype == np.float64 else vertices.astype(str).tolist()
            lines = "".join(f"v {x} {y} {z}\n" for x, y, z in rows)
            written.append(Path(folder) / f"shape_{len(written) + 1:0{width}d}.obj")
            write_bytes(written[-1], lines.encode() + tail)
        if progress is not None:
            progress(len(written), count)
    return written


def _face_text(mesh: PolygonMesh) -> str:
    corners = [str(index + 1) for index in mesh.face_vertices.tolist()]
    out = []
    if mesh.texture_coordinates is not None and mesh.face_texture_indices is not None:
        out = [f"vt {u!r} {v!r}" for u, v in mesh.texture_coordinates.tolist()]
        pairs = zip(corners, mesh.face_texture_indices.tolist(), strict=True)
        corners = [f"{a}/{b + 1}" for a, b in pairs]
    out += ["f " + " ".join(corners[first:last]) for first, last in pairwise(mesh.face_offsets.tolist())]
    return "\n".join(out) + "\n"
