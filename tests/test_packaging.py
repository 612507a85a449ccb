"""What users install: the wheel, built from this tree and installed alone, without the checkout."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from dataclasses import dataclass
from email.parser import Parser
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from ssm_service._version import __version__

ROOT = Path(__file__).resolve().parents[1]
DATA = {".toml", ".urdf", ".srdf", ".json", ".json5", ".html", ".js", ".css", ".typed"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Installed:
    """The wheel in an environment of its own, run from an empty folder with a clean environment."""

    folder: Path
    work: Path

    def run(self, *command: str, status: int = 0) -> str:
        """Run a program of the environment (``python``, ``ssm``); return what it prints."""
        program, *arguments = command
        done = subprocess.run(
            [str(self.folder / "bin" / program), *arguments],
            cwd=self.work,
            env={"PATH": f"{self.folder / 'bin'}:/usr/bin:/bin", "HOME": str(self.work), "LANG": "C.UTF-8"},
            capture_output=True,
            text=True,
            timeout=100,
            stdin=subprocess.DEVNULL,
        )
        assert done.returncode == status, done.stderr
        return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build source archive and, from that alone, the wheel; return their folder."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def wheel(built: Path) -> Path:
    """The wheel's file."""
    return next(built.glob("ssm_service-*.whl"))


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """Install the wheel, with the dependencies of the running interpreter instead of downloads.

    A ``.pth`` file names the running interpreter's folders of packages. Their own ``.pth`` files are not
    read through it, so an editable install of this checkout stays out of sight.
    """
    folder = tmp_path_factory.mktemp("venv")
    venv.create(folder, symlinks=True, with_pip=False)
    packages = next((folder / "lib").glob("python*")) / "site-packages"
    folders = [path for path in sys.path if path.endswith(("site-packages", "dist-packages"))]
    (packages / "dependencies.pth").write_text("\n".join(folders) + "\n")
    pip = [sys.executable, "-m", "pip", "--python", str(folder / "bin" / "python")]
    install = [*pip, "install", "--quiet", "--no-index", "--no-deps", "--ignore-installed", str(wheel)]
    done = subprocess.run(install, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    return Installed(folder=folder, work=tmp_path_factory.mktemp("empty"))


def shipped_files() -> set[str]:
    """Return the names in the wheel of all modules and data files of this tree."""
    modules = [path for path in (ROOT / "ssm_service").rglob("*") if path.suffix in {".py", *DATA}]
    modules.append(ROOT / "ssm_service" / "py.typed")
    names = {path.relative_to(ROOT).as_posix() for path in modules}
    robots = {path.relative_to(ROOT).as_posix() for path in (ROOT / "robots").rglob("*") if path.is_file()}
    return names | {f"ssm_service/{name}" for name in robots}


def test_the_wheel_holds_all_modules_and_data_and_nothing_else(wheel):
    names = {name for name in zipfile.ZipFile(wheel).namelist() if not name.endswith("/")}
    missing = shipped_files() - names
    assert not missing
    assert "ssm_service/robots/ur3.toml" in names
    assert "ssm_service/py.typed" in names
    assert {name.split("/")[0] for name in names} == {"ssm_service", f"ssm_service-{__version__}.dist-info"}


def test_the_wheel_says_what_it_is(wheel):
    info = f"ssm_service-{__version__}.dist-info"
    with zipfile.ZipFile(wheel) as archive:
        metadata = Parser().parsestr(archive.read(f"{info}/METADATA").decode())
        entry_points = archive.read(f"{info}/entry_points.txt").decode()
        assert f"{info}/licenses/LICENSE" in archive.namelist()
    assert metadata["Name"] == "ssm-service"
    assert metadata["Version"] == __version__
    assert metadata["License-Expression"] == "Apache-2.0"
    assert "ssm = ssm_service.cli:main" in entry_points


def test_the_source_archive_holds_what_a_build_and_a_test_run_need(built):
    with tarfile.open(next(built.glob("*.tar.gz"))) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = {"pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE", "constraints.txt", "robots/ur3.toml"}
    assert wanted <= names
    assert "tests/test_packaging.py" in names


def test_the_installed_package_is_not_the_checkout(installed):
    place = installed.run("python", "-c", "import ssm_service; print(ssm_service.__file__)").strip()
    assert Path(place).is_relative_to(installed.folder)
    version = "from importlib.metadata import version; print(version('ssm-service'))"
    assert installed.run("python", "-c", version).strip() == __version__


def test_every_shipped_robot_loads_from_the_installed_package(installed):
    code = (
        "from ssm_service.config import load_robot_config, robot_names\n"
        "for name in robot_names(): print(name, load_robot_config(name).path)"
    )
    robots = dict(line.split(" ", 1) for line in installed.run("python", "-c", code).splitlines())
    assert set(robots) == {path.stem for path in (ROOT / "robots").glob("*.toml")}
    for path in robots.values():
        assert Path(path).is_relative_to(installed.folder)


def test_the_installed_package_finds_the_robot_in_its_dependencies(installed):
    code = "from ssm_service.model import Robot; print(*Robot.load('ur3').joint_names)"
    assert "elbow_joint" in installed.run("python", "-c", code).split()


def test_the_installed_command_runs_the_demo_in_an_empty_folder(installed):
    assert os.access(installed.folder / "bin" / "ssm", os.X_OK)
    installed.run("ssm", "demo", "--seconds", "4", "--out", "report")
    report = installed.work / "report"
    summary = json.loads((report / "summary.json").read_text(encoding="utf-8"))
    assert summary["decisions"]["received"] > 1000
    assert {path.name for path in report.glob("*.png")} == {
        "distance.png",
        "speeds.png",
        "path.png",
        "ticks.png",
    }


def test_constraints_are_plain_pins_that_fit_every_dependency():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if not line.startswith("#")]
    versions = {canonicalize_name(pin.name): str(pin.specifier).removeprefix("==") for pin in pins}
    assert len(versions) == len(pins)
    for pin in pins:
        assert re.fullmatch(r"==[0-9][0-9a-z.]*", str(pin.specifier)), pin
        assert not pin.url
        assert not pin.marker
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    for line in [*project["dependencies"], *(line for extra in extras for line in extra)]:
        wanted = Requirement(line)
        if canonicalize_name(wanted.name) == project["name"]:
            continue  # an extra that takes in another
        assert wanted.specifier.contains(versions[canonicalize_name(wanted.name)]), line
