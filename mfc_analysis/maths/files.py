"""Files of a user: read whole if they are regular files of a sensible size; written whole or not at all."""

from __future__ import annotations

import errno
import os
import stat
from contextlib import suppress
from pathlib import Path
from secrets import token_hex

_PLAIN = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)  # a pipe without a writer must not block


def read(path: Path, most: int) -> bytes:
    """The bytes of a regular file of at most ``most`` bytes.

    Raises OSError for anything else: a folder, a device, a pipe, a larger file, or one that cannot be read.
    """
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | _PLAIN)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file", str(path))
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"it is larger than {most / 1e6:g} MB", str(path))
    return content


def write(path: Path, content: bytes) -> None:
    """Writes a file whole: a temporary file beside it is renamed to it. A link of this name is replaced, not followed.

    Raises OSError, which names the file; what was there, if anything, is then unchanged. A folder, a device or a pipe is never replaced.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EEXIST, "it exists and is not a regular file", str(path))
    beside = path.with_name(f".{path.name[:40]}.{token_hex(8)}.tmp")
    try:
        with open(beside, "xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except OSError as why:
        raise OSError(why.errno, why.strerror, str(path)) from why
    finally:
        with suppress(OSError):
            beside.unlink()
