"""``ssm keys``: who is certified for what, and that nothing is ever replaced unasked."""

from __future__ import annotations

import builtins
import json
import stat
from pathlib import Path

import pytest
import zenoh
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID
from typer.testing import CliRunner

from ssm_service.cli.app import app
from ssm_service.cli.check_zenoh import check_zenoh
from ssm_service.cli.keys_certificates import Pair, make_authority, make_certificate, read_certificate
from ssm_service.cli.keys_network import Network
from ssm_service.cli.keys_roles import ROLES, Party, access_control
from ssm_service.errors import ConfigError, ServiceError
from ssm_service.wire.exposure import exposures

ROLE_NAMES = ("service", "driver", "commander", "viewer")


def ssm(*words: str, status: int = 0) -> str:
    done = CliRunner().invoke(app, ["keys", *words])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == status, done.output
    return done.stdout


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    ssm("init", str(tmp_path / "keys"), "--robot", "arm", "--host", "robot.example", "--host", "10.0.0.7")
    return tmp_path / "keys"


def certificate(folder: Path, name: str = "own.crt") -> x509.Certificate:
    return x509.load_pem_x509_certificate((folder / name).read_bytes())


def test_every_role_has_a_folder_that_only_its_owner_reads(keys):
    members = {path.name for path in keys.iterdir() if path.is_dir()}
    assert members == {"authority", *(f"{role}-arm" for role in ROLE_NAMES)}
    for path in keys.rglob("*"):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600)
    for role in ROLE_NAMES:
        names = {path.name for path in (keys / f"{role}-arm").iterdir()}
        assert names == {"authority.crt", "own.crt", "own.key", "zenoh.json5"}


def test_the_authority_vouches_for_all_and_only_the_service_may_be_dialled(keys):
    authority = certificate(keys / "authority", "authority.crt")
    assert authority.extensions.get_extension_for_class(x509.BasicConstraints).value.ca is True
    for role in ROLE_NAMES:
        own = certificate(keys / f"{role}-arm")
        own.verify_directly_issued_by(authority)
        assert own.subject.rfc4514_string() == f"CN={role}-arm"
        assert own.extensions.get_extension_for_class(x509.BasicConstraints).value.ca is False
        uses = own.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert ExtendedKeyUsageOID.CLIENT_AUTH in uses
        assert (ExtendedKeyUsageOID.SERVER_AUTH in uses) == (role == "service")
    assert read_certificate(keys / "service-arm" / "own.crt").hosts == ("robot.example", "10.0.0.7")
    assert read_certificate(keys / "driver-arm" / "own.crt").hosts == ()


def test_what_is_made_has_neither_faults_nor_weak_points(keys):
    for role in ROLE_NAMES:
        file = keys / f"{role}-arm" / "zenoh.json5"
        report = check_zenoh(file)
        assert [one for one in report.findings if one.level in ("fault", "weak")] == []
        assert exposures(zenoh.Config.from_file(str(file))) == ()


def test_nothing_is_replaced_unless_forced(keys):
    before = {path: path.read_bytes() for path in keys.rglob("*") if path.is_file()}
    with pytest.raises(ConfigError, match="exists"):
        ssm("init", str(keys), "--robot", "arm")
    assert {path: path.read_bytes() for path in before} == before
    ssm("init", str(keys), "--robot", "arm", "--force")
    assert not any(path.read_bytes() == before[path] for path in before if path.suffix in (".key", ".crt"))


def test_one_file_that_is_there_is_enough_to_refuse(tmp_path):
    (tmp_path / "driver-ur3").mkdir()
    (tmp_path / "driver-ur3" / "own.key").write_text("mine")
    with pytest.raises(ConfigError, match=r"own\.key exists"):
        ssm("init", str(tmp_path))
    assert (tmp_path / "driver-ur3" / "own.key").read_text() == "mine"
    assert not (tmp_path / "authority").exists()


def test_the_json_names_the_files_and_what_to_do_next(tmp_path):
    found = json.loads(ssm("init", str(tmp_path / "k"), "--at", "/carried", "--json"))
    assert all(Path(file).is_file() for file in found["files"])
    assert "ssm run --robot ur3 --name ur3 --zenoh-config /carried/service-ur3/zenoh.json5" in found["next"]
    config = zenoh.Config.from_file(str(tmp_path / "k" / "viewer-ur3" / "zenoh.json5"))
    tls = json.loads(config.get_json("transport/link/tls"))
    assert tls["connect_private_key"] == "/carried/viewer-ur3/own.key"


def test_renewing_keeps_the_authority_and_changes_who_was_asked_for(keys):
    before = {path: path.read_bytes() for path in keys.rglob("*.crt")}
    assert json.loads(ssm("renew", str(keys), "--name", "driver-arm", "--days", "5", "--json"))[
        "renewed"
    ] == ["driver-arm"]
    changed = {path.parent.name for path in before if path.read_bytes() != before[path]}
    assert changed == {"driver-arm"}
    certificate(keys / "driver-arm").verify_directly_issued_by(
        certificate(keys / "authority", "authority.crt")
    )
    assert 4.9 < read_certificate(keys / "driver-arm" / "own.crt").days_left() < 5.0
    assert "driver-arm" in ssm("renew", str(keys))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("renew", "KEYS", "--name", "nobody"), "nobody"),
        (("renew", "KEYS", "--days", "0"), "--days"),
        (("init", "EMPTY", "--days", "1e9"), "--days"),
        (("init", "EMPTY", "--robot", "a/b"), "a/b"),
        (("init", "EMPTY", "--robot", "a,a"), "each once"),
        (("init", "EMPTY", "--robot", "x" * 60), "certificate"),
        (("init", "EMPTY", "--port", "0"), "--port"),
        (("show", "EMPTY"), "network.json"),
    ],
)
def test_what_cannot_be_is_said(keys, tmp_path, words, says):
    places = {"KEYS": str(keys), "EMPTY": str(tmp_path / "empty")}
    with pytest.raises(ConfigError, match=says):
        ssm(*(places.get(word, word) for word in words))
    assert not (tmp_path / "empty").exists()


def test_an_authority_that_was_put_away_must_come_back_for_a_renewal(keys):
    (keys / "authority" / "authority.key").unlink()
    with pytest.raises(ConfigError, match="brought back"):
        ssm("renew", str(keys))


def test_the_list_says_what_expires(keys):
    assert "expires" not in ssm("show", str(keys))
    ssm("renew", str(keys), "--name", "viewer-arm", "--days", "3")
    assert "expires soon" in ssm("show", str(keys))
    authority = Pair(
        certificate=(keys / "authority" / "authority.crt").read_bytes(),
        key=(keys / "authority" / "authority.key").read_bytes(),
    )
    expired = make_certificate(authority, "viewer-arm", days=-0.001)
    (keys / "viewer-arm" / "own.crt").write_bytes(expired.certificate)
    assert "EXPIRED" in ssm("show", str(keys), status=1)
    states = {
        one["name"]: one["state"]
        for one in json.loads(ssm("show", str(keys), "--json", status=1))["certificates"]
    }
    assert states["viewer-arm"] == "expired"
    assert states["driver-arm"] == "valid"
    findings = {one.key: one.level for one in check_zenoh(keys / "viewer-arm" / "zenoh.json5").findings}
    assert findings["transport/link/tls/connect_certificate"] == "fault"


def test_no_certificate_outlives_its_authority_and_an_expired_one_vouches_for_nobody():
    short = make_authority(2.0)
    own = x509.load_pem_x509_certificate(make_certificate(short, "x", days=100).certificate)
    assert own.not_valid_after_utc == x509.load_pem_x509_certificate(short.certificate).not_valid_after_utc
    with pytest.raises(ServiceError, match="expired"):
        make_certificate(make_authority(-0.001), "x", days=1)


def test_without_the_package_it_says_what_to_install(tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *arguments, **options):
        if name.startswith("cryptography"):
            raise ImportError(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ServiceError, match=r"pip install 'ssm-service\[keys\]'"):
        ssm("init", str(tmp_path / "keys"))
    assert not (tmp_path / "keys").exists()


def test_what_is_no_certificate_is_said(tmp_path):
    (tmp_path / "own.crt").write_text("no certificate")
    with pytest.raises(ConfigError, match=r"own\.crt"):
        read_certificate(tmp_path / "own.crt")


def test_with_a_router_only_it_listens_and_each_robot_is_apart():
    members = {
        one.name: one for one in Network(robots=("left", "right"), hosts=("hub",), router=True).members()
    }
    assert [one.name for one in members.values() if one.listens] == ["router"]
    assert {one.dials for one in members.values() if one.dials} == {"tls/hub:7447"}
    for party in members["router"].others:
        assert party.robots == (("left", "right") if party.name == "viewer" else (party.name.split("-")[1],))


@pytest.mark.parametrize(
    ("hosts", "listens", "dials"),
    [
        (("127.0.0.1",), "tls/127.0.0.1:7447", "tls/127.0.0.1:7447"),
        (("::1",), "tls/[::1]:7447", "tls/[::1]:7447"),
        (("10.0.0.7", "arm"), "tls/0.0.0.0:7447", "tls/10.0.0.7:7447"),
        (("2001:db8::7",), "tls/[::]:7447", "tls/[2001:db8::7]:7447"),
    ],
)
def test_it_listens_no_further_than_it_is_dialled(hosts, listens, dials):
    service, *others = Network(robots=("arm",), hosts=hosts).members()
    assert service.listens == listens
    assert {one.dials for one in others} == {dials}


def test_without_a_router_each_robot_has_a_port_of_its_own():
    members = Network(robots=("a", "b"), hosts=("h",), port=9000).members()
    assert {one.name: one.listens for one in members if one.listens} == {
        "service-a": "tls/0.0.0.0:9000",
        "service-b": "tls/0.0.0.0:9001",
    }


def allowed(section: dict, subject: str, flow: str, message: str) -> set[str]:
    """The keys that a section lets pass, read as Zenoh reads it."""
    rules = {rule["id"]: rule for rule in section["rules"]}
    return {
        key
        for policy in section["policies"]
        if subject in policy["subjects"]
        for name in policy["rules"]
        for rule in [rules[name]]
        if flow in rule["flows"] and message in rule["messages"] and rule["permission"] == "allow"
        for key in rule["key_exprs"]
    }


def test_no_role_but_the_service_speaks_or_answers_for_it_and_only_a_commander_resets():
    parties = [Party(name=role, rights=rights, robots=("arm",)) for role, rights in ROLES.items()]
    section = access_control(parties)
    assert section["default_permission"] == "deny"
    for role in ROLES:
        puts = {key.removeprefix("ssm/arm/") for key in allowed(section, role, "ingress", "put")}
        if role != "service":
            assert all(key.startswith("in/") for key in puts)
            for message in ("declare_queryable", "reply", "liveliness_token"):
                assert allowed(section, role, "ingress", message) == set()
            resets = "ssm/arm/reset" in allowed(section, role, "ingress", "query")
            assert resets == (role == "commander")
        assert allowed(section, role, "ingress", "delete") == set()
    assert allowed(section, "viewer", "ingress", "put") == set()
    assert allowed(section, "driver", "ingress", "put") == {
        f"ssm/arm/in/{name}" for name in ("joints", "ranges", "obstacles", "echo")
    }
    assert allowed(section, "commander", "ingress", "put") == {"ssm/arm/in/target", "ssm/arm/in/echo"}


@pytest.mark.parametrize("role", ROLES)
def test_a_roles_own_rules_mirror_those_of_the_other_side(role):
    party = [Party(name="x", rights=ROLES[role], robots=("arm",))]
    there, here = access_control(party), access_control(party, mirrored=True)
    messages = {message for rule in there["rules"] for message in rule["messages"]}
    for message in messages:
        for flow, turned in (("ingress", "egress"), ("egress", "ingress")):
            assert allowed(there, "x", flow, message) == allowed(here, "x", turned, message)
