"""Numba machine code with a disk cache that cannot go stale.

Numba looks only at a function's own file when it decides whether cached code is current, although the code of every
compiled function it calls is in there too. So the cache folder is named by a hash of all sources that hold kernels:
whatever changes, everything is compiled anew, once. The folder lies in the user's cache, so a read-only installation
works; NUMBA_CACHE_DIR overrides it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import numba

_Function = TypeVar("_Function", bound=Callable[..., object])

STALE_AFTER = 14 * 24 * 3600  # [s] without use, after which an older version's cache is deleted


def kernel_sources() -> list[Path]:
    """The files that hold kernels."""
    return sorted(p for p in Path(__file__).parent.rglob("*.py") if "@compiled" in p.read_text(encoding="utf-8"))


def cache_folder() -> Path:
    """Where the machine code of exactly these sources is kept."""
    digest = hashlib.sha256()
    for path in kernel_sources():
        digest.update(path.name.encode() + path.read_bytes())
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "appli-twin"
    return root / f"kernels-{digest.hexdigest()[:16]}"


def _use_own_cache() -> None:
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    folder = cache_folder()
    with suppress(OSError):  # an unwritable home: numba then falls back to __pycache__ or compiles every time
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        for other in folder.parent.glob("kernels-*"):
            if time.time() - other.stat().st_mtime > STALE_AFTER:
                shutil.rmtree(other, ignore_errors=True)
        numba.config.CACHE_DIR = str(folder)


_use_own_cache()


def compiled(function: _Function) -> _Function:
    """Machine code of `function`: IEEE division, no fastmath, so that results equal C++'s."""
    machine_code: _Function = numba.njit(cache=True, error_model="numpy")(function)
    return machine_code
