"""Files that are no files, or something else than they are called."""

import gzip
import os
import socket
from pathlib import Path

from hostile_bvh import ARM
from hostile_cases import hostile


@hostile("leads to another file")
def link(folder: Path) -> Path:
    (folder / "private.bvh").write_text(ARM)
    (folder / "link.bvh").symlink_to("private.bvh")
    return folder / "link.bvh"


@hostile("leads to itself")
def link_to_itself(folder: Path) -> Path:
    (folder / "link_to_itself.npz").symlink_to("link_to_itself.npz")
    return folder / "link_to_itself.npz"


@hostile("keeps whoever opens it waiting")
def pipe(folder: Path) -> Path:
    os.mkfifo(folder / "pipe.bvh")
    return folder / "pipe.bvh"


@hostile("has no end")
def device(_folder: Path) -> Path:
    return Path("/dev/zero")


@hostile("is no file")
def a_socket(folder: Path) -> Path:
    path, here = folder / "a_socket.bvh", os.getcwd()
    os.chdir(folder)  # the name of a socket must be short
    try:
        socket.socket(socket.AF_UNIX).bind(path.name)
    finally:
        os.chdir(here)
    return path


@hostile("is a folder with the name of a file")
def a_folder(folder: Path) -> Path:
    (folder / "a_folder.bvh").mkdir()
    return folder / "a_folder.bvh"


@hostile("has a terabyte of zeros behind its first word")
def terabyte(folder: Path) -> Path:
    path = folder / "terabyte.bvh"
    path.write_bytes(b"HIERARCHY\n")
    os.truncate(path, 1 << 40)
    return path


@hostile("has 300 MB of zeros that take no room on the disk", reader="json")
def sparse_mapping(folder: Path) -> Path:
    path = folder / "sparse_mapping.json"
    path.write_bytes(b"{")
    os.truncate(path, 300 << 20)
    return path


@hostile("is not there")
def missing(folder: Path) -> Path:
    return folder / "missing.bvh"


@hostile("is empty", ".bvh")
def empty() -> bytes:
    return b""


@hostile("is a log-in page", ".npz")
def web_page() -> str:
    return "\n<!DOCTYPE html><html><script>alert(1)</script>Please log in</html>"


@hostile("is the pointer to a file that Git LFS has", ".bvh")
def lfs_pointer() -> str:
    return "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 12345\n"


@hostile("is compressed, and would unpack to 20 MB", ".bvh")
def gzip_bomb() -> bytes:
    return gzip.compress(bytes(20_000_000), 1)


@hostile("is in another encoding", ".bvh")
def utf_16() -> bytes:
    return ARM.encode("utf-16")


@hostile("is a picture", ".npz")
def picture() -> bytes:
    return b"\x89PNG\r\n\x1a\n" + bytes(100)


@hostile("is a program", ".bvh")
def program() -> bytes:
    return b"#!/bin/sh\ntouch harmed\n"
