"""Keys on disk: a folder for the authority, and one for each party to be carried to where it runs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Final

import msgspec

from ..errors import ConfigError
from .keys_certificates import Pair, make_authority, make_certificate
from .keys_network import Member, Network
from .keys_zenoh import AUTHORITY_FILE, CERTIFICATE_FILE, CONFIG_FILE, KEY_FILE, configuration_text

AUTHORITY_FOLDER: Final = "authority"
AUTHORITY_KEY: Final = "authority.key"
NETWORK_FILE: Final = "network.json"
AUTHORITY_YEARS: Final = 10
LONGEST_DAYS: Final = 365.0 * AUTHORITY_YEARS


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyFolder:
    """A folder of keys.

    Attributes:
        path: Where it is.
        network: Whose keys it has.
        at: Where the parties find it when they start: this path unless they see it elsewhere.
    """

    path: Path
    network: Network
    at: PurePosixPath

    @classmethod
    def load(cls, path: Path) -> KeyFolder:
        """Read what a folder was made for.

        Raises:
            ConfigError: It is no such folder.
        """
        file = path / NETWORK_FILE
        try:
            kept = msgspec.json.decode(file.read_bytes(), type=_Kept)
        except (OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise ConfigError(file, "", str(error), "a folder made by `ssm keys init`") from error
        return cls(path=path, network=kept.network, at=PurePosixPath(kept.at))

    def create(self, days: float, *, force: bool) -> list[Path]:
        """Make authority, keys and configurations; return the files.

        Raises:
            ConfigError: There is one of the files already, and ``force`` is not set.
            ServiceError: ``cryptography`` is not installed.
        """
        there = [path for path in self._targets() if path.exists()]
        if there and not force:
            allowed = "an empty folder, or --force, which makes every key that is there worthless"
            raise ConfigError("DIR", "", f"{there[0]} exists", allowed)
        authority = make_authority(LONGEST_DAYS)
        folder = self.path / AUTHORITY_FOLDER
        _write(folder / AUTHORITY_KEY, authority.key)
        _write(folder / AUTHORITY_FILE, authority.certificate)
        for member in self.network.members():
            self._issue(member, authority, days)
        kept = {"network": asdict(self.network), "at": str(self.at)}
        _write(self.path / NETWORK_FILE, msgspec.json.format(msgspec.json.encode(kept), indent=2) + b"\n")
        return self._targets()

    def renew(self, days: float, names: tuple[str, ...] = ()) -> list[Member]:
        """Make new keys and certificates with the same authority, and the configurations anew.

        Args:
            days: How long they are valid.
            names: Whose; everybody's where left out.

        Raises:
            ConfigError: A name is unknown, or the authority's key is not there.
        """
        members = self.network.members()
        known = [member.name for member in members]
        for name in names:
            if name not in known:
                raise ConfigError("--name", "", name, ", ".join(known))
        folder = self.path / AUTHORITY_FOLDER
        try:
            authority = Pair(
                certificate=(folder / AUTHORITY_FILE).read_bytes(), key=(folder / AUTHORITY_KEY).read_bytes()
            )
        except OSError as error:
            allowed = "the authority's certificate and key, brought back for this"
            raise ConfigError(folder, "", str(error), allowed) from error
        chosen = [member for member in members if not names or member.name in names]
        for member in chosen:
            self._issue(member, authority, days)
        return chosen

    def certificates(self) -> Iterator[tuple[str, Path]]:
        """Yield the name and the certificate of the authority and of every party."""
        yield AUTHORITY_FOLDER, self.path / AUTHORITY_FOLDER / AUTHORITY_FILE
        for member in self.network.members():
            yield member.name, self.path / member.name / CERTIFICATE_FILE

    def config_of(self, member: Member) -> PurePosixPath:
        """Return where a party finds its configuration."""
        return self.at / member.name / CONFIG_FILE

    def _issue(self, member: Member, authority: Pair, days: float) -> None:
        pair = make_certificate(authority, member.name, days=days, hosts=member.hosts)
        folder = self.path / member.name
        _write(folder / KEY_FILE, pair.key)
        _write(folder / CERTIFICATE_FILE, pair.certificate)
        _write(folder / AUTHORITY_FILE, authority.certificate)
        _write(folder / CONFIG_FILE, configuration_text(member, self.at / member.name).encode())

    def _targets(self) -> list[Path]:
        authority = [self.path / AUTHORITY_FOLDER / name for name in (AUTHORITY_FILE, AUTHORITY_KEY)]
        parties = [
            self.path / member.name / name
            for member in self.network.members()
            for name in (AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE, CONFIG_FILE)
        ]
        return [*authority, *parties, self.path / NETWORK_FILE]


class _Kept(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is remembered in the folder."""

    network: Network
    at: str


def _write(path: Path, data: bytes) -> None:
    """Write a file that only its owner can read, whole or not at all."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.new")
    draft.unlink(missing_ok=True)
    with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(data)
    draft.replace(path)
