"""An FMU's archive, opened and unpacked without loading or trusting anything in it."""

from __future__ import annotations

import hashlib
import lzma
import platform
import re
import stat
import sys
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from fmus.descriptions import Description, read_description
from fmus.errors import ArchiveError, DescriptionError, PlatformError

MAX_TOTAL = 2**30  # bytes unpacked: real FMUs with a solver and tables stay below some hundred MB
MAX_DESCRIPTION = 2**26  # bytes of modelDescription.xml: 10⁵ variables are 20 to 50 MB, and while they are read 25 times that
MAX_TWIN = 2**20  # bytes
DAMAGED = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, NotImplementedError, EOFError)
"""What reading a member of a damaged archive raises."""
MAX_MEMBERS = 100_000
MAX_COMPONENT = 255  # bytes of a file's name: what file systems take
MAX_NAME = 2048  # bytes of a member's whole name, which lies in a folder of this machine: paths end at 4096
MAX_DEPTH = 100  # folders inside each other
MAX_RATIO = 200  # C sources and XML pack 5 to 20 times, tables of zeros up to 1000: only large archives are refused for it
RATIO_FREE = 2**26  # bytes unpacked below which the ratio does not matter
IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
TWIN = "resources/twin.toml"

_SUFFIX = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}


def host_platform() -> str:
    """This machine in the words of FMI 3.0, such as "x86_64-linux"."""
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64", "i386": "x86", "i686": "x86"}.get(machine, machine)
    if machine == "x86_64" and sys.maxsize < 2**32:
        machine = "x86"
    system = "windows" if sys.platform.startswith("win") else "darwin" if sys.platform == "darwin" else "linux"
    return f"{machine}-{system}"


def _folders(host: str) -> tuple[str, ...]:
    """The names that the folder of this machine's binaries may have, FMI 3.0's first."""
    machine, system = host.split("-")
    old = {"linux": "linux", "darwin": "darwin", "windows": "win"}[system] + ("32" if machine == "x86" else "64")
    return host, old


def machines(folder: str) -> tuple[str, ...]:
    """The machines, in the words of FMI 3.0, whose binaries lie in a folder below binaries/; none for a name that is not the standard's."""
    machine, _, system = folder.partition("-")
    if machine and system in _SUFFIX:
        return (folder,)
    old = {"linux": "linux", "win": "windows", "darwin": "darwin"}
    found = re.fullmatch(r"(linux|win|darwin)(32|64)", folder)
    if found is None:
        return ()
    # Universal libraries lie in darwin64, and tools for ARM, older than FMI 3.0, use these names, too.
    wide = ("x86_64", "aarch64") if found[1] == "darwin" else ("x86_64",)
    return tuple(f"{machine}-{old[found[1]]}" for machine in (wide if found[2] == "64" else ("x86",)))


@dataclass(frozen=True, slots=True)
class Fmu:
    """An FMU file that has passed every check that needs no execution.

    `platforms` are the folders of its binaries; `binaries` maps model identifier to the member for this machine, `digests` that to its
    SHA-256; `twin` is the text of its linear twin, if it brings one.
    """

    path: Path
    sha256: str
    description: Description
    platforms: tuple[str, ...]
    binaries: tuple[tuple[str, str], ...]
    digests: tuple[tuple[str, str], ...]
    twin: str | None
    description_xml: bytes

    def binary(self, interface: str) -> tuple[str, str] | None:
        """Member and SHA-256 of what this machine loads for an interface (`co_simulation`, `model_exchange`), which may be two libraries.

        None if the FMU does not offer it, or not for this machine.
        """
        member = dict(self.binaries).get(getattr(self.description.capabilities, interface) or "")
        return None if member is None else (member, dict(self.digests)[member])

    def binary_sha256(self, interface: str) -> str | None:
        """SHA-256 of `binary`; interface in the words of the description or, with a hyphen, of a study."""
        found = self.binary(interface.replace("-", "_"))
        return None if found is None else found[1]

    def require_platform(self, interface: str = "co_simulation") -> str:
        """The archive member that holds this machine's binary of an interface (`co_simulation` or `model_exchange`)."""
        identifier = getattr(self.description.capabilities, interface)
        if identifier is None:
            words = {"co_simulation": "Co-Simulation", "model_exchange": "Model Exchange"}
            other = next(text for key, text in words.items() if key != interface)
            raise DescriptionError(f"{self.path.name} offers {other} only; {words[interface]} is needed here")
        member = dict(self.binaries).get(identifier)
        if member is None:
            has = ", ".join(self.platforms) or "none"
            raise PlatformError(f"{self.path.name} holds no binary {identifier!r} for {host_platform()}; its binaries are for: {has}")
        return member

    @staticmethod
    def unpacks(name: str) -> bool:
        """Whether a run on this machine unpacks that member: not sources, documentation, other machines' binaries."""
        top, _, rest = name.partition("/")
        foreign = top == "binaries" and rest.split("/")[0] not in ("", *_folders(host_platform()))
        return not foreign and top not in ("sources", "documentation")

    def extract(self, folder: Path) -> None:
        """Unpack what a run needs (this machine's binaries, the resources) into an empty folder.

        `ArchiveError` if the file has changed since it was opened: what runs is what was hashed.
        """
        try:
            if _sha256(self.path) != self.sha256:
                raise ArchiveError(f"{self.path} has changed since it was opened")
            with zipfile.ZipFile(self.path) as archive:
                for info in _checked_members(archive, self.path):
                    if self.unpacks(info.filename):
                        archive.extract(info, folder)
        except (*DAMAGED, OSError) as problem:
            raise ArchiveError(f"{self.path} cannot be unpacked: {problem}") from None


def open_archive(path: Path | str) -> Fmu:
    """Open an FMU without loading code from it.

    `ArchiveError` if it is no zip file or not safe to unpack, `DescriptionError` if its modelDescription.xml is not one.
    """
    path = Path(path)
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):  # a pipe or a device may never end
            raise ArchiveError(f"{path} is no file but a pipe, socket or device")
        digest = _sha256(path)
        with zipfile.ZipFile(path) as archive:
            members = {info.filename: info for info in _checked_members(archive, path)}
            if "modelDescription.xml" not in members:
                raise ArchiveError(f"{path} is no FMU: it holds no modelDescription.xml")
            if members["modelDescription.xml"].file_size > MAX_DESCRIPTION:
                raise ArchiveError(f"{path}: modelDescription.xml of {members['modelDescription.xml'].file_size} bytes is too large")
            xml = archive.read("modelDescription.xml")
            description = read_description(xml)
            identifiers = sorted({i for i in (description.capabilities.co_simulation, description.capabilities.model_exchange) if i})
            for identifier in identifiers:
                if not IDENTIFIER.match(identifier):
                    raise ArchiveError(f"{path}: modelIdentifier {identifier!r} is no C identifier, so it cannot name the binary safely")
            binaries = tuple((i, m) for i in identifiers if (m := _binary(i, members)) is not None)
            digests = tuple((member, hashlib.sha256(archive.read(member)).hexdigest()) for _, member in binaries)
            if TWIN in members and members[TWIN].file_size > MAX_TWIN:
                raise ArchiveError(f"{path}: {TWIN} of {members[TWIN].file_size} bytes is too large")
            twin = archive.read(TWIN).decode() if TWIN in members else None
    except (*DAMAGED, UnicodeDecodeError) as problem:
        raise ArchiveError(f"{path} is no intact FMU (a zip file): {problem}") from None
    except OSError as problem:
        raise ArchiveError(f"{path} cannot be read: {problem.strerror or problem}") from None
    return Fmu(path, digest, description, _platforms(members), binaries, digests, twin, xml)


def _checked_members(archive: zipfile.ZipFile, path: Path) -> list[zipfile.ZipInfo]:
    members = archive.infolist()
    if len(members) > MAX_MEMBERS:
        raise ArchiveError(f"{path} holds {len(members)} files; at most {MAX_MEMBERS} are accepted")
    seen: set[str] = set()
    folders: set[str] = set()
    for info in members:
        _check_name(info, path)
        if info.filename in seen:
            raise ArchiveError(f"{path} holds {info.filename!r} twice")
        seen.add(info.filename)
        folders.update(str(parent) for parent in PurePosixPath(info.filename + "x" * info.is_dir()).parents)
        if stat.S_ISLNK(info.external_attr >> 16):
            raise ArchiveError(f"{path}: {info.filename!r} is a symbolic link")
        if info.flag_bits & 1:
            raise ArchiveError(f"{path}: {info.filename!r} is encrypted")
    if both := sorted(seen & folders):
        raise ArchiveError(f"{path} holds {both[0]!r} as a file and as a folder: it cannot be unpacked")
    total, packed = sum(m.file_size for m in members), sum(m.compress_size for m in members)
    if total > MAX_TOTAL:
        raise ArchiveError(f"{path} unpacks to {total} bytes; at most {MAX_TOTAL} are accepted")
    if total > RATIO_FREE and total > MAX_RATIO * packed:
        raise ArchiveError(f"{path} unpacks from {packed} to {total} bytes: more than {MAX_RATIO} times looks like a zip bomb")
    return members


def _check_name(info: zipfile.ZipInfo, path: Path) -> None:
    # `orig_filename`: the zip module cuts names at a NUL byte and turns the platform's separators into "/".
    for name in (info.filename, info.orig_filename):
        parts = name.rstrip("/").split("/")
        if not name or "\\" in name or "\0" in name or ":" in parts[0] or any(p in ("", ".", "..") for p in parts):
            raise ArchiveError(f"{path}: the member name {name!r} could lead outside the folder that it is unpacked to")
        lengths = [len(part.encode(errors="surrogatepass")) for part in parts]
        if max(lengths) > MAX_COMPONENT or sum(lengths) + len(parts) - 1 > MAX_NAME or len(parts) > MAX_DEPTH:
            raise ArchiveError(
                f"{path}: the member name {_short(name)} is too long or too deep to be unpacked: at most {MAX_COMPONENT} bytes for a file "
                f"or folder, {MAX_NAME} bytes in all and {MAX_DEPTH} levels are accepted"
            )


def _short(name: str) -> str:
    return repr(name) if len(name) <= 80 else f"{name[:60]!r}… ({len(name)} characters)"


def _platforms(members: dict[str, zipfile.ZipInfo]) -> tuple[str, ...]:
    split = (PurePosixPath(name) for name in members)
    return tuple(sorted({p.parts[1] for p in split if len(p.parts) >= 3 and p.parts[0] == "binaries" and p.suffix in _SUFFIX.values()}))


def _binary(identifier: str, members: dict[str, zipfile.ZipInfo]) -> str | None:
    host = host_platform()
    names = (f"binaries/{folder}/{identifier}{_SUFFIX[host.split('-')[1]]}" for folder in _folders(host))
    return next((name for name in names if name in members), None)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
