"""FMU files that are wrong or mean harm, each made from the shipped plant by one change."""

from __future__ import annotations

import io
import stat
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

from fmus import archives
from fmus.build import FmiVersion, build

Files = dict[str, bytes]


def _described(change: Callable[[str], str]) -> Callable[[Files], Files]:
    def changed(files: Files) -> Files:
        text = files["modelDescription.xml"].decode()
        assert change(text) != text
        return {**files, "modelDescription.xml": change(text).encode()}

    return changed


def _without_binaries(files: Files) -> Files:
    kept = {name: content for name, content in files.items() if not name.startswith("binaries/")}
    return {**kept, "binaries/sparc-solaris/two_mass.so": b"", "binaries/win64/two_mass.dll": b""}


def _binary(content: bytes) -> Callable[[Files], Files]:
    return lambda files: {name: content if name.startswith("binaries/") else kept for name, kept in files.items()}


def _token(text: str) -> str:
    name = "guid" if 'guid="' in text else "instantiationToken"
    before, _, rest = text.partition(f'{name}="')
    return f'{before}{name}="{{0}}"{rest.partition(chr(34))[2]}'


def _version(version: str) -> Callable[[str], str]:
    return lambda text: text.replace('fmiVersion="2.0"', f'fmiVersion="{version}"').replace('fmiVersion="3.0"', f'fmiVersion="{version}"')


HOSTILE: dict[str, Callable[[Files], Files]] = {
    "wrong_token": _described(_token),
    "identifier": _described(lambda text: text.replace('modelIdentifier="two_mass"', 'modelIdentifier="../../../evil/two_mass"')),
    "doctype": _described(lambda text: text.replace("<fmiModelDescription", '<!DOCTYPE x [<!ENTITY a "b">]><fmiModelDescription')),
    "fmi1": _described(_version("1.0")),
    "outside": lambda files: {**files, "../evil.so": b"x"},
    "absolute": lambda files: {**files, "/evil.so": b"x"},
    "long_name": lambda files: {**files, "resources/" + "x" * 5000: b"x"},
    "deep_name": lambda files: {**files, "resources/" + "x/" * 1000 + "y": b"x"},
    "beta": _described(_version("3.0-beta.2")),
    "bomb": lambda files: {**files, "resources/zeros": bytes(archives.RATIO_FREE + 1)},
    "platform": _without_binaries,
    "no_library": _binary(b"this is no shared library"),
    "file_and_folder": lambda files: {**files, "resources": b"x"},
    "no_description": lambda files: {name: content for name, content in files.items() if name != "modelDescription.xml"},
    "damaged_resource": lambda files: {**files, "resources/more": bytes(range(256)) * 40},
}
MARKED = {"symlink": (stat.S_IFLNK | 0o777, 0), "encrypted": (0o644, 1)}
"""Members with other file types or flags: mode and flag bits."""
TWICE = "twice"


def _cut(content: bytes) -> bytes:
    """As a download that broke off: without the directory at the end."""
    return content[: len(content) // 2]


def _member(name: str) -> Callable[[bytes], bytes]:
    """A byte changed in the middle of the packed content of the first member whose name begins so."""

    def changed(content: bytes) -> bytes:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            info = next(info for info in archive.infolist() if info.filename.startswith(name) and not info.is_dir())
        place = info.header_offset + 30 + len(info.filename) + info.compress_size // 2
        return content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :]

    return changed


def _directory(content: bytes) -> bytes:
    """The directory at the end points to where no members are."""
    changed = bytearray(content)
    entry = content.find(b"PK\x01\x02")
    while entry >= 0:
        changed[entry + 42 : entry + 46] = b"\xff\xff\xff\x00"
        entry = content.find(b"PK\x01\x02", entry + 1)
    return bytes(changed)


DAMAGED: dict[str, Callable[[bytes], bytes]] = {
    "truncated": _cut,
    "no_zip": lambda content: b"This is no archive.\n" * 200,
    "damaged_description": _member("modelDescription.xml"),
    "damaged_library": _member("binaries/"),
    "damaged_resource": _member("resources/more"),
    "damaged_directory": _directory,
}
"""Archives that are broken: what becomes of the file's bytes."""
NAMES = (*dict.fromkeys((*HOSTILE, *MARKED, TWICE, *DAMAGED)),)


def hostile(name: str, version: FmiVersion, folder: Path) -> Path:
    """The FMU of that name (one of `NAMES`) in `folder`."""
    with zipfile.ZipFile(build("two_mass", version)) as archive:
        files = {member: archive.read(member) for member in archive.namelist()}
    path = folder / f"{name}.fmi{version[0]}.fmu"
    files = HOSTILE[name](files) if name in HOSTILE else files
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")  # that a name is there twice is the point
        for member, content in files.items():
            info = zipfile.ZipInfo(member)
            info.filename, info.compress_type = member, zipfile.ZIP_DEFLATED  # the constructor would make an unsafe name safe
            archive.writestr(info, content)
        if name == TWICE:
            archive.writestr("modelDescription.xml", files["modelDescription.xml"])
        if name in MARKED:
            info = zipfile.ZipInfo("resources/more")
            info.external_attr = MARKED[name][0] << 16
            archive.writestr(info, b"/etc/passwd")
    if name in MARKED and MARKED[name][1]:
        _flag(path)
    if name in DAMAGED:
        path.write_bytes(DAMAGED[name](path.read_bytes()))
    return path


def _flag(path: Path) -> None:
    """Set the flag for encryption of the last member, in the directory at the end of the archive."""
    content = bytearray(path.read_bytes())
    entry = content.rindex(b"PK\x01\x02")
    content[entry + 8] |= 1
    path.write_bytes(content)
