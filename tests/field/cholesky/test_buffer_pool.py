# SPDX-License-Identifier: BSD-3-Clause
"""Memory comes back when nobody looks at it, never before, and no more of it is kept than was allowed."""

from concurrent.futures import ThreadPoolExecutor
from threading import Thread

import numpy as np

from magmatch.field.cholesky.buffer_pool import BufferPool


def test_matrices_in_use_never_share_memory():
    reserve = BufferPool()

    def use(seed):
        rng = np.random.default_rng(seed)
        for _ in range(50):
            matrix = reserve.take(*rng.integers(1, 120, 2))
            matrix[:] = seed
            assert (matrix * 2 == 2 * seed).all()
        return matrix

    with ThreadPoolExecutor(4) as pool:
        left = list(pool.map(use, range(8)))
    assert [set(m.ravel()) for m in left] == [{float(k)} for k in range(8)]


def test_no_more_is_kept_than_was_allowed():
    reserve = BufferPool(most_idle=3e6)
    matrices = [reserve.take(512, 256) for _ in range(5)]
    matrices.clear()
    assert reserve.n_idle_bytes == 2 * 2**20


def test_memory_that_comes_back_while_another_is_being_counted_does_not_wait_for_itself():
    reserve = BufferPool()
    inner = reserve.take(10, 10)

    class Idle(dict):
        """The interpreter may collect what nobody looks at anywhere, also while buffers are being counted."""

        def get(self, size):
            nonlocal inner
            inner = None
            return super().get(size)

    reserve._idle = Idle()
    worker = Thread(target=reserve.take, args=(10, 10), daemon=True)
    worker.start()
    worker.join(10)
    assert not worker.is_alive()
    assert reserve.n_idle_bytes == sum(len(buffers) * size for size, buffers in reserve._idle.items())
