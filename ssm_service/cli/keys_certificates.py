"""Certificates of a network of our own: one authority, one short-lived certificate for each party."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Final

from ..errors import ConfigError, ServiceError

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec

CLOCK_SKEW: Final = timedelta(minutes=5)
"""How far another machine's clock may be behind ours without refusing a new certificate."""

EXPIRES_SOON_DAYS: Final = 30.0
"""From when on one should be told."""

AUTHORITY_NAME: Final = "ssm authority"


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """A certificate with its private key, both as PEM."""

    certificate: bytes
    key: bytes


def make_authority(days: float) -> Pair:
    """Make a certificate authority: a certificate that signs itself.

    Raises:
        ServiceError: ``cryptography`` is not installed.
    """
    x509 = _x509()
    from cryptography.hazmat.primitives import hashes

    key = _new_key()
    name = _name(x509, AUTHORITY_NAME)
    builder = (
        _dated(x509.CertificateBuilder(), days)
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(x509, key_cert_sign=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    return _pair(builder.sign(key, hashes.SHA256()), key)


def make_certificate(authority: Pair, name: str, *, days: float, hosts: Sequence[str] = ()) -> Pair:
    """Make a certificate that the authority vouches for.

    Args:
        authority: The authority with its key.
        name: Common name, which access rules go by; at most 64 characters.
        days: How long it is valid, from now; never longer than the authority.
        hosts: Names and addresses at which its owner listens. Without any, it is good for dialling only:
            its owner cannot pose as a service or a router.

    Raises:
        ServiceError: ``cryptography`` is not installed, or the authority is no longer valid.
    """
    x509 = _x509()
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.x509.oid import ExtendedKeyUsageOID

    issuer = x509.load_pem_x509_certificate(authority.certificate)
    issuer_key = serialization.load_pem_private_key(authority.key, password=None)
    key = _new_key()
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
    if hosts:
        uses.append(ExtendedKeyUsageOID.SERVER_AUTH)
    builder = (
        _dated(x509.CertificateBuilder(), days, issuer.not_valid_after_utc)
        .subject_name(_name(x509, name))
        .issuer_name(issuer.subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(x509, digital_signature=True), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer.public_key()),
            critical=False,
        )
    )
    if hosts:
        builder = builder.add_extension(x509.SubjectAlternativeName(_hosts(x509, hosts)), critical=False)
    return _pair(builder.sign(issuer_key, hashes.SHA256()), key)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True, kw_only=True)
class Certified:
    """What a certificate says.

    Attributes:
        name: Common name.
        hosts: Where its owner may listen; empty for one that only dials.
        begins: From when it is valid.
        ends: Until when it is valid.
    """

    name: str
    hosts: tuple[str, ...]
    begins: datetime
    ends: datetime

    def days_left(self, now: datetime | None = None) -> float:
        """Return the days until it expires, below 0 where it has."""
        return (self.ends - (now or datetime.now(UTC))).total_seconds() / 86400


def read_certificate(path: Path) -> Certified:
    """Read a certificate (PEM); of a chain, the first that expires counts.

    Raises:
        ConfigError: It cannot be read.
        ServiceError: ``cryptography`` is not installed.
    """
    x509 = _x509()
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    try:
        chain = x509.load_pem_x509_certificates(path.read_bytes())
    except (OSError, ValueError) as error:
        raise ConfigError(path, "", str(error), "a certificate in PEM") from error
    first = chain[0]
    names = first.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    try:
        uses = list(first.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
        places = first.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        hosts = tuple(str(place.value) for place in places)
    except x509.ExtensionNotFound:
        uses, hosts = [], ()
    return Certified(
        name=str(names[0].value) if names else "",
        hosts=hosts if ExtendedKeyUsageOID.SERVER_AUTH in uses else (),
        begins=max(certificate.not_valid_before_utc for certificate in chain),
        ends=min(certificate.not_valid_after_utc for certificate in chain),
    )


def _x509() -> ModuleType:
    try:
        from cryptography import x509
    except ImportError as error:
        text = "certificates need the package `cryptography`: pip install 'ssm-service[keys]'"
        raise ServiceError(text) from error
    return x509


def _new_key() -> ec.EllipticCurvePrivateKey:
    from cryptography.hazmat.primitives.asymmetric import ec

    return ec.generate_private_key(ec.SECP256R1())


def _name(x509: ModuleType, name: str) -> x509.Name:
    from cryptography.x509.oid import NameOID

    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])  # type: ignore[no-any-return]


def _dated(
    builder: x509.CertificateBuilder, days: float, latest: datetime | None = None
) -> x509.CertificateBuilder:
    now = datetime.now(UTC).replace(microsecond=0)
    ends = now + timedelta(days=days)
    if latest is not None:
        if latest <= now:
            raise ServiceError(f"the authority expired at {latest:%Y-%m-%d %H:%M} UTC: make a new one")
        ends = min(ends, latest)
    return builder.not_valid_before(now - CLOCK_SKEW).not_valid_after(ends)


def _usage(
    x509: ModuleType, *, digital_signature: bool = False, key_cert_sign: bool = False
) -> x509.KeyUsage:
    return x509.KeyUsage(  # type: ignore[no-any-return]
        digital_signature=digital_signature,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=key_cert_sign,
        crl_sign=key_cert_sign,
        encipher_only=False,
        decipher_only=False,
    )


def _hosts(x509: ModuleType, hosts: Sequence[str]) -> list[x509.GeneralName]:
    found = []
    for host in hosts:
        try:
            found.append(x509.IPAddress(ipaddress.ip_address(host)))
        except ValueError:
            found.append(x509.DNSName(host))
    return found


def _pair(certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> Pair:
    from cryptography.hazmat.primitives import serialization

    return Pair(
        certificate=certificate.public_bytes(serialization.Encoding.PEM),
        key=key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        ),
    )
