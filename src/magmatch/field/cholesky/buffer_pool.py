# SPDX-License-Identifier: BSD-3-Clause
"""Reuse of large matrices' memory: touching fresh pages can take as long as the work that fills them."""

from threading import RLock

import numpy as np
import numpy.typing as npt

# Idle memory that is kept, bytes, and the least that a matrix takes: small ones are cheap.
MOST_IDLE, SMALLEST = 3e8, 1 << 16


class BufferPool:
    """Buffers in which matrices lie, and others once nobody looks at the first."""

    def __init__(self, most_idle: float = MOST_IDLE) -> None:
        # Matrices may be collected, and so come back, in the middle of `take`: by the thread that holds the lock.
        self._most_idle, self._lock = most_idle, RLock()
        # By size, which is a power of two: many matrices fit into few sizes.
        self._idle: dict[int, list[np.ndarray]] = {}
        self.n_idle_bytes = 0

    def take(self, n_rows: int, n_columns: int, precision: npt.DTypeLike = np.float64) -> np.ndarray:
        """Matrix with arbitrary content, column by column; its memory comes back when the last view of it is gone."""
        kind, n = np.dtype(precision), int(n_rows) * int(n_columns)
        n_bytes = max(SMALLEST, 1 << (n * kind.itemsize - 1).bit_length()) if n else SMALLEST
        with self._lock:
            waiting = self._idle.get(n_bytes)
            buffer = waiting.pop() if waiting else None
            if buffer is not None:
                self.n_idle_bytes -= n_bytes
        lent = _PooledBuffer(self, np.empty(n_bytes, dtype=np.uint8) if buffer is None else buffer)
        return np.asarray(lent).view(kind)[:n].reshape((n_rows, n_columns), order="F")

    def give_back(self, buffer: np.ndarray) -> None:
        """Keep a buffer for the next who needs one, if there is room."""
        with self._lock:
            if self.n_idle_bytes + buffer.nbytes <= self._most_idle:
                self._idle.setdefault(buffer.nbytes, []).append(buffer)
                self.n_idle_bytes += buffer.nbytes


class _PooledBuffer:
    """All views of a matrix hold on to this: when it goes, its buffer is idle."""

    def __init__(self, reserve: BufferPool, buffer: np.ndarray) -> None:
        self._reserve, self._buffer = reserve, buffer
        self.__array_interface__ = buffer.__array_interface__

    def __del__(self) -> None:
        self._reserve.give_back(self._buffer)


BUFFER_POOL = BufferPool()
