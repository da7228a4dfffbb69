"""Where a job has its photos and its workspace: a folder that all nodes share, or any store that
fsspec knows, such as S3.

Of a store, each node gets copies in its temporary folder, one for each version of what is there.
Tiles travel by themselves. The workspace travels as one archive, whose replacement is atomic, until
its files are published: a job that is killed finds either the state before a stage or behind it.
"""

import contextlib
import fnmatch
import hashlib
import json
import os
import shutil
import tarfile
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from uuid import uuid4

import tiepoint

TILES = ".tiepoint-tiles"
ARCHIVE = ".tiepoint-workspace.tar"
MANIFEST = "tiepoint-files.json"
# Files of a workspace that the manifest does not name.
UNNAMED = {"database.db", MANIFEST}
# Files that belong to one machine.
LOCAL = {".lock", TILES}


def is_url(value: object) -> bool:
    return isinstance(value, str) and "://" in value


def _store(url: str) -> tuple[Any, str]:
    """The file system of fsspec and the path there."""
    try:
        import fsspec  # type: ignore[import-untyped]
    except ImportError:
        raise tiepoint.Error(f"{url} needs the package fsspec: pip install fsspec") from None
    try:
        store, path = fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise tiepoint.Error(f"{url} cannot be opened: {error}") from None
    # What other nodes have written is seen.
    store.invalidate_cache()
    return store, path.rstrip("/")


def _names(store: Any, root: str) -> dict[str, str]:
    """The files below a path with what tells their versions apart. A file by itself has no name."""
    if store.isfile(root):
        return {"": store.ukey(root)}
    found = {}
    for path in store.find(root):
        name = path[len(root) :].lstrip("/")
        if ".." in PurePosixPath(name).parts or not name:
            raise tiepoint.Error(f"{path} is no name of a file in a folder: rename it")
        found[name] = store.ukey(path)
    return found


def _scratch(url: str) -> Path:
    folder = Path(tempfile.gettempdir()) / f"tiepoint-cluster-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.is_symlink() or folder.stat().st_uid != os.getuid():
        raise tiepoint.Error(f"{folder} belongs to somebody else: remove it")
    folder /= hashlib.sha256(url.encode()).hexdigest()[:16]
    folder.mkdir(exist_ok=True)
    return folder


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Tasks of one node copy one after the other."""
    import fcntl

    with open(folder / "lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _get(store: Any, files: dict[str, Path]) -> None:
    for path in files.values():
        path.parent.mkdir(parents=True, exist_ok=True)
    store.get(list(files), [str(path) for path in files.values()])


def _copy(url: str, version: str, fill: Callable[[Path], None]) -> Path:
    """The copy of a version, which `fill` makes if this node has none. Older ones go."""
    folder = _scratch(url)
    copy = folder / hashlib.sha256(version.encode()).hexdigest()[:16]
    name = PurePosixPath(url.rstrip("/")).name
    with _locked(folder):
        if not copy.exists():
            for old in folder.iterdir():
                if old.is_dir():
                    shutil.rmtree(old)
            part = folder / "part"
            (part / name).mkdir(parents=True)
            fill(part / name)
            part.rename(copy)
    return copy / name


def local_copy(url: str) -> Path:
    """The copy that this node has of a file or folder."""
    store, root = _store(url)
    names = _names(store, root)
    names = {name: key for name, key in names.items() if not name.startswith(f"{TILES}/")}
    if not names:
        raise tiepoint.Error(f"{url} does not exist, or is empty")
    file = PurePosixPath(root).name

    def fill(folder: Path) -> None:
        _get(store, {f"{root}/{name}".rstrip("/"): folder / (name or file) for name in names})

    def unpack(folder: Path) -> None:
        packed = folder / ARCHIVE
        _get(store, {f"{root}/{ARCHIVE}": packed})
        with tarfile.open(packed) as tar:
            tar.extractall(folder, filter="data")
        packed.unlink()

    if ARCHIVE in names:
        return _copy(url, names[ARCHIVE], unpack)
    copy = _copy(url, json.dumps(sorted(names.items())), fill)
    return copy / file if "" in names else copy


def forget_copy(url: str) -> None:
    """Removes the copies that this node has."""
    shutil.rmtree(_scratch(url), ignore_errors=True)


def localised(value: Any) -> Any:
    """An option, with local copies in place of addresses."""
    if isinstance(value, (list, tuple)):
        return [localised(item) for item in value]
    return str(local_copy(value)) if is_url(value) else value


@dataclass(frozen=True)
class Workspace:
    """A workspace at a path or at an address. `job`: the name of the job that uses it."""

    url: str
    job: str

    def folder(self) -> Path:
        """The folder for the program on this node."""
        if not is_url(self.url):
            return Path(self.url)
        store, root = _store(self.url)
        names = {name for name in _names(store, root) if not name.startswith(f"{TILES}/")}
        if not names:
            return _copy(self.url, self.job, lambda folder: None)
        if not {ARCHIVE, MANIFEST} & names:
            raise tiepoint.Error(f"{self.url} has files and is no workspace: give another output")
        return local_copy(self.url)

    def take_tiles(self, folder: Path, patterns: list[str]) -> None:
        """Makes the tiles on this node those of the store, as far as their names match."""
        if not is_url(self.url):
            return
        store, root = _store(self.url)
        there = {PurePosixPath(path).name for path in store.find(f"{root}/{TILES}")}
        tiles = folder / TILES
        tiles.mkdir(exist_ok=True)
        for pattern in patterns:
            for tile in tiles.glob(pattern):
                if tile.name not in there:
                    tile.unlink(missing_ok=True)
            for name in fnmatch.filter(there, pattern):
                # Another task of this node may take the same one.
                part = folder.parent / f"{uuid4()}.tile"
                _get(store, {f"{root}/{TILES}/{name}": part})
                part.replace(tiles / name)

    def put_tile(self, tile: str) -> None:
        if is_url(self.url):
            store, root = _store(self.url)
            store.put_file(tile, f"{root}/{TILES}/{Path(tile).name}")

    def put(self, folder: Path, stage: str) -> None:
        """Replaces the archive by the workspace in which a stage is complete, then removes the
        tiles of the stage."""
        if not is_url(self.url):
            return
        store, root = _store(self.url)
        with tempfile.TemporaryDirectory(dir=folder.parent) as temporary:
            packed = Path(temporary) / ARCHIVE
            with tarfile.open(packed, "w", format=tarfile.PAX_FORMAT) as tar:
                for path in sorted(folder.iterdir()):
                    if path.name not in LOCAL:
                        tar.add(path, path.name)
            store.put_file(str(packed), f"{root}/{ARCHIVE}")
        for path in store.find(f"{root}/{TILES}"):
            if PurePosixPath(path).name.startswith(f"{stage}-"):
                store.rm_file(path)

    def publish(self) -> None:
        """Puts the files of the program to their places, and removes those that it has removed.
        Then they are the workspace, and the archive goes."""
        if not is_url(self.url):
            return
        store, root = _store(self.url)
        if not store.exists(f"{root}/{ARCHIVE}"):
            return
        folder = self.folder()
        old, new = set(), _manifest((folder / MANIFEST).read_bytes())
        if store.exists(f"{root}/{MANIFEST}"):
            old = _manifest(store.cat_file(f"{root}/{MANIFEST}"))
        names = sorted(name for name in new | UNNAMED if (folder / name).is_file())
        for name in names:
            store.put_file(str(folder / name), f"{root}/{name}")
        for name in sorted(old - new - UNNAMED):
            if store.exists(f"{root}/{name}"):
                store.rm_file(f"{root}/{name}")
        store.rm_file(f"{root}/{ARCHIVE}")


def _manifest(text: bytes) -> set[str]:
    """The files that the program has written."""
    names = json.loads(text)["files"]
    return {name for name in names if ".." not in PurePosixPath(name).parts}
