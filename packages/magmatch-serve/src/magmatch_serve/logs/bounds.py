# SPDX-License-Identifier: BSD-3-Clause
"""Reading a stranger's log takes bounded memory, disk and time of this machine, held by its operating system.

Readers trust what a file says of its sizes. A file that lies costs the process that reads it, which another replaces.
"""

import ctypes
import errno
import math
import resource
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

# Address space that a process holds, in pages; only Linux tells, and only it bounds that.
HELD = Path("/proc/self/statm")


@contextmanager
def bounded(memory: int, file_size: int, seconds: float) -> Iterator[None]:
    """Bound what the block may take of memory (bytes beside what is held), of a file it writes, and of the processor.

    Beyond it there is a `MemoryError`, or the end of the process.
    """
    used = resource.getrusage(resource.RUSAGE_SELF)
    wanted = {
        resource.RLIMIT_FSIZE: file_size,
        resource.RLIMIT_CPU: math.ceil(used.ru_utime + used.ru_stime + seconds),
    }
    if HELD.exists():
        wanted[resource.RLIMIT_AS] = int(HELD.read_text().split()[0]) * resource.getpagesize() + memory
    with ExitStack() as undone:
        for kind, most in wanted.items():
            soft, hard = resource.getrlimit(kind)
            known = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
            resource.setrlimit(kind, (min([most, *known]), hard))
            undone.callback(resource.setrlimit, kind, (soft, hard))
        try:
            yield
        except OSError as error:
            if error.errno != errno.EFBIG:
                raise
            raise MemoryError from None


def give_back_memory() -> None:
    """Let the system have what a log needed: glibc keeps pages between others that are in use."""
    if (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)) is not None:
        trim(0)
