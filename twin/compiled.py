"""Numba machine code with a disk cache that cannot go stale.

Numba looks only at a function's own file when it decides whether cached code is current, although the code of every
compiled function it calls is in there too. So the cache folder is named by a hash of all sources that hold kernels:
whatever changes, everything is compiled anew, once. The folder lies in the user's cache, or among the temporary files
where there is no writable home; NUMBA_CACHE_DIR overrides it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
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


def _folder_name() -> str:
    """Names exactly these sources."""
    digest = hashlib.sha256()
    for path in kernel_sources():
        digest.update(path.name.encode() + path.read_bytes())
    return f"kernels-{digest.hexdigest()[:16]}"


def _roots() -> list[Path]:
    """Where a cache may live, best first: the user's cache, else a private folder among the temporary files."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return [home / "appli-twin", Path(tempfile.gettempdir()) / f"appli-twin-{_user()}"]


def _user() -> str:
    """The user's number, where the system has one."""
    return str(os.getuid()) if hasattr(os, "getuid") else "user"


def _writable_cache() -> Path | None:
    """The cache folder, made if need be; None where nothing can be written."""
    for root in _roots():
        folder = root / _folder_name()
        with suppress(OSError):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if os.access(folder, os.W_OK) and (not hasattr(os, "getuid") or root.stat().st_uid == os.getuid()):
                os.utime(folder)
                return folder
    return None


def _forget_stale(root: Path) -> None:
    for other in root.glob("kernels-*"):
        with suppress(OSError):
            if time.time() - other.stat().st_mtime > STALE_AFTER:
                shutil.rmtree(other, ignore_errors=True)


def _use_own_cache() -> tuple[bool, bool]:
    """(whether kernels can be kept, whether none have been kept yet)."""
    if "NUMBA_CACHE_DIR" in os.environ:
        given = Path(os.environ["NUMBA_CACHE_DIR"])
        return True, not (given.is_dir() and any(given.iterdir()))
    folder = _writable_cache()
    if folder is None:
        return False, True
    _forget_stale(folder.parent)
    numba.config.CACHE_DIR = str(folder)
    return True, not any(folder.iterdir())


CAN_CACHE, FIRST_TIME = _use_own_cache()
"""Whether machine code can be kept between runs; whether this run has to compile it all."""


def compiled(function: _Function) -> _Function:
    """Machine code of `function`: IEEE division, no fastmath, so that results equal C++'s."""
    machine_code: _Function = numba.njit(cache=CAN_CACHE, error_model="numpy")(function)
    return machine_code


def inlined(function: _Function) -> _Function:
    """As `compiled`, and put into its callers' code."""
    machine_code: _Function = numba.njit(cache=CAN_CACHE, error_model="numpy", inline="always")(function)
    return machine_code
