"""The image and the compose file name only what exists; Zenoh and the command line take what they say."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer
import yaml
import zenoh
from typer.testing import CliRunner

from ssm_service.cli.app import app
from ssm_service.simulation import list_scenarios
from ssm_service.wire.session import COMMON, zenoh_config

ROOT = Path(__file__).resolve().parents[2]
DOCKER = ROOT / "docker"
COMPOSE = yaml.safe_load((DOCKER / "compose.yaml").read_text(encoding="utf-8"))
INSECURE = yaml.safe_load((DOCKER / "insecure.yaml").read_text(encoding="utf-8"))
ZENOH_FILES = sorted((DOCKER / "zenoh").iterdir())
COMMANDS = {
    f"{place}: {kind}{name}": words
    for place, compose in (("compose", COMPOSE), ("insecure", INSECURE))
    for name, service in compose["services"].items()
    for kind, words in (
        ("", service["command"]),
        ("health of ", service.get("healthcheck", {"test": ["CMD"]})["test"][1:]),
    )
    if words
}
ROUTED = [f"{role}-{side}" for role in ("service", "simulation") for side in ("left", "right")]


def instructions() -> list[list[str]]:
    """The Dockerfile's instructions, as words."""
    text = (DOCKER / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ")
    return [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]


def copied() -> list[tuple[str, str, str]]:
    """Source, target and working directory of each COPY."""
    found, folder = [], "/"
    for word, *rest in instructions():
        if word == "WORKDIR":
            folder = rest[0]
        elif word == "COPY":
            found += [(source, rest[-1], folder) for source in rest[:-1]]
    return found


def words(command: list[str]) -> list[str]:
    """A command's words, ``--option=value`` taken apart."""
    return [part for word in command for part in (word.split("=", 1) if word.startswith("--") else [word])]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_path_of_a_command_exists_and_is_in_the_image(name):
    paths = [word for word in words(COMMANDS[name]) if word.startswith("docker/")]
    in_image = [source for source, target, folder in copied() if folder == "/opt/ssm" and source == target]
    for path in paths:
        assert (ROOT / path).is_file()
        assert any(path == source or path.startswith(f"{source}/") for source in in_image)


@pytest.mark.parametrize("name", [name for name, command in COMMANDS.items() if command[0] == "ssm"])
def test_the_command_line_takes_every_command(name):
    _, command, *arguments = COMMANDS[name]
    parser = typer.main.get_command(app).commands[command]
    if command == "keys":
        assert arguments.pop(0) == "init"
        parser = parser.commands["init"]
    parsed = parser.make_context(command, list(arguments)).params
    if command == "keys":
        assert (parsed["folder"], parsed["force"]) == (Path("/keys"), False)
        return
    file = parsed["zenoh_config"]
    assert file.is_relative_to("/keys") if name.startswith("compose") else (ROOT / file).is_file()
    assert parsed.get("insecure", False) == (name.startswith("insecure") and command == "run")
    assert parsed["name"] in ("left", "right")
    if command == "sim":
        assert parsed["scenario"] in list_scenarios()
    if command in ("run", "sim"):
        assert (ROOT / "robots" / f"{parsed['robot']}.toml").is_file()


@pytest.mark.parametrize(("compose", "more"), [(COMPOSE, {"keys"}), (INSECURE, set())])
def test_every_robot_has_a_service_and_a_simulation_and_nobody_a_published_port(compose, more):
    assert set(compose["services"]) == {"router", *ROUTED, *more}
    for service in compose["services"].values():
        assert "ports" not in service
        assert service["cap_drop"] == ["ALL"]
        assert service["read_only"] is True


@pytest.mark.parametrize("compose", [COMPOSE, INSECURE])
def test_only_one_service_builds_the_image_that_all_run(compose):
    services = compose["services"]
    assert {service["image"] for service in services.values()} == {"ssm-service"}
    (build,) = [service["build"] for service in services.values() if "build" in service]
    assert (DOCKER / build["context"] / build["dockerfile"]).resolve() == DOCKER / "Dockerfile"


@pytest.mark.parametrize("name", ["router", *ROUTED])
def test_each_sees_its_own_keys_only_and_cannot_change_them(tmp_path, name):
    keys = [one for one in COMPOSE["services"][name]["volumes"] if one["source"] == "keys"]
    seen = {one["volume"]["subpath"] for one in keys}
    assert seen == ({name, "viewer"} if name.startswith("service") else {name})
    for one in keys:
        assert one["target"] == f"/keys/{one['volume']['subpath']}"
        assert one["read_only"] is True


def test_the_keys_that_are_made_are_those_that_are_used(tmp_path):
    command = [
        word.replace("/keys", str(tmp_path / "keys")) for word in COMPOSE["services"]["keys"]["command"]
    ]
    done = CliRunner().invoke(app, [*command[1:], "--at", "/keys"])
    assert done.exit_code == 0, done.output
    made = {path.name for path in (tmp_path / "keys").iterdir()}
    assert made >= {"router", "viewer", *ROUTED}
    for name in ("router", "viewer", *ROUTED):
        config = zenoh.Config.from_file(str(tmp_path / "keys" / name / "zenoh.json5"))
        tls = json.loads(config.get_json("transport/link/tls"))
        assert tls["root_ca_certificate"] == f"/keys/{name}/authority.crt"
        dialled = json.loads(config.get_json("connect/endpoints"))
        assert dialled == ([] if name == "router" else ["tls/router:7447"])
    assert COMPOSE["services"]["keys"]["network_mode"] == "none"


@pytest.mark.parametrize("path", ZENOH_FILES, ids=lambda path: path.stem)
def test_zenoh_takes_every_file_and_it_says_what_the_package_says(path):
    config = zenoh.Config.from_file(str(path))
    mode = "router" if path.stem.startswith(("router", "service")) else "client"
    assert json.loads(config.get_json("mode")) == mode
    assert json.loads(config.get_json("metadata"))["name"] == path.stem
    for key, value in COMMON.items():
        if key != "connect/retry" or path.stem != "router":
            assert json.loads(config.get_json(key)) == value, key


@pytest.mark.parametrize("path", ZENOH_FILES, ids=lambda path: path.stem)
def test_only_the_router_listens_and_all_others_dial_it(path):
    config = zenoh_config("client", file=path)
    dialled = json.loads(config.get_json("connect/endpoints"))
    listened = json.loads(config.get_json("listen/endpoints"))
    if path.stem == "router":
        assert dialled == []
        assert listened == ["tcp/0.0.0.0:7447"]
    else:
        assert dialled == ["tcp/router:7447"]
        assert path.stem.startswith("service") == (listened == [])


def test_every_zenoh_file_is_used():
    used = {Path(word).name for command in COMMANDS.values() for word in words(command)}
    assert {path.name for path in ZENOH_FILES} <= used


def test_the_image_is_not_root_and_keeps_to_the_constraints():
    steps = instructions()
    assert [rest for word, *rest in steps if word == "FROM"] == [["python:3.12-slim"]]
    assert [rest for word, *rest in steps if word == "USER"] == [["ssm"]]
    assert any(
        rest[:5] == ["pip", "install", "-c", "constraints.txt", "'.[keys]'"]
        for word, *rest in steps
        if word == "RUN"
    )
    assert not any("apt-get" in rest for _, *rest in steps)


def test_every_copied_path_exists_and_is_let_into_the_build_context():
    lines = (DOCKER / "Dockerfile.dockerignore").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "*"
    allowed = [line[1:] for line in lines if line.startswith("!")]
    for source, _, _ in copied():
        assert (ROOT / source).exists()
        assert source in allowed
    assert all((ROOT / path).exists() for path in allowed)


def test_the_package_builds_from_what_the_image_gets_alone(tmp_path):
    for source, target, folder in copied():
        if folder == "/src":
            place = tmp_path / "src" / (source if target == "./" else target)
            if (ROOT / source).is_dir():
                shutil.copytree(ROOT / source, place, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                place.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / source, place)
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path)]
    done = subprocess.run([*build, str(tmp_path / "src")], capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stdout + done.stderr
    assert list(tmp_path.glob("ssm_service-*.whl"))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{ mode: "client" }', "mode"),
        ("{ no_such_key: 1 }", "no_such_key"),
        ('{ mode: "router", listen: { endpoints: ["tcp/0.0.0.0:7447"] } }', "--insecure"),
        (None, "zenoh.json5"),
    ],
)
def test_the_router_refuses_a_wrong_file_in_one_line(tmp_path, text, says):
    file = tmp_path / "zenoh.json5"
    if text is not None:
        file.write_text(text, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(DOCKER / "router.py"), str(file)], capture_output=True, text=True, timeout=30
    )
    assert done.returncode == 2
    assert says in done.stderr
    assert len(done.stderr.splitlines()) == 1
