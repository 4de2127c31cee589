"""What is installed: the data package, the page of the package index, the image, the compose files."""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from mountnav.catalog.embedded import DATA_PACKAGE, EMBEDDED_COLORS_SHA256, EMBEDDED_SHA256
from tests.conftest import ROOT

OWN = tomllib.loads((ROOT / "pyproject.toml").read_text())
DATA = ROOT / "deploy" / "tycho2"
COMPOSE = ROOT / "deploy" / "compose"


def test_the_data_package_holds_the_catalog_that_the_code_knows_and_its_terms() -> None:
    package = tomllib.loads((DATA / "pyproject.toml").read_text())
    files = package["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    found = {}
    for there, inside in files.items():
        folder, _, name = inside.partition("/")
        assert folder == DATA_PACKAGE
        found[name] = hashlib.sha256((DATA / there).read_bytes()).hexdigest()
    assert found == {"tycho2.mnc": EMBEDDED_SHA256, "tycho2.colors": EMBEDDED_COLORS_SHA256}
    assert f"{package['project']['name']}>={package['project']['version']}" in OWN["project"]["dependencies"]
    notice = (ROOT / "mountnav" / "catalog" / "data" / "TYCHO2-NOTICE.txt").read_bytes()
    assert (DATA / "TYCHO2-NOTICE.txt").read_bytes() == notice
    # and the other package holds none of it
    assert {f"/mountnav/catalog/data/{name}" for name in found} <= set(
        OWN["tool"]["hatch"]["build"]["exclude"]
    )


@pytest.mark.long
def test_without_the_files_beside_it_the_code_takes_the_data_package_and_else_says_what_is_missing(
    tmp_path: Path,
) -> None:
    program = (
        "import pathlib, sys; real = pathlib.Path.is_file\n"
        "pathlib.Path.is_file = lambda self: "
        "real(self) and not str(self).endswith('catalog/data/tycho2.mnc')\n"
        "from mountnav.catalog.embedded import EMBEDDED_PATH, embedded_catalog\n"
        "print(EMBEDDED_PATH)\n"
        "try: print(len(embedded_catalog().name))\n"
        "except Exception as error: print(type(error).__name__, error)\n"
    )

    def told() -> list[str]:
        path = f"{ROOT}:{tmp_path}"
        done = subprocess.run(
            [sys.executable, "-c", program],
            env={"PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.splitlines()

    where, said = told()
    assert said.startswith("BadSettings the star catalog Tycho-2 is not installed")
    assert "pip install --force-reinstall mountnav-tycho2" in said
    package = tmp_path / DATA_PACKAGE
    package.mkdir()
    (package / "__init__.py").touch()
    for name in ("tycho2.mnc", "tycho2.colors"):
        (package / name).symlink_to(ROOT / "mountnav" / "catalog" / "data" / name)
    where, said = told()
    assert where == str(package / "tycho2.mnc")
    assert said == str(len("Tycho-2"))


def test_the_page_of_the_package_index_needs_no_file_of_the_checkout() -> None:
    page = (ROOT / OWN["project"]["readme"]).read_text()
    links = re.findall(r"\]\(([^)]*)\)", page) + re.findall(r"(?:src|href)=\"([^\"]*)", page)
    assert [link for link in links if not link.startswith("https://")] == []
    # every extra that there is, and no other
    told = {
        name
        for row in re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", row)
    }
    assert told == set(OWN["project"]["optional-dependencies"])


def test_every_extra_is_told_of_on_the_page_about_installing() -> None:
    page = (ROOT / "docs" / "how-to" / "install.md").read_text()
    for name in OWN["project"]["optional-dependencies"]:
        assert f"`{name}`" in page


def test_what_the_image_copies_is_there_and_let_through() -> None:
    ignored = (ROOT / ".dockerignore").read_text().split()
    assert ignored[ignored.index("*")] == "*"
    let_through = {line[1:] for line in ignored if line.startswith("!")}
    copied: set[str] = set()
    for line in (ROOT / "deploy" / "Dockerfile").read_text().splitlines():
        if line.startswith("COPY ") and "--from" not in line:
            copied |= set(line.split()[1:-1])
    assert copied
    for path in copied:
        assert (ROOT / path).exists(), path
        assert path in let_through, path
    assert let_through == copied


@pytest.mark.parametrize(
    "over", [[], ["postgresql"], ["monitoring"], ["indi"], ["postgresql", "monitoring", "indi"]]
)
def test_the_compose_files_fit_together(over: list[str]) -> None:
    files = [yaml.safe_load((COMPOSE / f"{name}.yaml").read_text()) for name in ("compose", *over)]
    services: dict[str, dict[str, object]] = {}
    volumes: set[str] = set()
    for one in files:
        volumes |= set(one.get("volumes") or {})
        for name, service in one["services"].items():
            merged = services.setdefault(name, {"volumes": []})
            kept = [*merged["volumes"], *service.get("volumes", [])]  # type: ignore[misc]
            merged.update(service)
            merged["volumes"] = kept
    for name, service in services.items():
        assert service.get("image") or service.get("build"), name
        for needed in service.get("depends_on") or ():  # type: ignore[attr-defined]
            assert needed in services
        for volume in service["volumes"]:  # type: ignore[attr-defined]
            source = str(volume).split(":")[0]
            if source.startswith("../"):
                assert (COMPOSE / source).exists(), source
            elif not source.startswith("."):
                assert source in volumes, source
        # nothing is open to the network
        for port in service.get("ports") or ():  # type: ignore[attr-defined]
            assert str(port).startswith("127.0.0.1:")
    own = services["mountnav"]
    assert own["read_only"] is True
    assert own["cap_drop"] == ["ALL"]
