"""Pictures in memory that two processes share: written once by who reads the files, seen in place by the planner.

Each picture has a block of its own. A planner may keep it as long as it likes, and write into it: pages that it writes
to become its own. Blocks that it has let go are used again.
"""

import math
import mmap
import os
import struct
import tempfile
import weakref
from collections import defaultdict
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.sandbox.limits import MOST_PICTURE_BYTES

_BEAT: Final = struct.Struct("<Q")
_PAGE: Final = max(mmap.PAGESIZE, mmap.ALLOCATIONGRANULARITY)
"""The first page holds the heartbeat alone."""


class TooManyPicturesError(Exception):
    """The planner keeps more pictures than there is room for."""


def _file() -> int:
    """A file without a name: nothing of it is left, however everybody ends."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("pictures", os.MFD_CLOEXEC)
    with tempfile.TemporaryFile() as stream:
        return os.dup(stream.fileno())


class SharedImagePool:
    """The side that writes pictures and reads the heartbeat; ``file`` is the descriptor of the shared memory."""

    def __init__(self) -> None:
        self.file = _file()
        os.ftruncate(self.file, _PAGE)
        self._end = _PAGE
        self._blocks: dict[int, mmap.mmap] = {}
        self._taken: set[int] = set()
        self._free: dict[int, list[int]] = defaultdict(list)
        self._pulse = mmap.mmap(self.file, _PAGE, prot=mmap.PROT_READ)

    def beats(self) -> int:
        """How often the heart has beaten."""
        (count,) = _BEAT.unpack_from(self._pulse)
        return int(count)

    def put(self, picture: NDArray[np.uint8]) -> int:
        """Write a picture into a block; its place."""
        size = -(-max(picture.nbytes, 1) // _PAGE) * _PAGE
        place = self._free[size].pop() if self._free[size] else self._new(size)
        self._taken.add(place)
        block = np.frombuffer(self._blocks[place], np.uint8, picture.size)
        np.copyto(block.reshape(picture.shape), picture)
        return place

    def reclaim(self, places: Iterable[int]) -> None:
        """Use blocks again that the planner has let go; raises `KeyError` for what it does not have."""
        for place in places:
            self._taken.remove(place)
            self._free[len(self._blocks[place])].append(place)

    def close(self) -> None:
        """Give the memory back."""
        for block in (*self._blocks.values(), self._pulse):
            block.close()
        os.close(self.file)

    def _new(self, size: int) -> int:
        if self._end + size > MOST_PICTURE_BYTES:
            raise TooManyPicturesError
        place, self._end = self._end, self._end + size
        os.ftruncate(self.file, self._end)
        self._blocks[place] = mmap.mmap(self.file, size, offset=place)
        return place


class SharedImageReader:
    """The planner's side of the shared memory."""

    def __init__(self, file: int) -> None:
        self._file = file
        self._let_go: list[int] = []
        self._read: dict[int, mmap.mmap] = {}
        self._pulse = mmap.mmap(file, _PAGE)
        self._beats = 0

    def beat(self) -> None:
        """Show that this process lives."""
        self._beats += 1
        _BEAT.pack_into(self._pulse, 0, self._beats)

    def look(self, place: int, shape: tuple[int, ...], *, writable: bool) -> NDArray[np.uint8]:
        """Picture of a block; a writable one is a private copy."""
        count = math.prod(shape)
        pages = self._pages(place, max(count, 1), writable=writable)
        picture = np.frombuffer(pages, np.uint8, count)
        # Views of it, and tensors, hold this very array.
        weakref.finalize(picture, self._let_go.append, place).atexit = False
        shaped = picture.reshape(shape)
        return shaped

    def _pages(self, place: int, count: int, *, writable: bool) -> mmap.mmap:
        """A block's memory: read-only blocks are mapped once and reused."""
        if writable:
            return mmap.mmap(self._file, count, access=mmap.ACCESS_COPY, offset=place)
        known = self._read.get(place)
        if known is None or len(known) < count:
            known = self._read[place] = mmap.mmap(self._file, count, prot=mmap.PROT_READ, offset=place)
        return known

    def release_unread(self, places: Iterable[int]) -> None:
        """Release blocks that were not read."""
        self._let_go.extend(places)

    def collect_released(self) -> list[int]:
        """Blocks that nothing in this process holds any more, each said once."""
        released = self._let_go[:]
        del self._let_go[: len(released)]
        return released
