"""Files that are whole or not there: atomic writes, TOML in and out, hashes, packaged examples."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import stat
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import tomli_w

from coaxlink import _interrupts
from coaxlink.errors import InputError
from firmware_params import bounded
from firmware_params.plain import plain

_read: dict[tuple[int, int], Path] | None = None  # device and inode of what the running verb has read
_KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
}  # fmt: skip


def note_reads() -> None:
    """A verb begins: what it reads from now on is not written over by it."""
    global _read
    _read = {}


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        about = path.stat()
    except OSError:
        return None
    return about.st_dev, about.st_ino


def _target(path: Path, inputs: Iterable[Path] = ()) -> Path:
    """The regular file that writing `path` makes or replaces, as a shell's `>` finds it: through links.

    Raises InputError where something else is there, or a file that is read or stands open as output.
    """
    target = Path(os.path.realpath(path))
    try:
        about = path.stat()
    except FileNotFoundError:
        return target
    except (OSError, ValueError) as error:  # ValueError: a NUL in a name
        problem = f"cannot be written ({getattr(error, 'strerror', None) or error})"
        raise InputError(path, "", problem) from error
    if not stat.S_ISREG(about.st_mode):
        found = _KINDS.get(stat.S_IFMT(about.st_mode), "no file")
        raise InputError(path, "", f"{found} is there; only a file is written: name a new or a regular one")
    identity = about.st_dev, about.st_ino
    if any(_identity(other) == identity for other in inputs) or identity in (_read or ()):
        raise InputError(path, "", "is read here, and is not written over: name another file")
    for stream in (0, 1, 2):
        with contextlib.suppress(OSError):
            opened = os.fstat(stream)
            if (opened.st_dev, opened.st_ino) == identity:
                problem = "input or output of this command goes there already: name another file"
                raise InputError(path, "", problem)
    return target


def write_atomic(path: Path, content: str | bytes) -> None:
    """Replace `path` by `content` in one step; on any failure the old file stays. Links stay, too.

    Raises InputError when the place cannot be written, is no regular file, or was read by this verb.
    """
    write_together({path: content})


def write_together(contents: Mapping[Path, str | bytes]) -> None:
    """Replace several files that are one thing: on any failure (a disk that fills) the old ones stay, all.

    Raises InputError as `write_atomic`.
    """
    staged: list[tuple[Path, Path, Path]] = []
    try:
        for path, content in contents.items():
            data = content.encode(errors="backslashreplace") if isinstance(content, str) else content
            target = _target(path)
            staged.append((path, _staged(path, target, data), target))
        for path, temporary, target in staged:
            try:
                temporary.replace(target)
            except OSError as error:
                raise InputError(path, "", f"cannot be written ({error.strerror})") from error
    finally:
        for _, temporary, _ in staged:
            temporary.unlink(missing_ok=True)


def _staged(path: Path, target: Path, data: bytes) -> Path:
    """`data` whole on the disk, under a name of its own beside `target`."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _interrupts.begin()  # what is staged is taken away again
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    except OSError as error:
        raise InputError(path, "", f"cannot be written ({error.strerror})") from error
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        umask = os.umask(0)
        os.umask(umask)
        Path(name).chmod(0o666 & ~umask)
    except BaseException as error:
        Path(name).unlink(missing_ok=True)
        if not isinstance(error, OSError):
            raise
        raise InputError(path, "", f"cannot be written ({error.strerror})") from error
    return Path(name)


def refuse_unwritable(path: Path | None, inputs: Iterable[Path] = ()) -> None:
    """Find out before the work whether a result can be put there. Raises InputError; leaves nothing.

    `inputs` will be read: none of them is written over.
    """
    if path is None:
        return
    folder = _target(path, inputs).parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(path, "", f"cannot be written ({error.strerror})") from error


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write one JSON object atomically. Raises InputError; NaN and infinity are refused, not written as
    invalid JSON."""
    try:
        text = json.dumps(value, indent=2, allow_nan=False)
    except ValueError as error:
        raise InputError(path, "", f"not written: a result is no finite number ({error})") from error
    write_atomic(path, text + "\n")


def write_toml(path: Path, value: Mapping[str, Any]) -> None:
    """Write one TOML document atomically, its strings plain, so that `read_toml` takes it back."""
    write_atomic(path, toml_text(value))


def toml_text(value: Mapping[str, Any]) -> str:
    """A TOML document, its strings plain, so that `read_toml` takes it back."""
    return tomli_w.dumps(_plain(value))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {plain(key, bounded.KEY): _plain(inside) for key, inside in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(inside) for inside in value]
    return plain(value, bounded.STRING) if isinstance(value, str) else value


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """What a file cannot be read for, as InputError; once read, this verb does not write over it."""
    with _unreadable(path):
        yield
    if _read is not None and (identity := _identity(path)):
        _read[identity] = path


@contextlib.contextmanager
def _unreadable(path: Path) -> Iterator[None]:
    try:
        yield
    except bounded.Unreadable as error:
        raise InputError(path, error.where, error.problem) from error
    except OSError as error:
        raise InputError(path, "", f"cannot be read ({error.strerror})") from error


def read_bytes(path: Path, most: int = bounded.TEXT) -> bytes:
    """A regular file of at most `most` bytes. Raises InputError; a device or a pipe is never opened."""
    with reading(path):
        return bounded.read_bytes(path, most)


def read_text(path: Path, most: int = bounded.TEXT) -> str:
    """The text of a file (UTF-8, a byte-order mark is dropped). Raises InputError."""
    with reading(path):
        return bounded.read_text(path, most)


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML document as a dict, its strings plain. Raises InputError with the line of a syntax error."""
    with reading(path):
        return bounded.parse_toml(bounded.read_text(path, bounded.SETTINGS))


def read_json(path: Path) -> Any:
    """A JSON document of bounded depth, which may be a record that is kept up. Raises InputError."""
    with _unreadable(path):
        return bounded.parse_json(bounded.read_text(path))


def code_folder(name: str) -> Path:
    """Where compiled code of this name is kept between runs."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "coaxlink" / name


def keep_private(folder: Path) -> str:
    """Make a folder for code that will be run (mode 700); why not to run what is in it, "" for no reason.

    Only this user may have put it there: the folder and all in it are this user's, nobody else can write
    them, and no folder above can be renamed by just anybody.
    """
    if not hasattr(os, "geteuid"):
        return "this system does not say whose files are whose"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        closed = not folder.lstat().st_mode & 0o077  # then nobody else reaches what is in it
        for path in (folder, *folder.rglob("*")):
            about = path.lstat()
            if stat.S_ISLNK(about.st_mode):
                return f"{path} is a link"
            if about.st_uid != os.geteuid():
                return f"{path} is another user's ({about.st_uid})"
            if about.st_mode & 0o022 and not closed:
                return f"{path} can be written by others"
        for above in folder.absolute().parents:
            mode = above.stat().st_mode
            if mode & 0o002 and not mode & stat.S_ISVTX:
                return f"{above} can be written by everybody"
    except OSError as error:
        return f"{folder}: {error.strerror}"
    return ""


def sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    with _unreadable(path):
        return hashlib.sha256(bounded.read_bytes(path, bounded.LOG)).hexdigest()


def example(name: str) -> Path:
    """Path of a shipped example (`x8_paper.toml`, ...), installed or in a checkout."""
    for folder in _example_folders():
        if (folder / name).is_file():
            return folder / name
    raise InputError(name, "", "no such shipped example")


def examples() -> list[Path]:
    """Every shipped example, by name."""
    found = {path.name: path for folder in _example_folders() if folder.is_dir() for path in folder.iterdir()}
    return [found[name] for name in sorted(found) if found[name].is_file()]


def _example_folders() -> tuple[Path, Path]:
    here = Path(__file__).parent
    return here / "examples", here.parent / "examples"


def state_folder() -> Path:
    """Where journals and signing timestamps live: COAXLINK_STATE, else the user's XDG state folder."""
    own = os.environ.get("COAXLINK_STATE")
    if own:
        return Path(own)
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "coaxlink"
